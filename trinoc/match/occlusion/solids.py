"""Edges of one body take each other's place: what that leaves of the odds of tracks and pairs.

Odds are those against clutter that lies anywhere. But the likeliest wrong match is another edge of
the same body, most often one that begins at the same corner: it shares the corner's end, meets the
same neighbours, and is seen where the right edge is hidden. So evidence adds up to too much, as it
does in pictures. Log odds are tempered as far as ends meet and bodies are solid.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.match.evidence import probability, temper
from trinoc.match.observations import SegmentTable, frames_of
from trinoc.match.occlusion.see_through import see_through_share
from trinoc.match.selection import Selection, Tracks
from trinoc.match.tuning import EvidenceTuning, MatchTuning
from trinoc.numerics import broadcast_groups


class Bodies(NamedTuple):
    """Of each frame: the share of ends that meet others, and how far edges are seen through what
    stands before them (`see_through.py`)."""

    joined: Float[np.ndarray, "*f"] | float
    through: Float[np.ndarray, "*f"] | float


# Lines that meet nowhere.
NO_BODIES = Bodies(0.0, 1.0)


def bodies_of(
    lines: SegmentTable, tracks: Tracks, selections: list[Selection], tuning: MatchTuning
) -> Bodies:
    """What three views tell of each frame's bodies."""
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None:
        return NO_BODIES
    joined, index = np.asarray(most.junctions.end_at_junction), tracks.candidates.index
    through = see_through_share(
        np.asarray(lines.ends_px),
        index,
        probability(tracks.posterior_log_odds),
        tuning.occlusion,
        frames_of(lines, index),
        joined.size,
    )
    return Bodies(joined, through.reshape(joined.shape))


def tempered_tracks(
    lines: SegmentTable, tracks: Tracks, bodies: Bodies, tuning: MatchTuning
) -> Tracks:
    """Tracks with tempered log odds, their rivals' too."""
    candidates, rules = tracks.candidates, tuning.occlusion
    # Edges seen through others have corners, too, but are hidden less often.
    share = bodies.joined * (1 - rules.seen_through_gain * bodies.through)
    own = broadcast_groups(share, frames_of(lines, candidates.index))
    posterior, rivals = (
        _tempered(log_odds, candidates.side_log, own, rules.track_temperature, tuning.evidence)
        for log_odds in (tracks.posterior_log_odds, tracks.rival_posterior)
    )
    return Tracks(candidates, posterior, rivals)


def tempered_pairs(
    posterior_log_odds: Float[np.ndarray, "m"],
    side_log: Float[np.ndarray, "m s"],
    crossing_sine: Float[np.ndarray, "m"],
    bodies: Bodies,
    tuning: MatchTuning,
) -> Float[np.ndarray, "m"]:
    """Tempered log odds of pairs, each with its own frame's bodies, less as the viewpoint turns
    about them: the further it does, the more edges of a solid are hidden from one view. Levels
    beside segments tell edges apart."""
    rules, solid = tuning.occlusion, bodies.joined * (1 - bodies.through)
    turned = solid * (rules.solid_offset - rules.doubt_turned * crossing_sine)
    given = posterior_log_odds, side_log, solid, rules.pair_temperature, tuning.evidence
    return _tempered(*given) + np.where(side_log.any(axis=1), 0.0, turned)


def _tempered(
    log_odds: Float[np.ndarray, "m"],
    side_log: Float[np.ndarray, "m s"],
    share: Float[np.ndarray, "*m"] | float,
    temperature: float,
    tuning: EvidenceTuning,
) -> Float[np.ndarray, "m"]:
    # Those of pictures have a temperature of their own.
    factor = np.where(side_log.any(axis=1), 1.0, 1 - (1 - temperature) * share)
    return factor * temper(log_odds, side_log, tuning)
