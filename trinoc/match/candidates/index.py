"""Which segments of a picture pass a point in about a direction: a table of cells.

The place that a pair predicts in a third view is known to a fraction of a pixel, the direction
of a short pair only to degrees: so the table goes by place first, in square cells that a
segment enters wherever it passes, and by direction in sectors second. It has three layers: fine
sectors for predictions that are known well, coarse ones with wider margins for others, and one
of all directions for the rest. Crowded pictures have a finer one: there, what is looked up in vain
takes longer than the entries.

Segments of the third view near a prediction, by the table of cells.
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
    """Which predictions look into a layer of the table, and how fine it is.

    sectors : in half a turn. slack_rad, sigmas : the largest error allowed of the direction of
        a prediction, and of its place, in typical standard deviations of the segments.
    cell : side of the cells, over that of the table.
    """

    sectors: int
    slack_rad: float
    sigmas: float
    cell: float


# numerical: no answer depends on them.
LAYERS = (
    IndexLayer(24, math.radians(3.0), 1.5, 1),
    IndexLayer(6, math.radians(15.0), 3.0, 2),
    IndexLayer(1, math.pi, 6.0, 4),
)
# numerical: as above, finer.
CROWDED_LAYERS = (
    IndexLayer(36, math.radians(2.0), 1.2, 0.75),
    IndexLayer(24, math.radians(4.0), 1.5, 1),
    *LAYERS[1:],
)


class Grid(NamedTuple):
    """Square cells over a picture, in rows; fields of length l are of the layers.

    sigma_px : typical standard deviation of the segments. cell_px : sides of the cells.
    first : number of the first key of each layer; the last number is of a key without entries.
    Of each frame of a stack, as all fields are.
    """

    sigma_px: Float[ArrayLike, "*f"]
    cell_px: Float[ArrayLike, "*f l"]
    columns: Int[ArrayLike, "*f l"]
    rows: Int[ArrayLike, "*f l"]
    first: Int[ArrayLike, "*f l+1"]


class SpatialIndex(NamedTuple):
    """Segments sorted by key = first of layer + cell * sectors + sector.

    start, count : first entry and number of entries of each key. segment : the entries.
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
    """Enter each segment, in each layer, in every cell that it passes within the margin, and
    in each sector that holds a direction within `slack_rad` and the layer's slack of its own.

    Segments of a stack are entered in the cells of their own `frame`."""
    grid = _grid(size_px, np.asarray(cell_px, dtype=np.float64), np.asarray(sigma_px), layers)
    # Of each segment's own frame, or one for all.
    owners = np.zeros(len(ends_px), np.int64) if frame is None else frame
    cells_px, columns, rows, first_key = (np.atleast_2d(x)[owners] for x in grid[1:])
    step = ends_px[:, 1] - ends_px[:, 0]
    angle = np.arctan2(step[:, 1], step[:, 0])

    def sector_number(angle: Float[np.ndarray, "n"], sectors: int) -> Int[np.ndarray, "n"]:
        turns = np.floor(angle / np.pi)
        rest = angle - np.pi * turns
        return np.floor((turns + _half_turns(np.cos(rest), np.sin(rest))) * sectors).astype(int)

    entries = []
    for number, layer in enumerate(layers):
        shape = np.stack([columns[:, number], rows[:, number]], axis=1)
        owner, column, row = _cells_passed(ends_px, margins_px[number], cells_px[:, number], shape)
        cell = row * columns[owner, number] + column
        slack = slack_rad + layer.slack_rad
        first, last = (sector_number(angle + side * slack, layer.sectors) for side in (-1, 1))
        last = np.minimum(last, first + layer.sectors - 1)
        entry, turned = expand_ranges(first[owner], last[owner] + 1)
        key = first_key[owner, number] + cell * layer.sectors
        key = key[entry] + np.mod(turned, layer.sectors)
        # Key and segment in one number: sorting it is several times faster than by key.
        entries.append((key.astype(np.int64) << 32) | owner[entry])
    ordered = np.sort(np.concatenate(entries))
    key = ordered >> 32
    edge = np.flatnonzero(np.diff(key, prepend=-1))
    each = np.diff(edge, append=len(key))
    # Most keys have no entries. Counts are short numbers where they can be: every prediction
    # looks here.
    keys, small = int(np.max(grid.first)) + 1, each.max(initial=0) < 1 << 16
    start, count = np.zeros(keys, np.int32), np.zeros(keys, np.uint16 if small else np.int32)
    start[key[edge]], count[key[edge]] = edge, each
    return SpatialIndex(grid, start, count, (ordered & 0xFFFFFFFF).astype(np.int32))


def _half_turns(u: Any, v: Any) -> Any:
    """A direction from 0 to half a turn (v >= 0), as a number from 0 to 1 that grows with its
    angle, though not evenly: it takes no arc tangent."""
    xp = array_namespace(u, v)
    share = v / (abs(u) + v) / 2
    return xp.where(u >= 0, share, 1 - share)


