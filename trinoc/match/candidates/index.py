"""Spatial index of the segments of one view, by position and direction.

A pair predicts the position in a third view to a fraction of a pixel, but the direction of a short
pair is known only to degrees. The index therefore sorts segments by position first, into all square
cells that a segment enters. Inside a cell, it sorts segments by direction, into sectors. The index
has several layers. Fine sectors are for precise predictions, coarse sectors with wider margins for
others, and one layer contains all directions. Images with many segments have one finer layer,
because rejecting wrong entries takes longer there than building the index.
"""

import functools
import math
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates.third_view import Prediction, rounding_px
from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.candidates import CandidateTuning
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.joins import (
    broadcast_groups,
    expand_ranges,
    group_medians,
    group_sums,
)
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.vectors import Scalar, Vector2


class IndexLayer(NamedTuple):
    """One layer of the spatial index, for predictions of a certain accuracy.

    Attributes
    ----------
    sectors : int
        Number of direction sectors in 180 degrees.
    slack_rad : float
        Largest direction error of a prediction that uses this layer.
    sigmas : float
        Largest position sigma of a prediction that uses this layer, in units of the segments'
        typical sigma.
    cell_scale : float
        Side of the layer's cells, in units of the side `cell_px` that `spatial_index` receives.
    """

    sectors: int
    slack_rad: float
    sigmas: float
    cell_scale: float


# numerical: the layers do not affect the result.
LAYERS = (
    IndexLayer(24, math.radians(3.0), 1.5, 1),
    IndexLayer(6, math.radians(15.0), 3.0, 2),
    IndexLayer(1, math.pi, 6.0, 4),
)
# numerical: layers for many segments.
CROWDED_LAYERS = (
    IndexLayer(36, math.radians(2.0), 1.2, 0.75),
    IndexLayer(24, math.radians(4.0), 1.5, 1),
    *LAYERS[1:],
)


class Grid(NamedTuple):
    """Square cells over an image, numbered row by row, in each of l layers of a spatial index.

    In a stack of frames, all attributes have a leading axis of frames.

    Attributes
    ----------
    sigma_px : ()
        Typical standard deviation of a segment's position, perpendicular to the segment.
    cell_px : (l,)
        Side of the cells of each layer.
    columns, rows : (l,)
        Number of cells of each layer along u and along v.
    first : (l + 1,)
        First key of each layer. The last value is a key that has no segments.
    """

    sigma_px: Float[ArrayLike, "*f"]
    cell_px: Float[ArrayLike, "*f l"]
    columns: Int[ArrayLike, "*f l"]
    rows: Int[ArrayLike, "*f l"]
    first: Int[ArrayLike, "*f l+1"]


class SpatialIndex(NamedTuple):
    """Lists of segments, one list for each cell and direction sector of each layer.

    The key of a list is first key of the layer + cell * sectors + sector.

    Attributes
    ----------
    start, count : (keys,)
        Position of each list in `segment`, and its length.
    segment : (entries,)
        Segment indices, list after list.
    """

    grid: Grid
    start: Int[np.ndarray, "keys"]
    count: Int[np.ndarray, "keys"]
    segment: Int[np.ndarray, "entries"]


