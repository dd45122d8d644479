"""Search for segments of the third view at the positions that pairs of the first two predict."""

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
    index_segments,
    keys_of_prediction,
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
    """True if a segment overlaps the predicted segment and agrees with its position and direction.

    The chi-square of the distances between the two lines, at both ends of their overlap, must be
    below a limit. `line` are the coefficients of the segment's line. `across_px2` is the covariance
    of the segment's ends across the segment.
    """
    p = prediction
    du, dv = p.u1 - p.u0, p.v1 - p.v0
    squared = du * du + dv * dv

    def position(e: int) -> Scalar:
        return ((ends_px[e, 0] - p.u0) * du + (ends_px[e, 1] - p.v0) * dv) / squared

    first, second = position(0), position(1)
    begin = jnp.maximum(0.0, jnp.minimum(first, second))
    end = jnp.minimum(1.0, jnp.maximum(first, second))
    extent = second - first
    overlaps = end - begin > tuning.smallest_overlap * jnp.minimum(1.0, jnp.abs(extent))

    distance0 = line[0] * p.u0 + line[1] * p.v0 + line[2]
    distance1 = line[0] * p.u1 + line[1] * p.v1 + line[2]
    r0, r1 = distance0 + begin * (distance1 - distance0), distance0 + end * (distance1 - distance0)
    line_covariance = (p.c00, p.c01, p.c11)
    segment_covariance = (across_px2[0, 0], across_px2[0, 1], across_px2[1, 1])
    s, t = (begin - first) / extent, (end - first) / extent
    v00 = interpolated_covariance(line_covariance, begin, begin) + interpolated_covariance(
        segment_covariance, s, s
    )
    v11 = interpolated_covariance(line_covariance, end, end) + interpolated_covariance(
        segment_covariance, t, t
    )
    v01 = interpolated_covariance(line_covariance, begin, end) + interpolated_covariance(
        segment_covariance, s, t
    )
    determinant = v00 * v11 - v01 * v01
    chi_square = (v11 * r0 * r0 - 2 * v01 * r0 * r1 + v00 * r1 * r1) / determinant
    return p.possible & overlaps & (chi_square < tuning.gate_slack * tuning.gate)


class Order(NamedTuple):
    """Search data for one ordering (first, second, third) of three views.

    Pairs of segments of the first and the second view predict segments of the third view.

    Attributes
    ----------
    order : (3,)
        Indices of the views.
    planes : Pencil
        Pencil of epipolar planes of the first two views.
    inputs : PredictionInput
        Data of the predictions.
    table : SpatialIndex
        Spatial index of the third view's segments.
    """

    order: Int[np.ndarray, "3"]
    planes: Pencil
    inputs: PredictionInput
    table: SpatialIndex


class Orders(NamedTuple):
    """Segments of three views, and the search data of their three cyclic orderings.

    Attributes
    ----------
    views : (int, int, int)
        The three views, as indices among all views.
    counts : list of int
        Number of segments of every view, not only of the three.
    lines : SegmentTable
        Segments of the three views.
    clutter : ClutterModel
        Clutter model of the three views.
    orders : list of Order
        Search data of each ordering.
    """

    views: tuple[int, int, int]
    counts: list[int]
    lines: SegmentTable
    clutter: ClutterModel
    orders: list[Order]

    @property
    def counts_of_three(self) -> list[int]:
        """Number of segments in each of the three views."""
        return [self.counts[view] for view in self.views]


def prepare_orders(
    lines: SegmentTable,
    views: tuple[int, int, int],
    counts: list[int],
    clutter: ClutterModel,
    tuning: MatchTuning = DEFAULT,
) -> Orders:
    """Build the search data of the three cyclic orderings of three views."""
    # Tables always have three views, so that kernels are compiled once.
    if views != tuple(range(len(counts))):
        lines, clutter = _take_views(lines, clutter, np.array(views))
    orders = []
    for turn in range(3):
        order = np.roll(np.arange(3), turn)
        third = int(order[2])
        table = index_segments(lines, third, counts[views[third]], tuning.candidates)
        orders.append(Order(order, *prepare_order(lines, order), table))
    return Orders(views, counts, lines, clutter, orders)