def _grid(
    size_px: Float[np.ndarray, "*f 2"],
    cell_px: Float[np.ndarray, "*f"],
    sigma_px: Float[np.ndarray, "*f"],
    layers: tuple[IndexLayer, ...],
) -> Grid:
    cells_px = cell_px[..., None] * np.array([layer.cell for layer in layers], dtype=np.float64)
    columns, rows = np.ceil(np.moveaxis(size_px, -1, 0)[..., None] / cells_px).astype(np.int32)
    keys = columns * rows * np.array([layer.sectors for layer in layers], dtype=np.int32)
    none = np.zeros_like(keys[..., :1])
    first = np.concatenate([none, np.cumsum(keys, axis=-1, dtype=np.int32)], axis=-1)
    if first.ndim > 1:
        # The keys of each frame, and its one without entries, follow those of the one before.
        every = first[:, -1] + 1
        first = first + (np.cumsum(every) - every)[:, None].astype(np.int32)
    return Grid(sigma_px, cells_px, columns, rows, first)


def _cells_passed(
    ends_px: Float[np.ndarray, "n 2 2"],
    margin_px: Float[np.ndarray, "n"],
    cell_px: Float[np.ndarray, "n"],
    shape: Int[np.ndarray, "n 2"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(segment, column, row) of every cell within the margin of a segment, and of a few more.

    `shape` is how many columns and rows there are for each: cells outside are never counted, so
    that a segment has no more than these, however wide its margin."""
    steep = np.abs(ends_px[:, 1, 1] - ends_px[:, 0, 1]) > np.abs(
        ends_px[:, 1, 0] - ends_px[:, 0, 0]
    )
    # Walk along the longer side: u for a flat segment, v for a steep one.
    walk = np.where(steep[:, None], ends_px[..., 1], ends_px[..., 0])
    other = np.where(steep[:, None], ends_px[..., 0], ends_px[..., 1])
    low, high = walk.min(axis=1), walk.max(axis=1)
    slope = (other[:, 1] - other[:, 0]) / (walk[:, 1] - walk[:, 0])
    lengths, widths = np.where(steep[:, None], shape[:, ::-1], shape).T

    def clip_cells(
        least_px: np.ndarray, most_px: np.ndarray, side_px: np.ndarray, count: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        first, last = np.floor(least_px / side_px), np.floor(most_px / side_px)
        inside = np.clip(first, 0, count), np.clip(last + 1, 0, count)
        return expand_ranges(*(each.astype(int) for each in inside))

    owner, along = clip_cells(low - margin_px, high + margin_px, cell_px, lengths)

    def other_coordinate(place: np.ndarray) -> np.ndarray:
        reached = np.clip(place, low[owner], high[owner])
        return other[owner, 0] + slope[owner] * (reached - walk[owner, 0])

    side = cell_px[owner]
    left, right = other_coordinate(along * side), other_coordinate((along + 1) * side)
    # Across a slanting segment the margin is longer along the rows or columns.
    margin = (margin_px * np.sqrt(1 + slope**2))[owner]
    entry, across = clip_cells(
        np.minimum(left, right) - margin, np.maximum(left, right) + margin, side, widths[owner]
    )
    owner, along = owner[entry], along[entry]
    return owner, np.where(steep[owner], across, along), np.where(steep[owner], along, across)


def find_layers(grid: Grid) -> tuple[IndexLayer, ...]:
    """The layers of a table, by their number."""
    return LAYERS if np.shape(grid.cell_px)[-1] == len(LAYERS) else CROWDED_LAYERS


def find_keys(
    grid: Grid,
    points_px: Sequence[Vector2],
    direction: Vector2,
    slack_rad: Scalar,
    sigma_px: Scalar,
) -> list[ArrayLike]:
    """Where to look for a segment that passes each point, in about a direction.

    The direction, either way along, is known to `slack_rad`, the points to `sigma_px`: the keys are
    of the finest layer that allows for both, that without entries where none does, or where a
    point lies outside the picture.
    """
    nowhere, every = grid.first[-1], find_layers(grid)
    known = [
        (slack_rad < layer.slack_rad) & (sigma_px < layer.sigmas * grid.sigma_px) for layer in every
    ]

    def of_layer(values: Sequence[ArrayLike]) -> ArrayLike:
        chosen = jnp.asarray(values[-1])
        for number in reversed(range(len(every) - 1)):
            chosen = jnp.where(known[number], jnp.asarray(values[number]), chosen)
        return chosen

    layers = range(len(every))
    side, columns, rows, first = (
        of_layer([column[number] for number in layers])
        for column in (grid.cell_px, grid.columns, grid.rows, grid.first)
    )
    sectors = of_layer(list(np.array([layer.sectors for layer in every], dtype=np.int32)))
    u, v = direction
    turns = _half_turns(jnp.where(v < 0, -u, u), abs(v))
    sector = jnp.floor(turns * sectors.astype(turns.dtype)).astype(jnp.int32)
    sector = jnp.minimum(sector, sectors - 1)
    allowed = functools.reduce(operator.or_, known)
    keys: list[ArrayLike] = []
    for u_px, v_px in points_px:
        column, row = (jnp.floor(x / side).astype(jnp.int32) for x in (u_px, v_px))
        inside = allowed & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        key = first + (row * columns + column) * sectors + sector
        keys.append(jnp.where(inside, key, nowhere))
    return keys


def look_up_segments(
    index: SpatialIndex, key: Int[np.ndarray, "q"]
) -> tuple[Int[np.ndarray, "hits"], Int[np.ndarray, "hits"]]:
    """(query, segment) for every segment entered where a query looks."""
    count = index.count[key]
    asked = np.flatnonzero(count).astype(np.int32)
    count = count[asked].astype(np.int32)
    stop = np.cumsum(count, dtype=np.int32)
    position = np.arange(stop[-1] if len(stop) else 0, dtype=np.int32)
    position += np.repeat(index.start[key[asked]] - stop + count, count)
    return np.repeat(asked, count), index.segment[position]


# numerical: where a prediction is looked up, as shares of its length: its middle first.
SAMPLES = (0.5, 1 / 6, 5 / 6)
# numerical: finest cell: at least CELL_SIGMAS standard deviations wide. Along the longer side of
# the image there are CELLS sqrt(n) of them for n segments, and in small pictures, where the table
# takes longer than the looking up, one for so many segments; clipped to FEWEST .. MOST.
CELL_SIGMAS, CELLS, SEGMENTS_OF_CELL, FEWEST, MOST = 8.0, 3.0, 8, 8, 320
# numerical: pictures with more segments than this have finer layers.
CROWDED = 1 << 14


def lookup(
    lines: SegmentTable, view: int, count: int, tuning: CandidateTuning = DEFAULT.candidates
) -> SpatialIndex:
    """The segments of a view by place and direction."""
    ends, size = np.asarray(lines.ends_px)[view, :count], np.asarray(lines.size_px)[..., view, :]
    length, across = np.asarray(lines.length_px), np.asarray(lines.across_px2)
    sigma = np.sqrt(across[view, :count, [0, 1], [0, 1]].max(axis=0))
    rounding = rounding_px(np.asarray(lines.matrix_px), view)
    frame = None if lines.frame is None else np.asarray(lines.frame)[view, :count]
    frames = int(np.prod(size.shape[:-1]))
    sigma = np.maximum(sigma, broadcast_groups(rounding, frame))
    typical = group_medians(sigma, frame, frames)
    typical = np.where(np.isfinite(typical), typical, 1.0)
    reach = tuning.reach_sigmas
    layers = LAYERS if count <= CROWDED or frame is not None else CROWDED_LAYERS
    near = broadcast_groups(typical, frame) * np.array([[layer.sigmas] for layer in layers])
    margins = reach * np.hypot(sigma, near)
    slack = reach * np.sqrt(2) * sigma / length[view, :count]
    number = group_sums(np.ones(count), frame, frames)
    cells = np.minimum(CELLS * np.sqrt(number), number / SEGMENTS_OF_CELL)
    cells = np.clip(cells, FEWEST, MOST)
    cell = np.maximum(CELL_SIGMAS * typical, size.max(axis=-1) / cells)
    return spatial_index(ends, slack, margins, size, cell, typical, frame, layers)


def prediction_keys(
    grid: Grid, guess: Prediction, tuning: CandidateTuning = DEFAULT.candidates
) -> list[Int[ArrayLike, ""]]:
    """Where in the table to look for each sample of a prediction."""
    du, dv = guess.u1 - guess.u0, guess.v1 - guess.v0
    length = jnp.sqrt(du * du + dv * dv)
    slack = tuning.reach_sigmas * jnp.sqrt(guess.c00 + guess.c11 - 2 * guess.c01) / length
    sigma = jnp.sqrt(jnp.maximum(guess.c00, guess.c11))
    points = [(guess.u0 + sample * du, guess.v0 + sample * dv) for sample in SAMPLES]
    keys = find_keys(grid, points, (du, dv), slack, sigma)
    nowhere, asked = grid.first[-1], guess.possible
    for k in range(1, len(SAMPLES)):
        # What two samples find is found once.
        fresh = jnp.stack([keys[k] != other for other in keys[:k]]).all(axis=0)
        keys[k] = jnp.where(asked & fresh & (length > tuning.one_sample_px), keys[k], nowhere)
    return [jnp.where(asked, keys[0], nowhere), *keys[1:]]


def find_segments_near_predictions(
    table: SpatialIndex, keys: Int[np.ndarray, "s p"]
) -> tuple[Int[np.ndarray, "hits"], Int[np.ndarray, "hits"]]:
    """(prediction, segment) of what passes a sample of a prediction; some more than once."""
    query, segment = look_up_segments(table, keys.reshape(-1))
    return query % keys.shape[1], segment
