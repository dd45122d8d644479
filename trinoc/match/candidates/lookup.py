"""Segments of the third view near a prediction, by the table of cells."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from trinoc.match.candidates.index import (
    CROWDED_LAYERS,
    LAYERS,
    Grid,
    SpatialIndex,
    key_at,
    segments_at,
    spatial_index,
)
from trinoc.match.candidates.single_precision import rounding_px
from trinoc.match.candidates.transfer import Prediction
from trinoc.match.observations import SegmentTable
from trinoc.match.tuning import DEFAULT, CandidateTuning
from trinoc.numerics import ArrayLike, broadcast_groups, group_medians, group_sums

# Where a prediction is looked up, as shares of its length: its middle first.
SAMPLES = (0.5, 1 / 6, 5 / 6)
# Finest cell: at least CELL_SIGMAS standard deviations wide. Along the longer side of the image
# there are CELLS sqrt(n) of them for n segments, and in small pictures, where the table takes
# longer than the looking up, one for so many segments; clipped to FEWEST .. MOST.
CELL_SIGMAS, CELLS, SEGMENTS_OF_CELL, FEWEST, MOST = 8.0, 3.0, 8, 8, 320
# Pictures with more segments than this have finer layers.
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
    # Sides that single precision holds: those who ask compute in it.
    cell = cell.astype(np.float32).astype(np.float64)
    table = spatial_index(ends, slack, margins, size, cell, typical, frame, layers)
    sides, typical = (x.astype(np.float32) for x in (table.grid.cell_px, typical))
    return table._replace(grid=table.grid._replace(cell_px=sides, sigma_px=typical))


def keys_of(
    grid: Grid, guess: Prediction, tuning: CandidateTuning = DEFAULT.candidates
) -> list[Int[ArrayLike, ""]]:
    """Where in the table to look for each sample of a prediction, in the table's precision."""
    guess = Prediction(guess.possible, *(x.astype(grid.cell_px.dtype) for x in guess[1:]))
    du, dv = guess.u1 - guess.u0, guess.v1 - guess.v0
    length = jnp.sqrt(du * du + dv * dv)
    slack = tuning.reach_sigmas * jnp.sqrt(guess.c00 + guess.c11 - 2 * guess.c01) / length
    sigma = jnp.sqrt(jnp.maximum(guess.c00, guess.c11))
    points = [(guess.u0 + sample * du, guess.v0 + sample * dv) for sample in SAMPLES]
    keys = key_at(grid, points, (du, dv), slack, sigma)
    nowhere, asked = grid.first[-1], guess.possible
    for k in range(1, len(SAMPLES)):
        # What two samples find is found once.
        fresh = jnp.stack([keys[k] != other for other in keys[:k]]).all(axis=0)
        keys[k] = jnp.where(asked & fresh & (length > tuning.one_sample_px), keys[k], nowhere)
    return [jnp.where(asked, keys[0], nowhere), *keys[1:]]


def segments_near(
    table: SpatialIndex, keys: Int[np.ndarray, "s p"]
) -> tuple[Int[np.ndarray, "hits"], Int[np.ndarray, "hits"]]:
    """(prediction, segment) of what passes a sample of a prediction; some more than once."""
    query, segment = segments_at(table, keys.reshape(-1))
    return query % keys.shape[1], segment
