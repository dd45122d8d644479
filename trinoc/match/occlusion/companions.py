"""Companions of pairs: sides of a bar, and consecutive pieces of a curve.

Two sides of a bar lie beside each other in all images, in the same order. Pieces of a curve
continue each other. So the neighbour of a segment in one view is matched with the neighbour of
its partner in the other. Right pairs have such a companion more often than wrong ones, if the
scene has bars and curves. The frequency is estimated from the pairs.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.candidates.table import Candidates
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.numerics.joins import broadcast_groups, expand_ranges, group_sums

# numerical: kinds of neighbours: parallel and beside, or continuing an end.
BESIDE, CONTINUES = 0, 1

# numerical: offset between frames, wider than any image, so that segments of different frames are
# no neighbours.
_FRAME_APART_PX = 1e6


class ImageNeighbours(NamedTuple):
    """Ordered pairs of neighbouring segments in one image.

    Attributes
    ----------
    first, second : (e,)
        Indices of the two segments.
    kind : (e,)
        BESIDE for parallel neighbours, CONTINUES for a neighbour that continues an end.
    side : (e,)
        For BESIDE, 1 if `second` lies on the right of `first`, seen from its first end. For
        CONTINUES, 1 if `second` continues the second end of `first`. Otherwise 0.
    """

    first: Int[np.ndarray, "e"]
    second: Int[np.ndarray, "e"]
    kind: Int[np.ndarray, "e"]
    side: Int[np.ndarray, "e"]


def image_neighbours(
    ends_px: Float[np.ndarray, "n 2 2"],
    tuning: MatchTuning,
    frame: Int[np.ndarray, "n"] | None = None,
) -> ImageNeighbours:
    """List the pairs of neighbouring segments in one image, for each frame of a stack."""
    if frame is not None:
        ends_px = ends_px + np.stack([frame * _FRAME_APART_PX, 0.0 * frame], axis=1)[:, None]
    step = ends_px[:, 1] - ends_px[:, 0]
    length = np.hypot(*step.T)
    unit = step / length[:, None]
    neighbours = (
        _find_parallels(ends_px, unit, length, tuning),
        _find_continuations(ends_px, unit, tuning),
    )
    columns = zip(*neighbours, strict=True)
    return ImageNeighbours(*(np.concatenate(column) for column in columns))


def _find_parallels(
    ends_px: Float[np.ndarray, "n 2 2"],
    unit: Float[np.ndarray, "n 2"],
    length: Float[np.ndarray, "n"],
    tuning: MatchTuning,
) -> ImageNeighbours:
    """List the neighbours that are nearly parallel, close and on one side of a segment.

    Their common part is at least half of the shorter segment.
    """
    smallest_px, largest_px = tuning.occlusion.companion_distance_px
    # Sample points on each segment, dense enough that two parallel neighbours have near samples.
    pieces = np.maximum(np.ceil(length / largest_px).astype(np.int64), 1)
    owner = np.repeat(np.arange(len(length)), pieces)
    piece = np.arange(len(owner)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    sample_offset = ((piece + 0.5) / pieces[owner] * length[owner])[:, None] * unit[owner]
    near_samples = KDTree(ends_px[owner, 0] + sample_offset).query_pairs(
        1.2 * largest_px, output_type="ndarray"
    )
    i, j = owner[near_samples].T
    pair_id = np.unique(np.concatenate([i * len(length) + j, j * len(length) + i]))
    i, j = np.divmod(pair_id, len(length))
    sine = unit[i, 0] * unit[j, 1] - unit[i, 1] * unit[j, 0]
    is_parallel = (i != j) & (np.abs(sine) < tuning.junctions.smallest_sine)
    i, j = i[is_parallel], j[is_parallel]
    offset = ends_px[j] - ends_px[i, :1]
    along_px = (offset * unit[i, None]).sum(axis=2)
    across_px = offset[..., 1] * unit[i, None, 0] - offset[..., 0] * unit[i, None, 1]
    shared = np.minimum(along_px.max(axis=1), length[i]) - np.maximum(along_px.min(axis=1), 0.0)
    distance = np.abs(across_px.mean(axis=1))
    is_close = (
        (distance > smallest_px) & (distance < largest_px) & (across_px[:, 0] * across_px[:, 1] > 0)
    )
    is_close &= shared > 0.5 * np.minimum(length[i], length[j])
    i, j, is_right = i[is_close], j[is_close], (across_px[is_close, 0] > 0).astype(np.int64)
    return ImageNeighbours(i, j, np.full(len(i), BESIDE), is_right)


def _find_continuations(
    ends_px: Float[np.ndarray, "n 2 2"], unit: Float[np.ndarray, "n 2"], tuning: MatchTuning
) -> ImageNeighbours:
    """List the pairs of segments with two ends close together and nearly the same direction.

    Segments whose ends meet at an angle are not listed, because these are junctions.
    """
    radius_px = tuning.occlusion.continuation_px
    near_ends = KDTree(ends_px.reshape(-1, 2)).query_pairs(radius_px, output_type="ndarray")
    near_ends = np.concatenate([near_ends, near_ends[:, ::-1]])
    (i, j), (end, other) = near_ends.T // 2, near_ends.T % 2
    outward = (2 * end - 1)[:, None] * unit[i], (1 - 2 * other)[:, None] * unit[j]
    min_cosine = np.sqrt(1 - tuning.junctions.smallest_sine**2)
    is_continuation = (i != j) & ((outward[0] * outward[1]).sum(axis=1) > min_cosine)
    return ImageNeighbours(
        i[is_continuation],
        j[is_continuation],
        np.full(is_continuation.sum(), CONTINUES),
        end[is_continuation],
    )


class Companions(NamedTuple):
    """Companions of candidate pairs of segments.

    A companion is another candidate whose segments are neighbours of the pair's segments in all
    common views, such as the other side of a bar.

    Attributes
    ----------
    pair, companion : (e,)
        Index of the candidate, and index of its companion.
    kind : (e,)
        BESIDE or CONTINUES.
    """

    pair: Int[np.ndarray, "e"]
    companion: Int[np.ndarray, "e"]
    kind: Int[np.ndarray, "e"]


def find_companions(
    candidates: Candidates,
    likely_rows: Int[np.ndarray, "k"],
    ends_px: Float[np.ndarray, "v n 2 2"],
    tuning: MatchTuning,
) -> Companions:
    """Find the companions of all candidates. Only the candidates `likely_rows` can be companions.

    A candidate and its companion have at least two common views. In every common view, their two
    segments are different, and are neighbours of the same kind and on the same side.
    """
    index, count, frame = candidates.index, len(candidates.index), candidates.frame
    forward = candidates.interval[..., 1] > candidates.interval[..., 0]
    codes = [np.zeros(0, np.int64)]
    for view in range(index.shape[1]):
        rows = np.flatnonzero(index[:, view] >= 0)
        if len(rows) == 0:
            continue
        segments, first = np.unique(index[rows, view], return_index=True)
        segment_frame = None if frame is None else frame[rows[first]]
        neighbours = image_neighbours(ends_px[view, segments], tuning, segment_frame)
        pair, companion, edge = _candidates_of_neighbours(
            neighbours, segments, index[:, view], rows, likely_rows
        )
        side = neighbours.side[edge] ^ ~forward[pair, view]
        codes.append(np.unique(((pair * count + companion) * 2 + neighbours.kind[edge]) * 2 + side))
    code, view_count = np.unique(np.concatenate(codes), return_counts=True)
    kind, (pair, companion) = code // 2 % 2, np.divmod(code // 4, max(count, 1))
    in_both = (index[pair] >= 0) & (index[companion] >= 0)
    is_separate = ~((index[pair] == index[companion]) & in_both).any(axis=1)
    is_companion = is_separate & (view_count > 1) & (view_count == in_both.sum(axis=1))
    return Companions(pair[is_companion], companion[is_companion], kind[is_companion])


def _candidates_of_neighbours(
    neighbours: ImageNeighbours,
    segments: Int[np.ndarray, "s"],
    index: Int[np.ndarray, "m"],
    rows: Int[np.ndarray, "r"],
    likely_rows: Int[np.ndarray, "k"],
) -> tuple[Int[np.ndarray, "e"], Int[np.ndarray, "e"], Int[np.ndarray, "e"]]:
    """List the pairs of candidates that contain two neighbouring segments, in one view.

    Returns (candidate with the first segment, likely candidate with the second segment, index of
    the pair of neighbours).
    """
    edge = np.arange(len(neighbours.first))
    columns = []
    for segment, candidates_in_view in ((neighbours.second, likely_rows), (neighbours.first, rows)):
        owners = candidates_in_view[np.argsort(index[candidates_in_view], kind="stable")]
        segment_of_edge = segments[segment[edge]]
        bounds = (
            np.searchsorted(index[owners], segment_of_edge, side) for side in ("left", "right")
        )
        repeats, position = expand_ranges(*bounds)
        edge = edge[repeats]
        columns = [column[repeats] for column in columns] + [owners[position]]
    return columns[1], columns[0], edge


def companion_log_odds(
    graph: Companions,
    posterior: Float[np.ndarray, "m"],
    tuning: MatchTuning,
    frame: Int[np.ndarray, "m"] | None = None,
    frames: int = 1,
) -> Float[np.ndarray, "m"]:
    """Return the log odds that the presence or absence of companions adds to each candidate, (m,).

    In each frame, the share of candidates with a companion is estimated for right and for wrong
    candidates. If the two shares are nearly equal, the result is 0.
    """
    gain = np.zeros(len(posterior))
    rules, prior = tuning.occlusion, tuning.evidence.prior_observations
    for kind in (BESIDE, CONTINUES):
        of_kind = graph.kind == kind
        log_doubt = np.log1p(-np.minimum(posterior[graph.companion[of_kind]], 1 - 1e-6))
        log_none = np.bincount(graph.pair[of_kind], log_doubt, minlength=len(posterior))
        has_companion = -np.expm1(log_none)
        right_share, wrong_share = (
            (group_sums(weight * has_companion, frame, frames) + prior * rules.companion_share)
            / (group_sums(weight, frame, frames) + prior)
            for weight in (posterior, 1 - posterior)
        )
        gain_with = np.log(right_share / wrong_share)
        gain_without = np.log((1 - right_share) / (1 - wrong_share))
        is_informative = gain_with > rules.min_companion_ratio
        gain_with, gain_without = (
            broadcast_groups(np.where(is_informative, term, 0.0), frame)
            for term in (gain_with, gain_without)
        )
        limit = rules.max_companion_log_odds
        gain += np.clip(
            has_companion * gain_with + (1 - has_companion) * gain_without, -limit, limit
        )
    return gain
