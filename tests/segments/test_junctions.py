"""Junctions and chains of segments from any detector."""

import numpy as np
from hypothesis import given, settings, strategies as st

from trinoc.geometry.segments import Segments
from trinoc.segments import find_segments_lsd, with_junctions


def junctions_of(rows: list[list[float]]) -> Segments:
    return with_junctions(Segments.from_endpoints(np.array(rows)))


def test_two_ends_that_meet_are_an_l() -> None:
    found = junctions_of([[10, 10, 50, 11], [51, 10, 52, 60]]).junctions
    assert found is not None
    assert list(found.kind) == ["L"]
    assert np.allclose(found.uv_px[0], [51.0, 11.0], atol=0.5)
    assert sorted(zip(found.segment, found.end, strict=True)) == [(0, 1), (1, 0)]


def test_an_end_on_a_body_is_a_t() -> None:
    found = junctions_of([[10, 10, 90, 10], [50, 12, 52, 60]]).junctions
    assert found is not None
    assert list(found.kind) == ["T"]
    assert sorted(zip(found.segment, found.end, strict=True)) == [(0, -1), (1, 0)]


def test_three_ends_at_one_corner_are_a_y() -> None:
    found = junctions_of([[50, 50, 90, 60], [50, 50, 20, 80], [51, 49, 50, 10]]).junctions
    assert found is not None
    assert list(found.kind) == ["Y"]
    assert len(found.segment) == 3


def test_segments_that_only_cross_have_no_junction() -> None:
    found = junctions_of([[10, 50, 90, 50], [50, 10, 50, 90]]).junctions
    assert found is not None
    assert len(found) == 0


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
