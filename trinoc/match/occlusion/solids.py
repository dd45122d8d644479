"""Edges of solids take each other's place: what that leaves of the odds of tracks and pairs.

Odds are those against clutter that lies anywhere. Of solids, the likeliest wrong match is another
edge of the same body, most often one that begins at the same corner: it shares the corner's ends,
meets the same neighbours, and shows where its own partner is hidden. So evidence adds up to too
much, as it does in pictures, and log odds are tempered as far as edges are those of solids.
"""

import numpy as np
from jaxtyping import Float

from trinoc.match.evidence import probability, temper
from trinoc.match.observations import SegmentTable, frames_of
from trinoc.match.occlusion.see_through import see_through_share
from trinoc.match.selection import Selection, Tracks
from trinoc.match.tuning import MatchTuning
from trinoc.numerics import of_group


def solid_share(
    lines: SegmentTable, tracks: Tracks, selections: list[Selection], tuning: MatchTuning
) -> Float[np.ndarray, "*f"]:
    """Of each frame, the share of ends that meet others, times what is not seen through: 0 for
    wires and for lines that meet nowhere, near 1 for blocks."""
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None:
        frames = () if lines.frame is None else (len(lines.matrix_px),)
        return np.zeros(frames)
    joined, index = np.asarray(most.junctions.end_at_junction), tracks.candidates.index
    through = see_through_share(
        np.asarray(lines.ends_px),
        index,
        probability(tracks.posterior_log_odds),
        tuning.occlusion,
        frames_of(lines, index),
        joined.size,
    )
    return np.asarray((1 - through).reshape(joined.shape) * joined)


def tempered_tracks(
    lines: SegmentTable, tracks: Tracks, solid: Float[np.ndarray, "*f"], tuning: MatchTuning
) -> Tracks:
    """Tracks with tempered log odds, their rivals' too."""
    candidates = tracks.candidates
    own = of_group(solid, frames_of(lines, candidates.index))
    posterior, rivals = (
        temper(log_odds, candidates.side_log, tuning.evidence, own)
        for log_odds in (tracks.posterior_log_odds, tracks.rival_posterior)
    )
    return Tracks(candidates, posterior, rivals)


def tempered_pairs(
    posterior_log_odds: Float[np.ndarray, "m"],
    side_log: Float[np.ndarray, "m s"],
    crossing_sine: Float[np.ndarray, "m"],
    solid: Float[np.ndarray, "*m"] | float,
    tuning: MatchTuning,
) -> Float[np.ndarray, "m"]:
    """Tempered log odds of pairs, less as the viewpoint turns about them: the further it does, the
    more edges of a solid are hidden from one view. Levels beside segments tell edges apart."""
    rules = tuning.occlusion
    turned = solid * (rules.solid_offset - rules.doubt_turned * crossing_sine)
    tempered = temper(posterior_log_odds, side_log, tuning.evidence, solid)
    return tempered + np.where(side_log.any(axis=1), 0.0, turned)
