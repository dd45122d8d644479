"""Step 1: triples of segments that can be one line, from all three orderings of the views."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from trinoc.geometry.arrays import ArrayLike
from trinoc.match.ends import COMPONENTS, end_evidence
from trinoc.match.evidence import Habits, log_odds, usual_habits
from trinoc.match.fragments import Prediction, cut_pair, points_of, predict
from trinoc.match.intervals import overlapping
from trinoc.match.likelihood import Strangers, TripleEvidence, triple_evidence
from trinoc.match.padding import blocks, in_blocks, padded
from trinoc.match.pencil import Pencil, PencilSegments, pencil
from trinoc.match.picture_index import Grid, PictureIndex
from trinoc.match.picture_lines import PictureLines
from trinoc.match.polarity import polarity_evidence
from trinoc.match.prediction_lookup import keys_of, lookup, segments_near
from trinoc.match.side_evidence import COMPONENTS as COMPONENTS_OF_SIDES
from trinoc.match.side_evidence import side_evidence
from trinoc.match.third_view import near

# About as many pairs are held at a time.
PAIRS_AT_A_TIME = 1 << 19
# Strangers are as dense about a segment as so many of its neighbours are.
NEIGHBOURHOOD = 25
# Of more candidates than this in one block, those with log odds below are not kept.
MANY, HOPELESS = 5000, -9.0
# Rows handed to a kernel at a time, few enough for a processor's cache, where pictures hold
# this many segments or more; fewer rows in proportion where they hold less.
PAIRS_IN_BLOCK, TRIPLES_IN_BLOCK, MANY_SEGMENTS = 1 << 14, 1 << 11, 1 << 9


class Candidates(NamedTuple):
    """Triples that can be one line; rows of each array belong together.

    index : segment in each of the views (-1 in views that take no part).
    part : common part on each segment. ends_mm : ends in space.
    chi_square, log_density, outer_mm, outer_covariance_mm2, px_per_mm : see TripleEvidence.
    end_log : see `end_evidence`. side_log : see `side_evidence`.
    """

    index: Int[np.ndarray, "m v"]
    part: Float[np.ndarray, "m v 2"]
    ends_mm: Float[np.ndarray, "m 2 3"]
    chi_square: Float[np.ndarray, "m"]
    log_density: Float[np.ndarray, "m"]
    end_log: Float[np.ndarray, "m 2 c"]
    outer_mm: Float[np.ndarray, "m 2 3"]
    outer_covariance_mm2: Float[np.ndarray, "m 2 6"]
    px_per_mm: Float[np.ndarray, "m"]
    side_log: Float[np.ndarray, "m s"]


def no_candidates(views: int) -> Candidates:
    """None at all, for as many views."""
    return Candidates(
        np.zeros((0, views), dtype=np.int64),
        np.zeros((0, views, 2)),
        np.zeros((0, 2, 3)),
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, 2, COMPONENTS)),
        np.zeros((0, 2, 3)),
        np.zeros((0, 2, 6)),
        np.zeros(0),
        np.zeros((0, len(COMPONENTS_OF_SIDES))),
    )


def joined_candidates(parts: list[Candidates]) -> Candidates:
    """Several sets as one, in order."""
    return Candidates(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def trinocular_candidates(
    lines: PictureLines, views: tuple[int, int, int], counts: list[int], strangers: Strangers
) -> Candidates:
    """All triples of three views; each is found from the pair of views that crosses best."""
    # Tables of three views, whichever and of how many, so that kernels compile once for all.
    three, own = _views_of(lines, strangers, np.array(views))
    numbers = [counts[view] for view in views]
    parts = [no_candidates(3)]
    for turn in range(3):
        parts += _in_order(three, np.roll(np.arange(3), turn), numbers, own)
    found = joined_candidates(parts)
    # Two orderings may find one triple where they cross about as well.
    i, j, k = found.index.T.astype(np.int64)
    once = np.unique((i * numbers[1] + j) * numbers[2] + k, return_index=True)[1]
    found = Candidates(*(column[once] for column in found))
    index = np.full((len(once), len(counts)), -1)
    part = np.zeros((len(once), len(counts), 2))
    index[:, views], part[:, views] = found.index, found.part
    return found._replace(index=index, part=part)


@jax.jit
def _views_of(
    lines: PictureLines, strangers: Strangers, views: Int[ArrayLike, "k"]
) -> tuple[PictureLines, Strangers]:
    densities = jnp.asarray(strangers.log_density)[views]
    return jax.tree.map(lambda table: table[views], lines), Strangers(densities, strangers[1])


def _in_order(
    lines: PictureLines, order: Int[np.ndarray, "3"], counts: list[int], strangers: Strangers
) -> Iterator[Candidates]:
    """Triples of which the first two views predict the third segment."""
    typical = float(np.mean([counts[view] for view in order]))
    table = lookup(lines, int(order[2]), counts[order[2]])
    planes = pencil(lines, order[0], order[1])
    for i, j in _pairs(planes, counts[order[0]], counts[order[1]]):
        triple = _triples(lines, order, planes, table, i, j)
        found = _judge(lines, order, planes, triple, strangers)
        yield _not_hopeless(found, typical) if len(found.index) > MANY else found


def _not_hopeless(found: Candidates, typical_count: float) -> Candidates:
    """Those that may yet be likely: most of what passes the gate is not, and takes memory."""
    habits = usual_habits(found.ends_mm, typical_count)
    # One block shows how large the volume is, but not yet where lines lie in it.
    everywhere = habits.volume._replace(precision=np.zeros((3, 3)))
    odds = odds_of(found, habits._replace(volume=everywhere))
    return Candidates(*(field[odds > HOPELESS] for field in found))


def _pairs(
    planes: Pencil, count_a: int, count_b: int
) -> Iterator[tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]]:
    """Pairs that share epipolar planes, in blocks of segments of the first view."""
    angles_a, angles_b = (
        np.stack([np.asarray(s.low)[:count], np.asarray(s.high)[:count]], axis=1)
        for s, count in ((planes.first, count_a), (planes.second, count_b))
    )
    # About one in four pairs shares epipolar planes.
    rows = max(1, 4 * PAIRS_AT_A_TIME // max(count_b, 1))
    for block in blocks(count_a, rows):
        i, j = overlapping(angles_a[block], angles_b)
        yield (i + block.start).astype(np.int32), j.astype(np.int32)


def block_of(lines: PictureLines, most: int) -> int:
    """Rows to hand over at a time: fewer where pictures hold little."""
    return min(most, most * lines.ends_px.shape[1] // MANY_SEGMENTS)


def _triples(
    lines: PictureLines,
    order: Int[np.ndarray, "3"],
    planes: Pencil,
    table: PictureIndex,
    i: Int[np.ndarray, "p"],
    j: Int[np.ndarray, "p"],
) -> Int[np.ndarray, "h 3"]:
    """(segments in the views of `order`) of what passes the gate in the third view."""
    size = block_of(lines, PAIRS_IN_BLOCK)
    found = [np.zeros((0, 3), dtype=np.int32)]
    for block in blocks(len(i), size):
        rows = padded(i[block], size), padded(j[block], size)
        guess, keys = _predicted(lines, order[2], planes, table.grid, *rows)
        keys = np.stack([np.asarray(key)[: block.stop - block.start] for key in keys])
        pair, k = segments_near(table, keys)

        def gated(pair: np.ndarray, k: np.ndarray, guess: Prediction = guess) -> ArrayLike:
            return _gated(lines, order[2], guess, pair, k)

        near_enough = in_blocks(gated, size, pair.astype(np.int32), k.astype(np.int32))
        pair, k = pair[near_enough], k[near_enough]
        # Several samples of one prediction may find one segment.
        once = np.unique(pair.astype(np.int64) * (k.max(initial=0) + 1) + k, return_index=True)[1]
        pair, k = pair[once] + block.start, k[once]
        found.append(np.stack([i[pair], j[pair], k], axis=1).astype(np.int32))
    return np.concatenate(found)


@jax.jit
def _predicted(
    lines: PictureLines,
    third: Int[ArrayLike, ""],
    planes: Pencil,
    grid: Grid,
    i: Int[ArrayLike, "p"],
    j: Int[ArrayLike, "p"],
) -> tuple[Prediction, list[Int[ArrayLike, "p"]]]:
    def predicted(i: ArrayLike, j: ArrayLike) -> tuple[Prediction, list[ArrayLike]]:
        guess = predict(lines, third, planes, row_of(planes.first, i), row_of(planes.second, j))
        return guess, keys_of(grid, guess)

    return jax.vmap(predicted)(i, j)


def row_of(table: PencilSegments, index: Int[ArrayLike, "*p"]) -> PencilSegments:
    """The segments of given numbers."""
    return jax.tree.map(lambda column: column[index], table)


@jax.jit
def _gated(
    lines: PictureLines,
    third: Int[ArrayLike, ""],
    guesses: Prediction,
    pair: Int[ArrayLike, "h"],
    k: Int[ArrayLike, "h"],
) -> Bool[ArrayLike, "h"]:
    def gated(pair: ArrayLike, k: ArrayLike) -> ArrayLike:
        guess = jax.tree.map(lambda column: column[pair], guesses)
        return near(
            guess, lines.ends_px[third, k], lines.line[third, k], lines.across_px2[third, k]
        )

    return jax.vmap(gated)(pair, k)


def _judge(
    lines: PictureLines,
    order: Int[np.ndarray, "3"],
    planes: Pencil,
    triple: Int[np.ndarray, "h 3"],
    strangers: Strangers,
) -> Candidates:
    def judged(triple: np.ndarray) -> tuple:
        return _judged(lines, order, planes, triple, strangers)

    found, end_log = in_blocks(judged, block_of(lines, TRIPLES_IN_BLOCK), triple)
    keep = np.flatnonzero(found.possible)
    index = np.full((len(keep), len(lines.size_px)), -1)
    part = np.zeros((len(keep), len(lines.size_px), 2))
    index[:, order] = triple[keep]
    part[:, order] = stacked(found.part, keep)
    return Candidates(
        index,
        part,
        stacked(found.ends_mm, keep),
        found.chi_square[keep],
        found.log_density[keep] + polarity_evidence(np.asarray(lines.polarity), index, part),
        stacked(end_log, keep),
        stacked(found.outer_mm, keep),
        stacked(found.outer_covariance_mm2, keep),
        found.px_per_mm[keep],
        side_evidence(np.asarray(lines.sides), index, part),
    )


def stacked(columns: tuple, keep: Int[np.ndarray, "m"] | slice) -> Float[np.ndarray, "m a b"]:
    """Tuples of tuples of columns as one array, with the items in front."""
    return np.stack([np.stack([c[keep] for c in row], axis=1) for row in columns], axis=1)


@jax.jit
def _judged(
    lines: PictureLines,
    order: Int[ArrayLike, "3"],
    planes: Pencil,
    triple: Int[ArrayLike, "h 3"],
    strangers: Strangers,
) -> tuple[TripleEvidence, tuple[tuple[Float[ArrayLike, "h"], ...], ...]]:
    def judge(segments: Int[ArrayLike, "3"]) -> tuple[TripleEvidence, tuple]:
        first, second = row_of(planes.first, segments[0]), row_of(planes.second, segments[1])
        near_mm = points_of(planes, cut_pair(planes.baseline_mm, first, second))
        first = triple_evidence(lines, order, segments, near_mm, strangers)
        # Once more on the line fitted to all three: then it does not matter which pair came first.
        evidence = triple_evidence(lines, order, segments, first.ends_mm, strangers)
        evidence = evidence._replace(possible=first.possible & evidence.possible)
        return evidence, end_evidence(evidence.extent_px)

    return jax.vmap(judge)(jnp.asarray(triple))


def odds_of(candidates: Candidates, habits: Habits) -> Float[np.ndarray, "m"]:
    """Log odds of each on its own evidence."""
    c = candidates
    return log_odds(c.chi_square, c.log_density, c.end_log, c.ends_mm, c.side_log, habits)


def in_depth_range(
    candidates: Candidates, lines: PictureLines, depth_range_mm: tuple[float, float]
) -> Bool[np.ndarray, "m"]:
    """Whether the ends lie within a range of depths before every camera that sees them."""
    matrix = np.asarray(lines.matrix_px)
    depth = np.einsum("vi,mei->mve", matrix[:, 2, :3], candidates.ends_mm) + matrix[:, 2, 3:]
    near, far = depth_range_mm
    inside = ((depth > near) & (depth < far)).all(axis=2) | (candidates.index < 0)
    return inside.all(axis=1)


def strangers_of(lines: PictureLines, counts: list[int]) -> Strangers:
    """What segments that belong to nothing look like, from all segments of the pictures."""
    density, lengths = [], []
    for view, count in enumerate(counts):
        middle = np.asarray(lines.ends_px[view])[:count].mean(axis=1)
        lengths.append(np.asarray(lines.length_px[view])[:count])
        area = float(np.prod(np.asarray(lines.size_px[view])))
        if count > 2:
            # Segments often fill only a part of the picture: that of a box with their spread.
            spread = np.sqrt(np.linalg.det(np.cov(middle.T)))
            area = min(area, max(12 * float(spread), 1e-3 * area))
        everywhere = max(count, 1) / area
        here = np.full(lines.ends_px.shape[1], everywhere)
        if count > NEIGHBOURHOOD:
            # Texture and the rims of shadows put many strangers in one place.
            distance = KDTree(middle).query(middle, NEIGHBOURHOOD + 1)[0][:, -1]
            local = NEIGHBOURHOOD / (np.pi * np.maximum(distance, 1.0) ** 2)
            here[:count] = np.maximum(everywhere, local)
        density.append(np.log(here / np.pi))
    all_lengths = np.concatenate(lengths)
    return Strangers(
        np.array(density), np.median(all_lengths) if len(all_lengths) else np.array(1.0)
    )
