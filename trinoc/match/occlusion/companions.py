"""Neighbours of pairs whose ends do not meet at an angle: the sides of a bar, pieces of a curve.

Two sides of a bar lie beside each other in all pictures, each on its side, and pieces of a curve
go on from each other. So the neighbour of a segment in one view is matched with the neighbour of
its partner in the other. Right pairs have such a companion more often than wrong ones do, as far
as there are bars and curves at all: how often is learned from the pairs.

Segments of one picture that may be sides of one bar, or pieces of one curve.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.candidates.table import Candidates
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.numerics.joins import broadcast_groups, expand_ranges, group_sums

# numerical: what a neighbour is: parallel and beside, or going on from an end.
BESIDE, CONTINUES = 0, 1

# numerical: further apart than pictures are wide, so that frames of a stack are no neighbours.
_FRAME_APART_PX = 1e6


class PictureNeighbours(NamedTuple):
    """Directed. way : seen along `first` from its first end to its second, 1 where `second` lies
    on the right, or goes on from the second end; else 0."""

    first: Int[np.ndarray, "e"]
    second: Int[np.ndarray, "e"]
    kind: Int[np.ndarray, "e"]
    way: Int[np.ndarray, "e"]


def picture_neighbours(
    ends_px: Float[np.ndarray, "n 2 2"],
    tuning: MatchTuning,
    frame: Int[np.ndarray, "n"] | None = None,
) -> PictureNeighbours:
    """Both kinds, among the segments of each frame."""
    if frame is not None:
        ends_px = ends_px + np.stack([frame * _FRAME_APART_PX, 0.0 * frame], axis=1)[:, None]
    step = ends_px[:, 1] - ends_px[:, 0]
    length = np.hypot(*step.T)
    unit = step / length[:, None]
    found = _find_parallels(ends_px, unit, length, tuning), _continuing(ends_px, unit, tuning)
    columns = zip(*found, strict=True)
    return PictureNeighbours(*(np.concatenate(column) for column in columns))


def _find_parallels(
    ends_px: Float[np.ndarray, "n 2 2"],
    unit: Float[np.ndarray, "n 2"],
    length: Float[np.ndarray, "n"],
    tuning: MatchTuning,
) -> PictureNeighbours:
    """Nearly parallel, close, on one side along half of the shorter."""
    least, most = tuning.occlusion.beside_px
    # Places on each, so dense that those of two which lie beside each other are near.
    pieces = np.maximum(np.ceil(length / most).astype(np.int64), 1)
    owner = np.repeat(np.arange(len(length)), pieces)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    along = ((place + 0.5) / pieces[owner] * length[owner])[:, None] * unit[owner]
    near = KDTree(ends_px[owner, 0] + along).query_pairs(1.2 * most, output_type="ndarray")
    i, j = owner[near].T
    number = np.unique(np.concatenate([i * len(length) + j, j * len(length) + i]))
    i, j = np.divmod(number, len(length))
    sine = unit[i, 0] * unit[j, 1] - unit[i, 1] * unit[j, 0]
    parallel = (i != j) & (np.abs(sine) < tuning.junctions.smallest_sine)
    i, j = i[parallel], j[parallel]
    apart = ends_px[j] - ends_px[i, :1]
    on = (apart * unit[i, None]).sum(axis=2)
    off = apart[..., 1] * unit[i, None, 0] - apart[..., 0] * unit[i, None, 1]
    shared = np.minimum(on.max(axis=1), length[i]) - np.maximum(on.min(axis=1), 0.0)
    distance = np.abs(off.mean(axis=1))
    close = (distance > least) & (distance < most) & (off[:, 0] * off[:, 1] > 0)
    close &= shared > 0.5 * np.minimum(length[i], length[j])
    i, j, right = i[close], j[close], (off[close, 0] > 0).astype(np.int64)
    return PictureNeighbours(i, j, np.full(len(i), BESIDE), right)


def _continuing(
    ends_px: Float[np.ndarray, "n 2 2"], unit: Float[np.ndarray, "n 2"], tuning: MatchTuning
) -> PictureNeighbours:
    """An end near another's, and nearly the same way on: ends at an angle are junctions."""
    reach = tuning.occlusion.continues_px
    near = KDTree(ends_px.reshape(-1, 2)).query_pairs(reach, output_type="ndarray")
    near = np.concatenate([near, near[:, ::-1]])
    (i, j), (end, other) = near.T // 2, near.T % 2
    onward = (2 * end - 1)[:, None] * unit[i], (1 - 2 * other)[:, None] * unit[j]
    straight = np.sqrt(1 - tuning.junctions.smallest_sine**2)
    same = (i != j) & ((onward[0] * onward[1]).sum(axis=1) > straight)
    return PictureNeighbours(i[same], j[same], np.full(same.sum(), CONTINUES), end[same])


