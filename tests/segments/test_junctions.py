"""Junctions and chains of segments from any detector."""

import equinox as eqx
import numpy as np
from hypothesis import given, settings, strategies as st

from trinoc.geometry.segments import Segments
from trinoc.segments import find_segments_lsd, with_junctions


def junctions_of(rows: list[list[float]]) -> Segments:
    return with_junctions(Segments.from_endpoints(np.array(rows)))


def test_two_ends_that_meet_are_an_l() -> None:
    junctions = junctions_of([[10, 10, 50, 11], [51, 10, 52, 60]]).junctions
    assert junctions is not None
    assert list(junctions.kind) == ["L"]
    assert np.allclose(junctions.uv_px[0], [51.0, 11.0], atol=0.5)
    assert sorted(zip(junctions.segment, junctions.end, strict=True)) == [(0, 1), (1, 0)]


def test_an_end_on_a_body_is_a_t() -> None:
    junctions = junctions_of([[10, 10, 90, 10], [50, 12, 52, 60]]).junctions
    assert junctions is not None
    assert list(junctions.kind) == ["T"]
    assert sorted(zip(junctions.segment, junctions.end, strict=True)) == [(0, -1), (1, 0)]


def test_three_ends_at_one_corner_are_a_y() -> None:
    junctions = junctions_of([[50, 50, 90, 60], [50, 50, 20, 80], [51, 49, 50, 10]]).junctions
    assert junctions is not None
    assert list(junctions.kind) == ["Y"]
    assert len(junctions.segment) == 3


def test_segments_that_only_cross_have_no_junction() -> None:
    junctions = junctions_of([[10, 50, 90, 50], [50, 10, 50, 90]]).junctions
    assert junctions is not None
    assert len(junctions) == 0


def test_pieces_of_one_edge_are_one_chain() -> None:
    rows = [[10, 10, 50, 14], [60, 15, 100, 19], [10, 40, 50, 44], [104, 19.4, 150, 24]]
    chain = junctions_of(rows).chain
    assert chain is not None
    assert chain[0] == chain[1] == chain[3]
    assert chain[2] != chain[0]


def test_parallel_neighbours_are_no_chain() -> None:
    chain = junctions_of([[10, 10, 50, 10], [55, 16, 100, 16]]).chain
    assert chain is not None
    assert chain[0] != chain[1]


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    angle=st.floats(0.0, 2 * np.pi),
    shift=st.floats(-300.0, 300.0),
)
def test_junctions_move_with_the_picture(seed: int, angle: float, shift: float) -> None:
    rows = np.random.default_rng(seed).uniform(0, 80, (12, 2, 2))
    rows = rows[np.linalg.norm(rows[:, 1] - rows[:, 0], axis=1) > 5]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    here = with_junctions(Segments.from_endpoints(rows)).junctions
    there = with_junctions(Segments.from_endpoints(rows @ turn.T + shift)).junctions
    assert here is not None
    assert there is not None
    assert list(here.kind) == list(there.kind)
    assert np.array_equal(here.segment, there.segment)
    assert np.allclose(np.asarray(here.uv_px) @ turn.T + shift, there.uv_px, atol=1e-6)


def test_lsd_comes_with_its_bias_taken_out_and_with_junctions() -> None:
    grey = np.full((120, 120), 60, dtype=np.uint8)
    # Pixels 30 to 89 are bright: the edges lie at 29.5 and 89.5.
    grey[30:90, 30:90] = 180
    segments = find_segments_lsd(grey)
    ends = np.asarray(segments.endpoints_px)
    assert len(segments) == 4
    assert segments.junctions is not None
    distance = np.abs(ends[..., None] - [29.5, 89.5]).min(axis=-1)
    assert distance.min(axis=2).max() < 0.3


# Three segments that end in (50, 50), and their standard deviations across, px.
CORNER = np.array([[50, 50, 90, 60], [50, 50, 20, 80], [50, 50, 45, 10]]).reshape(3, 2, 2)
ACROSS_PX, ALONG_PX = np.array([0.1, 0.3, 0.9]), 2.0


def corner_directions() -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along and across the segments of CORNER."""
    along = (CORNER[:, 1] - CORNER[:, 0]).astype(float)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return along, np.stack([-along[:, 1], along[:, 0]], axis=1)


def test_a_junction_has_the_stated_covariance_where_segments_are_not_equally_well_known() -> None:
    """Segments are shifted across by noise of their standard deviations. The corner's squared
    normalised error then has the mean 2 of chi-square with two degrees of freedom."""
    random = np.random.default_rng(0)
    along, across = corner_directions()
    covariance = np.zeros((3, 4, 4))
    for k in range(3):
        of_end = ALONG_PX**2 * np.outer(along[k], along[k])
        of_end += ACROSS_PX[k] ** 2 * np.outer(across[k], across[k])
        covariance[k, :2, :2] = covariance[k, 2:, 2:] = of_end
    squares = []
    for _ in range(400):
        moved = CORNER + (ACROSS_PX * random.normal(size=3))[:, None, None] * across[:, None]
        segments = Segments.from_endpoints(moved)
        segments = eqx.tree_at(lambda s: s.covariance_px2, segments, covariance)
        junctions = with_junctions(segments).junctions
        assert junctions is not None
        assert list(junctions.kind) == ["Y"]
        error = np.asarray(junctions.uv_px)[0] - 50.0
        squares.append(error @ np.linalg.solve(np.asarray(junctions.covariance_px2)[0], error))
    # The mean of 400 such squares has the standard deviation 0.1.
    assert abs(np.mean(squares) - 2.0) < 0.35
