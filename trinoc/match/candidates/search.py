"""Which segments of the third view are where pairs of the first two predict them.

Whether a segment of the third view is near enough to what a pair predicts.

What a search for triples in three views needs, prepared once for all that is asked of it.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates.index import (
    Grid,
    SpatialIndex,
    find_segments_near_predictions,
    lookup,
    prediction_keys,
)
from trinoc.match.candidates.third_view import (
    Prediction,
    PredictionInput,
    predict,
    prepare_order,
)
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.observations.table import PAIRS_IN_BLOCK, SegmentTable, block_size
from trinoc.match.tuning.candidates import CandidateTuning
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.two_view.epipolar_pencil import Pencil, PencilSegments, take_segments
from trinoc.numerics.buckets import blocks, in_blocks, pad_rows
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.vectors import Scalar, interpolated_covariance


def passes_third_view_gate(
    prediction: Prediction,
    ends_px: Float[ArrayLike, "2 2"],
    line: Float[ArrayLike, "3"],
    across_px2: Float[ArrayLike, "2 2"],
    tuning: CandidateTuning = DEFAULT.candidates,
) -> Bool[ArrayLike, ""]:
    """Whether a segment overlaps the predicted one, and passes the gate where it does."""
    p = prediction
    du, dv = p.u1 - p.u0, p.v1 - p.v0
    squared = du * du + dv * dv

    def position(e: int) -> Scalar:
        return ((ends_px[e, 0] - p.u0) * du + (ends_px[e, 1] - p.v0) * dv) / squared

    first, second = position(0), position(1)
    begin = jnp.maximum(0.0, jnp.minimum(first, second))
    end = jnp.minimum(1.0, jnp.maximum(first, second))
    reach = second - first
    overlaps = end - begin > tuning.smallest_overlap * jnp.minimum(1.0, jnp.abs(reach))

    off0 = line[0] * p.u0 + line[1] * p.v0 + line[2]
    off1 = line[0] * p.u1 + line[1] * p.v1 + line[2]
    r0, r1 = off0 + begin * (off1 - off0), off0 + end * (off1 - off0)
    predicted = (p.c00, p.c01, p.c11)
    own = (across_px2[0, 0], across_px2[0, 1], across_px2[1, 1])
    s, t = (begin - first) / reach, (end - first) / reach
    v00 = interpolated_covariance(predicted, begin, begin) + interpolated_covariance(own, s, s)
    v11 = interpolated_covariance(predicted, end, end) + interpolated_covariance(own, t, t)
    v01 = interpolated_covariance(predicted, begin, end) + interpolated_covariance(own, s, t)
    determinant = v00 * v11 - v01 * v01
    chi_square = (v11 * r0 * r0 - 2 * v01 * r0 * r1 + v00 * r1 * r1) / determinant
    return p.possible & overlaps & (chi_square < tuning.gate_slack * tuning.gate)


class Order(NamedTuple):
    """An ordering of the views: the pencil of the first two, what predictions in the third need of
    it, and the third by place and direction."""

    order: Int[np.ndarray, "3"]
    planes: Pencil
    inputs: PredictionInput
    table: SpatialIndex


class Orders(NamedTuple):
    """Tables of three of the views, `counts` of all of them, and the three orderings."""

    views: tuple[int, int, int]
    counts: list[int]
    lines: SegmentTable
    clutter: ClutterModel
    each: list[Order]

    @property
    def numbers(self) -> list[int]:
        """Segments of each of the three views."""
        return [self.counts[view] for view in self.views]


def prepare_orders(
    lines: SegmentTable,
    views: tuple[int, int, int],
    counts: list[int],
    clutter: ClutterModel,
    tuning: MatchTuning = DEFAULT,
) -> Orders:
    """Three of the views of a table, ready to be searched."""
    # Tables of three views, whichever and of how many, so that kernels compile once for all.
    if views != tuple(range(len(counts))):
        lines, clutter = _take_views(lines, clutter, np.array(views))
    each = []
    for turn in range(3):
        order = np.roll(np.arange(3), turn)
        third = int(order[2])
        table = lookup(lines, third, counts[views[third]], tuning.candidates)
        each.append(Order(order, *prepare_order(lines, order), table))
    return Orders(views, counts, lines, clutter, each)


@jax.jit
def _take_views(
    lines: SegmentTable, clutter: ClutterModel, views: Int[ArrayLike, "k"]
) -> tuple[SegmentTable, ClutterModel]:
    densities = jnp.asarray(clutter.log_density)[views]
    cameras = ("matrix_px", "centre_mm", "inverse", "size_px")
    shapes = {name: getattr(lines, name) for name in cameras}
    if lines.frame is not None:
        shapes = {name: jnp.moveaxis(column, 1, 0) for name, column in shapes.items()}
    three = jax.tree.map(lambda table: table[views], lines._replace(**shapes))
    if lines.frame is not None:
        moved = {name: jnp.moveaxis(getattr(three, name), 0, 1) for name in cameras}
        three = three._replace(**moved)
    return three, ClutterModel(densities, clutter.typical_px)


def gate_triples(
    lines: SegmentTable,
    inputs: PredictionInput,
    table: SpatialIndex,
    i: Int[np.ndarray, "p"],
    j: Int[np.ndarray, "p"],
    tuning: CandidateTuning,
    any_order: bool = False,
) -> Int[np.ndarray, "h 3"]:
    """(segments in the views of an order) of what passes the gate in the third view; in
    `any_order`, also of pairs that predict it worse than another pair of the three would."""
    size = block_size(lines, PAIRS_IN_BLOCK)
    found = [np.zeros((0, 3), dtype=np.int32)]
    for block in blocks(len(i), size):
        rows = pad_rows(i[block], size), pad_rows(j[block], size)
        guess, keys = _predict_pairs(
            inputs, table.grid, *rows, np.asarray(any_order), tuning=tuning
        )
        keys = np.stack([np.asarray(key)[: block.stop - block.start] for key in keys])
        pair, k = find_segments_near_predictions(table, keys)

        def passes(pair: np.ndarray, k: np.ndarray, guess: Prediction = guess) -> ArrayLike:
            return _passes_gate(inputs.segments, guess, pair, k, tuning=tuning)

        near_enough = in_blocks(passes, size, pair, k)
        # Several samples of one prediction may find one segment.
        both = np.unique((pair[near_enough].astype(np.int64) << 32) | k[near_enough])
        pair, k = (both >> 32) + block.start, both & 0xFFFFFFFF
        found.append(np.stack([i[pair], j[pair], k], axis=1).astype(np.int32))
    return np.concatenate(found)


@partial(kept_jit, static_argnames=("tuning",))
def _predict_pairs(
    inputs: PredictionInput,
    grid: Grid,
    i: Int[ArrayLike, "p"],
    j: Int[ArrayLike, "p"],
    any_order: Bool[ArrayLike, ""],
    tuning: CandidateTuning,
) -> tuple[Prediction, list[Int[ArrayLike, "_p"]]]:
    def predict_pair(
        i: ArrayLike, first: PencilSegments, second: PencilSegments
    ) -> tuple[Prediction, list[ArrayLike]]:
        own = inputs.view, grid
        if inputs.frame is not None:
            frame = inputs.frame[i]
            own = jax.tree.map(lambda column: column[frame], own)
        guess = predict(own[0], first, second, tuning, any_order)
        return guess, prediction_keys(own[1], guess, tuning)

    pairs = take_segments(inputs.first, i), take_segments(inputs.second, j)
    return jax.vmap(predict_pair, in_axes=(0, 1, 1))(i, *pairs)


@partial(kept_jit, static_argnames=("tuning",), optimized_from=0)
def _passes_gate(
    segments: Float[ArrayLike, "n 11"],
    guesses: Prediction,
    pair: Int[ArrayLike, "h"],
    k: Int[ArrayLike, "h"],
    tuning: CandidateTuning,
) -> Bool[ArrayLike, "h"]:
    def passes(pair: ArrayLike, k: ArrayLike) -> ArrayLike:
        guess, own = jax.tree.map(lambda column: column[pair], guesses), segments[k]
        columns = own[:4].reshape(2, 2), own[4:7], own[7:].reshape(2, 2)
        return passes_third_view_gate(guess, *columns, tuning)

    return jax.vmap(passes)(pair, k)