def spatial_index(
    ends_px: Float[np.ndarray, "n 2 2"],
    slack_rad: Float[np.ndarray, "n"],
    margins_px: Float[np.ndarray, "l n"],
    size_px: Float[np.ndarray, "*f 2"],
    cell_px: Float[np.ndarray, "*f"] | float,
    sigma_px: Float[np.ndarray, "*f"] | float,
    frame: Int[np.ndarray, "n"] | None = None,
    layers: tuple[IndexLayer, ...] = LAYERS,
) -> SpatialIndex:
    """Build the spatial index of the segments of a view.

    In each layer, a segment is listed in every cell within its margin. In these cells, the segment
    is listed in several sectors: those within `slack_rad`, plus the layer's `slack_rad`, of its
    direction.

    Parameters
    ----------
    ends_px : (n, 2, 2)
        Ends of the segments.
    slack_rad : (n,)
        Direction error of each segment.
    margins_px : (l, n)
        Margin of each segment in each layer.
    size_px : (2,) or (f, 2)
        Width and height of the image, for each frame of a stack.
    cell_px : float or (f,)
        Side of the cells of a layer with `cell_scale` 1.
    sigma_px : float or (f,)
        Typical standard deviation of a segment's position, perpendicular to the segment.
    frame : (n,), optional
        Frame of each segment in a stack. Each frame has its own cells.
    layers : tuple of IndexLayer
        Layers of the index, the finest first.
    """
    grid = _grid(size_px, np.asarray(cell_px, dtype=np.float64), np.asarray(sigma_px), layers)
    # Grid values of each segment's frame.
    frame_of_segment = np.zeros(len(ends_px), np.int64) if frame is None else frame
    cells_px, columns, rows, first_key = (np.atleast_2d(x)[frame_of_segment] for x in grid[1:])
    step = ends_px[:, 1] - ends_px[:, 0]
    angle = np.arctan2(step[:, 1], step[:, 0])

    def sector_number(angle: Float[np.ndarray, "n"], sectors: int) -> Int[np.ndarray, "n"]:
        turns = np.floor(angle / np.pi)
        remainder = angle - np.pi * turns
        return np.floor(
            (turns + _half_turn_fraction(np.cos(remainder), np.sin(remainder))) * sectors
        ).astype(int)

    entries = []
    for layer_number, layer in enumerate(layers):
        shape = np.stack([columns[:, layer_number], rows[:, layer_number]], axis=1)
        segment, column, row = _cells_near_segments(
            ends_px, margins_px[layer_number], cells_px[:, layer_number], shape
        )
        cell = row * columns[segment, layer_number] + column
        slack = slack_rad + layer.slack_rad
        first, last = (sector_number(angle + side * slack, layer.sectors) for side in (-1, 1))
        last = np.minimum(last, first + layer.sectors - 1)
        entry, sector = expand_ranges(first[segment], last[segment] + 1)
        key = first_key[segment, layer_number] + cell * layer.sectors
        key = key[entry] + np.mod(sector, layer.sectors)
        # One number holds key and segment: sorting it is several times faster than an argsort.
        entries.append((key.astype(np.int64) << 32) | segment[entry])
    ordered = np.sort(np.concatenate(entries))
    key = ordered >> 32
    first_entry = np.flatnonzero(np.diff(key, prepend=-1))
    entries_of_key = np.diff(first_entry, append=len(key))
    # Most keys have no entries. Counts have 16 bits if possible, because every prediction reads
    # them.
    keys, fits_16_bit = int(np.max(grid.first)) + 1, entries_of_key.max(initial=0) < 1 << 16
    start, count = np.zeros(keys, np.int32), np.zeros(keys, np.uint16 if fits_16_bit else np.int32)
    start[key[first_entry]], count[key[first_entry]] = first_entry, entries_of_key
    return SpatialIndex(grid, start, count, (ordered & 0xFFFFFFFF).astype(np.int32))


def _half_turn_fraction(u: Any, v: Any) -> Any:
    """Map the direction (u, v), v >= 0, to a number that grows with its angle: 0 at 0, 1 at 180
    degrees.

    The function is not linear in the angle. It needs no arc tangent, so it is fast.
    """
    xp = array_namespace(u, v)
    share = v / (abs(u) + v) / 2
    return xp.where(u >= 0, share, 1 - share)


def _grid(
    size_px: Float[np.ndarray, "*f 2"],
    cell_px: Float[np.ndarray, "*f"],
    sigma_px: Float[np.ndarray, "*f"],
    layers: tuple[IndexLayer, ...],
) -> Grid:
    cells_px = cell_px[..., None] * np.array(
        [layer.cell_scale for layer in layers], dtype=np.float64
    )
    columns, rows = np.ceil(np.moveaxis(size_px, -1, 0)[..., None] / cells_px).astype(np.int32)
    keys = columns * rows * np.array([layer.sectors for layer in layers], dtype=np.int32)
    zero = np.zeros_like(keys[..., :1])
    first = np.concatenate([zero, np.cumsum(keys, axis=-1, dtype=np.int32)], axis=-1)
    if first.ndim > 1:
        # Keys of consecutive frames are consecutive, each with its key without entries last.
        keys_of_frame = first[:, -1] + 1
        first = first + (np.cumsum(keys_of_frame) - keys_of_frame)[:, None].astype(np.int32)
    return Grid(sigma_px, cells_px, columns, rows, first)


