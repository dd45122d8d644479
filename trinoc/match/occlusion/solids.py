"""Edges of one body take each other's place: what that leaves of the odds of tracks and pairs.

Odds are those against clutter that lies anywhere. But the likeliest wrong match is another edge of
the same body, most often one that begins at the same corner: it shares the corner's end, meets the
same neighbours, and is seen where the right edge is hidden. So evidence adds up to too much, as it
does in pictures. Log odds are tempered as far as ends meet and bodies are solid.

Whether edges are seen through what stands before them: how often segments cross in a picture.

What is solid hides the edges behind it: they end where they meet its outline, and hardly any two
segments cross. Of wires, or of loose segments, each is seen whole, and they cross as often as if
they lay there by chance.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.evidence.mixture import probability, temper
from trinoc.match.observations.table import SegmentTable
from trinoc.match.selection.marginals import Selection, Tracks
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.match.tuning.evidence import EvidenceTuning
from trinoc.numerics.joins import broadcast_groups

# numerical: of more segments of a view, that many are counted, for time.
MOST_CROSSING = 200


def see_through_share(
    ends_px: Float[np.ndarray, "v n 2 2"],
    index: Int[np.ndarray, "m v"],
    posterior: Float[np.ndarray, "m"],
    tuning: MatchTuning,
    frame: Int[np.ndarray, "m"] | None = None,
    frames: int = 1,
) -> Float[np.ndarray, "f"]:
    """Of each frame, crossings of matched segments over those by chance: 0 solid, 1 see-through.

    Each segment counts as far as a candidate that holds it is likely, so that segments which belong
    to nothing, and cross everything, hardly count. Where few crossings are to be expected, edges
    are taken to be those of solids.
    """
    share = np.zeros(frames)
    own = np.zeros(len(index), np.int64) if frame is None else frame
    for number in range(frames):
        rows, found, usual = np.flatnonzero(own == number), 0.0, tuning.evidence.prior_observations
        for view, ends in enumerate(ends_px):
            on = rows[index[rows, view] >= 0]
            segment, place = np.unique(index[on, view], return_inverse=True)
            weight = np.zeros(len(segment))
            np.maximum.at(weight, place, posterior[on])
            count = len(segment)
            # Evenly among all: they are in order of their place.
            few = np.linspace(0, count - 1, min(count, MOST_CROSSING)).astype(np.int64)
            seen, expected = crossings(
                ends[segment[few]], weight[few], tuning.occlusion.crossing_margin_px
            )
            found, usual = found + seen, usual + expected
        share[number] = min(found / usual, 1.0)
    return share


def crossings(
    ends_px: Float[np.ndarray, "n 2 2"], weight: Float[np.ndarray, "n"], margin_px: float
) -> tuple[float, float]:
    """(weighted pairs of segments that cross, how many would if they were shifted by chance).

    A segment ends `margin_px` before its ends, so that those which stop at another do not cross it.
    Chance keeps lengths and directions, and shifts segments within an area of their spread.
    """
    step = ends_px[:, 1] - ends_px[:, 0]
    length = np.hypot(*step.T)
    long = length > 2 * margin_px
    if weight[long].sum() <= 0:
        return 0.0, 0.0
    ends_px, weight, length = ends_px[long], weight[long], length[long]
    unit = step[long] / length[:, None]
    inner = ends_px + margin_px * np.stack([unit, -unit], axis=1)
    normal = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    offset = (normal * inner[:, 0]).sum(axis=1)
    beside = inner @ normal.T - offset
    apart = (beside[:, 0] < 0) != (beside[:, 1] < 0)
    both = weight[:, None] * weight
    np.fill_diagonal(both, 0.0)
    middle = ends_px.mean(axis=1)
    # Of a box, each side is sqrt(12) standard deviations.
    area = 12 * np.sqrt(max(np.linalg.det(np.cov(middle.T, aweights=weight, bias=True)), 1.0))
    inside = weight * (length - 2 * margin_px)
    swept = np.abs(unit @ normal.T) * inside[:, None] * inside
    return float((both * (apart & apart.T)).sum() / 2), float(swept.sum() / 2 / area)


class Bodies(NamedTuple):
    """Of each frame: the share of ends that meet others, and how far edges are seen through what
    stands before them (`see_through.py`)."""

    joined: Float[np.ndarray, "*f"] | float
    through: Float[np.ndarray, "*f"] | float


# numerical: lines that meet nowhere.
NO_BODIES = Bodies(0.0, 1.0)


def estimate_bodies(
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
        tuning,
        tracks.candidates.frame,
        joined.size,
    )
    return Bodies(joined, through.reshape(joined.shape))


def temper_tracks(
    lines: SegmentTable, tracks: Tracks, bodies: Bodies, tuning: MatchTuning
) -> Tracks:
    """Tracks with tempered log odds, their rivals' too."""
    candidates, rules = tracks.candidates, tuning.occlusion
    # Edges seen through others have corners, too, but are hidden less often.
    share = bodies.joined * (1 - rules.seen_through_gain * bodies.through)
    own = broadcast_groups(share, candidates.frame)
    posterior, rivals = (
        _temper_log_odds(
            log_odds, candidates.side_log, own, rules.solid_temperature, tuning.evidence
        )
        for log_odds in (tracks.posterior_log_odds, tracks.rival_posterior)
    )
    return Tracks(candidates, posterior, rivals)


def temper_pairs(
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
    given = posterior_log_odds, side_log, solid, rules.solid_temperature, tuning.evidence
    return _temper_log_odds(*given) + np.where(side_log.any(axis=1), 0.0, turned)


def _temper_log_odds(
    log_odds: Float[np.ndarray, "m"],
    side_log: Float[np.ndarray, "m s"],
    share: Float[np.ndarray, "*m"] | float,
    temperature: float,
    tuning: EvidenceTuning,
) -> Float[np.ndarray, "m"]:
    # Those of pictures have a temperature of their own.
    factor = np.where(side_log.any(axis=1), 1.0, 1 - (1 - temperature) * share)
    return factor * temper(log_odds, side_log, tuning)
