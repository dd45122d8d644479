"""Corners and edges of a wire frame beside those of a known shape."""

import dataclasses

import numpy as np
import pytest

from tests.io.made_wireframe import made_wireframe
from trinoc.errors import InputError
from trinoc.evaluation.evaluation import evaluate
from trinoc.evaluation.known_shape import KnownShape
from trinoc.evaluation.wire_frames import known_corners

FRAME = made_wireframe()
# The square and the triangle; the edge apart is not of the shape.
SHAPE = KnownShape.of_edges(FRAME.lines_mm[:6])


def score(frame=FRAME, shape=SHAPE, **options):
    found = evaluate(frame, shape, **options).wireframe
    assert found is not None
    return found.record()


def test_what_is_right_is_found_and_what_is_not_of_the_shape_is_extra():
    found = score()
    assert (found["edges_wanted"], found["edges_found"], found["edges_extra"]) == (6, 6, 1)
    assert (found["corners_wanted"], found["corners_found"], found["corners_extra"]) == (5, 5, 0)
    assert found["corner_error_median_mm"] == 0
    assert found["share_of_corners_within_95"] == 1
    assert found["faces"] == 2


def test_a_corner_that_is_off_is_missing_and_extra_beyond_the_tolerance():
    off = FRAME.vertices_mm.copy()
    off[4] += [0.0, 0.0, 0.8]
    frame = dataclasses.replace(FRAME, vertices_mm=off)
    near, far = score(frame), score(frame, tolerances_mm=(0.5,))
    assert (near["corners_missing"], near["corners_extra"]) == (0, 0)
    assert (far["corners_missing"], far["corners_extra"]) == (1, 1)


def test_errors_are_compared_with_their_covariance():
    sigma = 0.1
    small = tuple(sigma**2 * np.eye(len(block)) for block in FRAME.joint_covariance_mm2)
    for sigmas, within_95, within_3 in ((1.0, 1.0, 1.0), (3.2, 0.8, 1.0), (4.5, 0.8, 0.8)):
        off = FRAME.vertices_mm.copy()
        off[2, 2] += sigmas * sigma
        frame = dataclasses.replace(FRAME, vertices_mm=off, joint_covariance_mm2=small)
        found = score(frame)
        assert found["share_of_corners_within_95"] == pytest.approx(within_95)
        assert found["share_of_corners_within_3_sigma"] == pytest.approx(within_3)


def test_free_ends_are_no_corners_and_half_an_edge_is_needed():
    corner = FRAME.corner.copy()
    corner[3] = False
    assert score(dataclasses.replace(FRAME, corner=corner))["corners_missing"] == 1
    short = FRAME.vertices_mm.copy()
    short[3] = short[2] + 0.4 * (short[3] - short[2])
    found = score(dataclasses.replace(FRAME, vertices_mm=short))
    assert found["edges_found"] == 4


def test_a_motion_of_both_changes_nothing_and_alignment_takes_it_up():
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    shift = np.array([5.0, -3.0, 9.0])
    blocks = [np.kron(np.eye(len(b) // 3), turn) for b in FRAME.joint_covariance_mm2]
    moved = dataclasses.replace(
        FRAME,
        vertices_mm=FRAME.vertices_mm @ turn.T + shift,
        joint_covariance_mm2=tuple(
            block @ own @ block.T
            for block, own in zip(blocks, FRAME.joint_covariance_mm2, strict=True)
        ),
    )
    there = KnownShape.of_edges(SHAPE.edges_mm @ turn.T + shift)
    for name, value in score(moved, there).items():
        assert value == pytest.approx(score()[name], abs=1e-9), name
    push = np.array([0.4, -0.3, 0.2])
    nudged = dataclasses.replace(FRAME, vertices_mm=FRAME.vertices_mm + push)
    assert score(nudged)["corner_error_median_mm"] > 0.5
    assert score(nudged, aligned=True)["corner_error_median_mm"] < 0.05


def test_corners_are_where_edges_turn_and_wanted_where_two_parts_reach_them():
    line = np.array(
        [[[0.0, 0, 0], [10, 0, 0]], [[10.0, 0, 0], [20, 0, 0]], [[20.0, 0, 0], [20, 9, 0]]]
    )
    assert known_corners(KnownShape.of_edges(line)).corners_mm.tolist() == [[20, 0, 0]]
    shape = KnownShape.of_edges(line)
    partly = dataclasses.replace(shape, wanted_extent=np.array([[0, 1.0], [0, 0.9], [0, 1]]))
    assert known_corners(partly).wanted.tolist() == [False]
    assert known_corners(shape).wanted.tolist() == [True]


def test_lines_of_another_answer_are_refused():
    with pytest.raises(InputError, match="not the edges of the wire frame"):
        evaluate(FRAME.lines_mm[:3], SHAPE, frame=FRAME)