def _cells_near_segments(
    ends_px: Float[np.ndarray, "n 2 2"],
    margin_px: Float[np.ndarray, "n"],
    cell_px: Float[np.ndarray, "n"],
    shape: Int[np.ndarray, "n 2"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return all cells within the margin of each segment, as arrays (segment, column, row).

    A few cells farther away are included; cells outside the image are not. `shape` is the number of
    columns and rows of the grid of each segment.
    """
    steep = np.abs(ends_px[:, 1, 1] - ends_px[:, 0, 1]) > np.abs(
        ends_px[:, 1, 0] - ends_px[:, 0, 0]
    )
    # Follow the coordinate of the longer side: u for a flat segment, v for a steep one.
    along_px = np.where(steep[:, None], ends_px[..., 1], ends_px[..., 0])
    across_px = np.where(steep[:, None], ends_px[..., 0], ends_px[..., 1])
    low, high = along_px.min(axis=1), along_px.max(axis=1)
    slope = (across_px[:, 1] - across_px[:, 0]) / (along_px[:, 1] - along_px[:, 0])
    along_cells, across_cells = np.where(steep[:, None], shape[:, ::-1], shape).T

    def clip_cells(
        low_px: np.ndarray, high_px: np.ndarray, side_px: np.ndarray, count: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        first, last = np.floor(low_px / side_px), np.floor(high_px / side_px)
        clipped_range = np.clip(first, 0, count), np.clip(last + 1, 0, count)
        return expand_ranges(*(bound.astype(int) for bound in clipped_range))

    segment, along_cell = clip_cells(low - margin_px, high + margin_px, cell_px, along_cells)

    def other_coordinate(position_px: np.ndarray) -> np.ndarray:
        clipped_px = np.clip(position_px, low[segment], high[segment])
        return across_px[segment, 0] + slope[segment] * (clipped_px - along_px[segment, 0])

    side = cell_px[segment]
    start_px = other_coordinate(along_cell * side)
    stop_px = other_coordinate((along_cell + 1) * side)
    # The margin is measured along rows or columns, which lengthens it for a slanting segment.
    margin = (margin_px * np.sqrt(1 + slope**2))[segment]
    entry, across_cell = clip_cells(
        np.minimum(start_px, stop_px) - margin,
        np.maximum(start_px, stop_px) + margin,
        side,
        across_cells[segment],
    )
    segment, along_cell = segment[entry], along_cell[entry]
    return (
        segment,
        np.where(steep[segment], across_cell, along_cell),
        np.where(steep[segment], along_cell, across_cell),
    )


def layers_of_grid(grid: Grid) -> tuple[IndexLayer, ...]:
    """Return the layers that `grid` was built with, inferred from their number."""
    return LAYERS if np.shape(grid.cell_px)[-1] == len(LAYERS) else CROWDED_LAYERS


def search_keys(
    grid: Grid,
    points_px: Sequence[Vector2],
    direction: Vector2,
    slack_rad: Scalar,
    sigma_px: Scalar,
) -> list[ArrayLike]:
    """Return, for each point, the key of the index under which to search for a predicted segment.

    The key belongs to the finest layer that allows for the errors of the prediction. The result is
    the key without segments if no layer does, or if the point lies outside the image.

    Parameters
    ----------
    grid : cells of the index.
    points_px : points of the predicted segment.
    direction : direction of the predicted segment, with either sign.
    slack_rad : direction error of the prediction.
    sigma_px : standard deviation of the points.
    """
    empty_key, layers = grid.first[-1], layers_of_grid(grid)
    fits_layer = [
        (slack_rad < layer.slack_rad) & (sigma_px < layer.sigmas * grid.sigma_px)
        for layer in layers
    ]

    def select_layer(values: Sequence[ArrayLike]) -> ArrayLike:
        selected = jnp.asarray(values[-1])
        for layer_number in reversed(range(len(layers) - 1)):
            selected = jnp.where(
                fits_layer[layer_number], jnp.asarray(values[layer_number]), selected
            )
        return selected

    layer_numbers = range(len(layers))
    side, columns, rows, first = (
        select_layer([column[layer_number] for layer_number in layer_numbers])
        for column in (grid.cell_px, grid.columns, grid.rows, grid.first)
    )
    sectors = select_layer(list(np.array([layer.sectors for layer in layers], dtype=np.int32)))
    u, v = direction
    turns = _half_turn_fraction(jnp.where(v < 0, -u, u), abs(v))
    sector = jnp.floor(turns * sectors.astype(turns.dtype)).astype(jnp.int32)
    sector = jnp.minimum(sector, sectors - 1)
    fits_any_layer = functools.reduce(operator.or_, fits_layer)
    keys: list[ArrayLike] = []
    for u_px, v_px in points_px:
        column, row = (jnp.floor(x / side).astype(jnp.int32) for x in (u_px, v_px))
        is_inside = fits_any_layer & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        key = first + (row * columns + column) * sectors + sector
        keys.append(jnp.where(is_inside, key, empty_key))
    return keys


def look_up_segments(
    index: SpatialIndex, key: Int[np.ndarray, "q"]
) -> tuple[Int[np.ndarray, "hits"], Int[np.ndarray, "hits"]]:
    """Return the segments listed under the keys (q,), as two arrays of equal length.

    The first array is the position in `key` of each hit, the second array the segment.
    """
    count = index.count[key]
    queries = np.flatnonzero(count).astype(np.int32)
    count = count[queries].astype(np.int32)
    stop = np.cumsum(count, dtype=np.int32)
    position = np.arange(stop[-1] if len(stop) else 0, dtype=np.int32)
    position += np.repeat(index.start[key[queries]] - stop + count, count)
    return np.repeat(queries, count), index.segment[position]


# numerical: sample points of a prediction, as shares of its length, the middle first.
SAMPLES = (0.5, 1 / 6, 5 / 6)
# numerical: the finest cells are at least CELL_SIGMAS standard deviations wide. Their number along
# the longer side of the image is CELLS sqrt(n) for n segments, at most n / SEGMENTS_OF_CELL because
# building the table dominates for few segments, clipped to MIN_CELLS .. MAX_CELLS.
CELL_SIGMAS, CELLS, SEGMENTS_OF_CELL, MIN_CELLS, MAX_CELLS = 8.0, 3.0, 8, 8, 320
# numerical: images with more segments have a finer layer.
MANY_SEGMENTS = 1 << 14


def index_segments(
    lines: SegmentTable, view: int, count: int, tuning: CandidateTuning = DEFAULT.candidates
) -> SpatialIndex:
    """Build the spatial index of the first `count` segments of a view. Later rows are padding."""
    ends, size = np.asarray(lines.ends_px)[view, :count], np.asarray(lines.size_px)[..., view, :]
    length, across = np.asarray(lines.length_px), np.asarray(lines.across_px2)
    sigma = np.sqrt(across[view, :count, [0, 1], [0, 1]].max(axis=0))
    rounding = rounding_px(np.asarray(lines.matrix_px), view)
    frame = None if lines.frame is None else np.asarray(lines.frame)[view, :count]
    frames = int(np.prod(size.shape[:-1]))
    sigma = np.maximum(sigma, broadcast_groups(rounding, frame))
    typical = group_medians(sigma, frame, frames)
    typical = np.where(np.isfinite(typical), typical, 1.0)
    sigmas = tuning.search_sigmas
    layers = LAYERS if count <= MANY_SEGMENTS or frame is not None else CROWDED_LAYERS
    prediction_sigma = broadcast_groups(typical, frame) * np.array(
        [[layer.sigmas] for layer in layers]
    )
    margins = sigmas * np.hypot(sigma, prediction_sigma)
    slack = sigmas * np.sqrt(2) * sigma / length[view, :count]
    segment_count = group_sums(np.ones(count), frame, frames)
    cell_count = np.minimum(CELLS * np.sqrt(segment_count), segment_count / SEGMENTS_OF_CELL)
    cell_count = np.clip(cell_count, MIN_CELLS, MAX_CELLS)
    cell_px = np.maximum(CELL_SIGMAS * typical, size.max(axis=-1) / cell_count)
    return spatial_index(ends, slack, margins, size, cell_px, typical, frame, layers)


def keys_of_prediction(
    grid: Grid, prediction: Prediction, tuning: CandidateTuning = DEFAULT.candidates
) -> list[Int[ArrayLike, ""]]:
    """Return the key to search at each sample point of a predicted segment.

    Samples that need no search get the key without segments: repeated keys, and samples of short or
    impossible predictions.
    """
    du, dv = prediction.u1 - prediction.u0, prediction.v1 - prediction.v0
    length = jnp.sqrt(du * du + dv * dv)
    slack = (
        tuning.search_sigmas
        * jnp.sqrt(prediction.c00 + prediction.c11 - 2 * prediction.c01)
        / length
    )
    sigma = jnp.sqrt(jnp.maximum(prediction.c00, prediction.c11))
    points = [(prediction.u0 + sample * du, prediction.v0 + sample * dv) for sample in SAMPLES]
    keys = search_keys(grid, points, (du, dv), slack, sigma)
    empty_key, is_possible = grid.first[-1], prediction.possible
    for k in range(1, len(SAMPLES)):
        # Equal keys of two samples are searched once.
        is_new = jnp.stack([keys[k] != earlier_key for earlier_key in keys[:k]]).all(axis=0)
        keys[k] = jnp.where(
            is_possible & is_new & (length > tuning.one_sample_px), keys[k], empty_key
        )
    return [jnp.where(is_possible, keys[0], empty_key), *keys[1:]]


def find_segments_near_predictions(
    table: SpatialIndex, keys: Int[np.ndarray, "s p"]
) -> tuple[Int[np.ndarray, "hits"], Int[np.ndarray, "hits"]]:
    """Return the segments listed near each prediction, as arrays (prediction, segment).

    `keys` (s, p) are the keys of s sample points of p predictions. A segment that is near two
    samples is returned twice.
    """
    query, segment = look_up_segments(table, keys.reshape(-1))
    return query % keys.shape[1], segment