@jax.jit
def _take_views(
    lines: SegmentTable, clutter: ClutterModel, views: Int[ArrayLike, "k"]
) -> tuple[SegmentTable, ClutterModel]:
    densities = jnp.asarray(clutter.log_density)[views]
    cameras = ("matrix_px", "centre_mm", "inverse", "size_px")
    camera_columns = {name: getattr(lines, name) for name in cameras}
    if lines.frame is not None:
        camera_columns = {
            name: jnp.moveaxis(column, 1, 0) for name, column in camera_columns.items()
        }
    selected = jax.tree.map(lambda table: table[views], lines._replace(**camera_columns))
    if lines.frame is not None:
        restored = {name: jnp.moveaxis(getattr(selected, name), 0, 1) for name in cameras}
        selected = selected._replace(**restored)
    return selected, ClutterModel(densities, clutter.typical_px)


def gate_triples(
    lines: SegmentTable,
    inputs: PredictionInput,
    table: SpatialIndex,
    i: Int[np.ndarray, "p"],
    j: Int[np.ndarray, "p"],
    tuning: CandidateTuning,
    any_order: bool = False,
) -> Int[np.ndarray, "h 3"]:
    """Return the triples (h, 3) of each pair (i, j) with every third segment near its prediction.

    The columns of the result are segments of the first, second and third view of `inputs`. A pair
    predicts only if its interpretation planes cross at nearly the widest angle of the three planes.
    With `any_order`, other pairs predict too if their prediction is precise.
    """
    size = block_size(lines, PAIRS_IN_BLOCK)
    triples = [np.zeros((0, 3), dtype=np.int32)]
    for block in blocks(len(i), size):
        rows = pad_rows(i[block], size), pad_rows(j[block], size)
        prediction, keys = _predict_pairs(
            inputs, table.grid, *rows, np.asarray(any_order), tuning=tuning
        )
        keys = np.stack([np.asarray(key)[: block.stop - block.start] for key in keys])
        pair, k = find_segments_near_predictions(table, keys)

        def passes(
            pair: np.ndarray, k: np.ndarray, prediction: Prediction = prediction
        ) -> ArrayLike:
            return _passes_gate(inputs.segments, prediction, pair, k, tuning=tuning)

        is_near = in_blocks(passes, size, pair, k)
        # Several samples of one prediction may give the same segment.
        hits = np.unique((pair[is_near].astype(np.int64) << 32) | k[is_near])
        pair, k = (hits >> 32) + block.start, hits & 0xFFFFFFFF
        triples.append(np.stack([i[pair], j[pair], k], axis=1).astype(np.int32))
    return np.concatenate(triples)


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
        cameras = inputs.view, grid
        if inputs.frame is not None:
            frame = inputs.frame[i]
            cameras = jax.tree.map(lambda column: column[frame], cameras)
        prediction = predict(cameras[0], first, second, tuning, any_order)
        return prediction, keys_of_prediction(cameras[1], prediction, tuning)

    pairs = take_segments(inputs.first, i), take_segments(inputs.second, j)
    return jax.vmap(predict_pair, in_axes=(0, 1, 1))(i, *pairs)


@partial(kept_jit, static_argnames=("tuning",), optimized_from=0)
def _passes_gate(
    segments: Float[ArrayLike, "n 11"],
    predictions: Prediction,
    pair: Int[ArrayLike, "h"],
    k: Int[ArrayLike, "h"],
    tuning: CandidateTuning,
) -> Bool[ArrayLike, "h"]:
    def passes(pair: ArrayLike, k: ArrayLike) -> ArrayLike:
        prediction, segment = jax.tree.map(lambda column: column[pair], predictions), segments[k]
        columns = segment[:4].reshape(2, 2), segment[4:7], segment[7:].reshape(2, 2)
        return passes_third_view_gate(prediction, *columns, tuning)

    return jax.vmap(passes)(pair, k)