class Companions(NamedTuple):
    """Directed: `site`, a pair, has `other` as a companion of a `kind`."""

    site: Int[np.ndarray, "e"]
    other: Int[np.ndarray, "e"]
    kind: Int[np.ndarray, "e"]


def companions(
    candidates: Candidates,
    likely: Int[np.ndarray, "k"],
    ends_px: Float[np.ndarray, "v n 2 2"],
    tuning: MatchTuning,
) -> Companions:
    """Who has which of the `likely` rows as a companion, in every view that shows both.

    Two views or more show both, by different segments.
    """
    index, count, frame = candidates.index, len(candidates.index), candidates.frame
    forward = candidates.interval[..., 1] > candidates.interval[..., 0]
    numbers = [np.zeros(0, np.int64)]
    for view in range(index.shape[1]):
        rows = np.flatnonzero(index[:, view] >= 0)
        if len(rows) == 0:
            continue
        segments, first = np.unique(index[rows, view], return_index=True)
        own = None if frame is None else frame[rows[first]]
        beside = picture_neighbours(ends_px[view, segments], tuning, own)
        site, other, edge = _holders(beside, segments, index[:, view], rows, likely)
        way = beside.way[edge] ^ ~forward[site, view]
        numbers.append(np.unique(((site * count + other) * 2 + beside.kind[edge]) * 2 + way))
    number, seen = np.unique(np.concatenate(numbers), return_counts=True)
    kind, (site, other) = number // 2 % 2, np.divmod(number // 4, max(count, 1))
    both = (index[site] >= 0) & (index[other] >= 0)
    apart = ~((index[site] == index[other]) & both).any(axis=1)
    every = apart & (seen > 1) & (seen == both.sum(axis=1))
    return Companions(site[every], other[every], kind[every])


def _holders(
    beside: PictureNeighbours,
    segments: Int[np.ndarray, "s"],
    index: Int[np.ndarray, "m"],
    rows: Int[np.ndarray, "r"],
    likely: Int[np.ndarray, "k"],
) -> tuple[Int[np.ndarray, "e"], Int[np.ndarray, "e"], Int[np.ndarray, "e"]]:
    """(candidates that hold the first, likely ones that hold the second, of which neighbours)."""
    edge = np.arange(len(beside.first))
    held = []
    for segment, among in ((beside.second, likely), (beside.first, rows)):
        owners = among[np.argsort(index[among], kind="stable")]
        wanted = segments[segment[edge]]
        bounds = (np.searchsorted(index[owners], wanted, side) for side in ("left", "right"))
        turn, position = expand_ranges(*bounds)
        edge = edge[turn]
        held = [column[turn] for column in held] + [owners[position]]
    return held[1], held[0], edge


def companion_log_odds(
    graph: Companions,
    posterior: Float[np.ndarray, "m"],
    tuning: MatchTuning,
    frame: Int[np.ndarray, "m"] | None = None,
    frames: int = 1,
) -> Float[np.ndarray, "m"]:
    """Log odds that companions, or their want, add to pairs.

    The shares of right and of wrong pairs that have one are learned in each frame; where they
    hardly differ, nothing is added.
    """
    gain = np.zeros(len(posterior))
    rules, prior = tuning.occlusion, tuning.evidence.prior_observations
    for kind in (BESIDE, CONTINUES):
        of_kind = graph.kind == kind
        doubt = np.log1p(-np.minimum(posterior[graph.other[of_kind]], 1 - 1e-6))
        none = np.bincount(graph.site[of_kind], doubt, minlength=len(posterior))
        has = -np.expm1(none)
        right, wrong = (
            (group_sums(weight * has, frame, frames) + prior * rules.companion_share)
            / (group_sums(weight, frame, frames) + prior)
            for weight in (posterior, 1 - posterior)
        )
        with_one, without = np.log(right / wrong), np.log((1 - right) / (1 - wrong))
        tells = with_one > rules.least_companion_ratio
        with_one, without = (
            broadcast_groups(np.where(tells, term, 0.0), frame) for term in (with_one, without)
        )
        most = rules.most_companion
        gain += np.clip(has * with_one + (1 - has) * without, -most, most)
    return gain
