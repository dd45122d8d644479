"""The table of cells returns every segment that a search through all segments returns."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trinoc.match.candidates.index import (
    CROWDED_LAYERS,
    LAYERS,
    SpatialIndex,
    look_up_segments,
    search_keys,
    spatial_index,
)

SIZE_PX = np.array([512.0, 480.0])
SIGMA_PX, REACH = 0.4, 4.0
QUERIES = 400


@pytest.fixture(scope="module")
def segments() -> tuple[np.ndarray, np.ndarray]:
    """(ends, standard deviations) of 150 segments, some of which cross the border."""
    rng = np.random.default_rng(6)
    middle, angle = rng.uniform(-20, 520, (150, 1, 2)), rng.uniform(0, 2 * np.pi, 150)
    half = rng.uniform(3, 60, 150)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return middle + np.stack([-half, half], axis=1), SIGMA_PX * rng.uniform(0.5, 2, 150)


@pytest.fixture(scope="module")
def table(segments: tuple[np.ndarray, np.ndarray]) -> SpatialIndex:
    return table_of(segments, LAYERS)


def table_of(segments: tuple[np.ndarray, np.ndarray], layers) -> SpatialIndex:
    """Index of the segments with cells of 9 px."""
    ends, sigma = segments
    slack = REACH * sigma / np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    margins = REACH * np.hypot(sigma, SIGMA_PX * np.array([[x.sigmas] for x in layers]))
    return spatial_index(ends, slack, margins, SIZE_PX, 9.0, SIGMA_PX, layers=layers)


@jax.jit
def keys(grid, points, angle, slack, sigma):
    def one(point, angle, slack, sigma):
        direction = jnp.cos(angle), jnp.sin(angle)
        return search_keys(grid, [(point[0], point[1])], direction, slack, sigma)[0]

    return jax.vmap(one)(points, angle, slack, sigma)


def distances_px(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Distances of points from segments, px, (q, n)."""
    step = ends[:, 1] - ends[:, 0]
    share = ((points[:, None] - ends[:, 0]) * step).sum(-1) / (step**2).sum(-1)
    nearest = ends[:, 0] + np.clip(share, 0, 1)[..., None] * step
    return np.linalg.norm(points[:, None] - nearest, axis=-1)


def turns_rad(angle: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Unsigned angles between directions, rad, (q, n)."""
    step = ends[:, 1] - ends[:, 0]
    difference = angle[:, None] - np.arctan2(step[:, 1], step[:, 0])
    return np.abs((difference + np.pi / 2) % np.pi - np.pi / 2)


def near_to(ends: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(points, directions in rad) close to those of the segments, inside the picture."""
    inside = ((ends > 20) & (ends < 460)).all(axis=(1, 2))
    first, last = np.moveaxis(ends[rng.choice(np.flatnonzero(inside), QUERIES)], 1, 0)
    points = first + rng.uniform(0, 1, (QUERIES, 1)) * (last - first)
    angle = np.arctan2(*(last - first).T[::-1]) + rng.normal(0, 0.05, QUERIES)
    return points + rng.normal(0, 2, points.shape), angle


@pytest.mark.parametrize(
    ("layers", "layer"),
    [(layers, n) for layers in (LAYERS, CROWDED_LAYERS) for n in range(len(layers))],
)
def test_all_that_passes_near_enough_is_found_once(segments, layers, layer: int) -> None:
    table, (ends, sigma) = table_of(segments, layers), segments
    rng = np.random.default_rng(layer)
    points, angle = near_to(ends, rng)
    # As uncertain as this layer allows, and the one before it does not.
    slack = np.full(QUERIES, 0.99 * min(layers[layer].slack_rad, np.pi))
    uncertainty_px = np.full(QUERIES, 0.99 * layers[layer].sigmas * SIGMA_PX)
    key = np.asarray(keys(table.grid, points, angle, slack, uncertainty_px))
    first = np.asarray(table.grid.first)
    assert ((key >= first[layer]) & (key < first[layer + 1])).all()
    query, segment = look_up_segments(table, key)
    pairs = set(zip(query.tolist(), segment.tolist(), strict=True))
    assert len(pairs) == len(query)
    is_near = distances_px(points, ends) < REACH * np.hypot(sigma, uncertainty_px[0])
    segment_slack = REACH * sigma / np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    is_near &= turns_rad(angle, ends) < slack[0] + segment_slack
    assert is_near.sum() > 100
    assert pairs >= set(zip(*(x.tolist() for x in np.nonzero(is_near)), strict=True))
    # A cell and its margin are all that is found too much.
    cells = np.sqrt(2) * float(table.grid.cell_px[layer])
    margin = np.sqrt(2) * REACH * np.hypot(sigma, layers[layer].sigmas * SIGMA_PX) + 2 * cells
    assert (distances_px(points, ends)[query, segment] < margin[segment]).all()


def test_too_vague_and_outside_finds_nothing(table: SpatialIndex) -> None:
    inside = np.full((QUERIES, 2), 200.0)
    angle, precise = np.zeros(QUERIES), np.full(QUERIES, 0.01)
    vague = np.full(QUERIES, 1.01 * LAYERS[-1].sigmas * SIGMA_PX)
    for points, uncertainty_px in (
        (inside, vague),
        (inside + 900.0, precise),
        (inside - 201.0, precise),
    ):
        key = np.asarray(keys(table.grid, points, angle, precise, uncertainty_px))
        assert (key == table.grid.first[-1]).all()
        assert len(look_up_segments(table, key)[0]) == 0
