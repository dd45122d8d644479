"""Correction of log odds for the edges of solid bodies, which are often mistaken for each other.

Odds compare a match with clutter that lies anywhere. But the most likely wrong match is another
edge of the same body, often one that starts at the same corner. It shares the corner's end, meets
the same neighbours, and is visible where the right edge is hidden. The evidence is then too large.
Log odds are tempered in proportion to the share of ends that meet, and to how solid the bodies are.

The frequency of crossing segments in an image shows how solid bodies are. A solid body hides the
edges behind it, which end at its outline, so that hardly any two segments cross. Wires and loose
segments are fully visible and cross as often as by chance.
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

# numerical: largest number of segments of a view that are tested for crossings, for time.
MAX_CROSSING_SEGMENTS = 200


def see_through_share(
    ends_px: Float[np.ndarray, "v n 2 2"],
    index: Int[np.ndarray, "m v"],
    posterior: Float[np.ndarray, "m"],
    tuning: MatchTuning,
    frame: Int[np.ndarray, "m"] | None = None,
    frames: int = 1,
) -> Float[np.ndarray, "f"]:
    """Return how see-through the bodies of each frame are, (f,): 0 for solid, 1 for see-through.

    The share is the number of crossings between matched segments over the number by chance. Each
    segment has the posterior of its most likely candidate as weight, because clutter often crosses
    other segments. Bodies with few expected crossings are assumed solid.
    """
    share = np.zeros(frames)
    frame_label = np.zeros(len(index), np.int64) if frame is None else frame
    for number in range(frames):
        rows = np.flatnonzero(frame_label == number)
        observed = 0.0
        expected = tuning.evidence.prior_observations
        for view, ends in enumerate(ends_px):
            frame_rows = rows[index[rows, view] >= 0]
            segment, member_number = np.unique(index[frame_rows, view], return_inverse=True)
            weight = np.zeros(len(segment))
            np.maximum.at(weight, member_number, posterior[frame_rows])
            count = len(segment)
            # Segments are sorted by position, so this sample is evenly spread.
            sample = np.linspace(0, count - 1, min(count, MAX_CROSSING_SEGMENTS)).astype(np.int64)
            crossing_count, expected_count = crossings(
                ends[segment[sample]], weight[sample], tuning.occlusion.crossing_margin_px
            )
            observed, expected = observed + crossing_count, expected + expected_count
        share[number] = min(observed / expected, 1.0)
    return share


def crossings(
    ends_px: Float[np.ndarray, "n 2 2"], weight: Float[np.ndarray, "n"], margin_px: float
) -> tuple[float, float]:
    """Return the weighted number of crossing pairs of segments, and the number expected by chance.

    Each segment is shortened by `margin_px` at both ends. A segment that ends at another segment
    therefore does not cross it. Chance means the same lengths and directions at random positions,
    within an area of the segments' spread.
    """
    step = ends_px[:, 1] - ends_px[:, 0]
    length = np.hypot(*step.T)
    is_long = length > 2 * margin_px
    if weight[is_long].sum() <= 0:
        return 0.0, 0.0
    ends_px, weight, length = ends_px[is_long], weight[is_long], length[is_long]
    unit = step[is_long] / length[:, None]
    inner_ends = ends_px + margin_px * np.stack([unit, -unit], axis=1)
    normal = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    offset = (normal * inner_ends[:, 0]).sum(axis=1)
    side_distance = inner_ends @ normal.T - offset
    is_on_both_sides = (side_distance[:, 0] < 0) != (side_distance[:, 1] < 0)
    pair_weight = weight[:, None] * weight
    np.fill_diagonal(pair_weight, 0.0)
    middle = ends_px.mean(axis=1)
    # Each side of a box is sqrt(12) standard deviations.
    area = 12 * np.sqrt(max(np.linalg.det(np.cov(middle.T, aweights=weight, bias=True)), 1.0))
    inner_length = weight * (length - 2 * margin_px)
    swept_area = np.abs(unit @ normal.T) * inner_length[:, None] * inner_length
    return float((pair_weight * (is_on_both_sides & is_on_both_sides.T)).sum() / 2), float(
        swept_area.sum() / 2 / area
    )


class Bodies(NamedTuple):
    """Properties of the bodies in the scene; one value for each frame of a stack.

    Attributes
    ----------
    junction_share : float or (f,)
        Share of line ends that meet other line ends.
    see_through_share : float or (f,)
        0 for solid bodies, 1 for see-through bodies such as wires.
    """

    junction_share: Float[np.ndarray, "*f"] | float
    see_through_share: Float[np.ndarray, "*f"] | float


# numerical: lines without junctions.
NO_BODIES = Bodies(0.0, 1.0)


def estimate_bodies(
    lines: SegmentTable, tracks: Tracks, selections: list[Selection], tuning: MatchTuning
) -> Bodies:
    """Estimate the properties of the bodies in each frame from the tracks in three views."""
    largest = max(selections, key=lambda selection: selection.is_accepted.sum(), default=None)
    if largest is None:
        return NO_BODIES
    junction_share, index = np.asarray(largest.junctions.end_at_junction), tracks.candidates.index
    see_through = see_through_share(
        np.asarray(lines.ends_px),
        index,
        probability(tracks.posterior_log_odds),
        tuning,
        tracks.candidates.frame,
        junction_share.size,
    )
    return Bodies(junction_share, see_through.reshape(junction_share.shape))


def temper_tracks(
    lines: SegmentTable, tracks: Tracks, bodies: Bodies, tuning: MatchTuning
) -> Tracks:
    """Return the tracks with reduced (tempered) log odds of each track and of its best rival.

    Tempering multiplies log odds by a factor below 1. Edges of solid bodies need this factor,
    because the evidence for such edges is correlated.
    """
    candidates, rules = tracks.candidates, tuning.occlusion
    # Edges of see-through bodies meet at corners too, but are hidden less often.
    share = bodies.junction_share * (1 - rules.see_through_gain * bodies.see_through_share)
    share_of_candidate = broadcast_groups(share, candidates.frame)
    posterior, rival_log_odds = (
        _temper_log_odds(
            log_odds,
            candidates.side_log,
            share_of_candidate,
            rules.solid_temperature,
            tuning.evidence,
        )
        for log_odds in (tracks.posterior_log_odds, tracks.rival_posterior)
    )
    return Tracks(candidates, posterior, rival_log_odds)


def temper_pairs(
    posterior_log_odds: Float[np.ndarray, "m"],
    side_log: Float[np.ndarray, "m s"],
    crossing_sine: Float[np.ndarray, "m"],
    bodies: Bodies,
    tuning: MatchTuning,
) -> Float[np.ndarray, "m"]:
    """Return the tempered log odds of pairs, (m,).

    The log odds of edges of solid bodies are multiplied by a factor below 1, and an offset is
    added. The offset decreases with the angle between the viewing directions, because more edges
    are then hidden in one view. Pairs with known grey levels beside the segments have no offset,
    because the levels distinguish the edges.
    """
    rules, solid_share = tuning.occlusion, bodies.junction_share * (1 - bodies.see_through_share)
    viewpoint_offset = solid_share * (rules.solid_offset - rules.viewpoint_penalty * crossing_sine)
    arguments = posterior_log_odds, side_log, solid_share, rules.solid_temperature, tuning.evidence
    return _temper_log_odds(*arguments) + np.where(side_log.any(axis=1), 0.0, viewpoint_offset)


def _temper_log_odds(
    log_odds: Float[np.ndarray, "m"],
    side_log: Float[np.ndarray, "m s"],
    share: Float[np.ndarray, "*m"] | float,
    temperature: float,
    tuning: EvidenceTuning,
) -> Float[np.ndarray, "m"]:
    # With side levels, `temper` applies a temperature of its own.
    factor = np.where(side_log.any(axis=1), 1.0, 1 - (1 - temperature) * share)
    return factor * temper(log_odds, side_log, tuning)
