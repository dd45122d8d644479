"""The map of the difference of two halves does not depend on frames, and its sigmas hold."""

import equinox as eqx
import numpy as np
import pytest

from tests.calib.made_shots import BOARD, LENSES, SIZE_PX, board_poses, chained, inverse
from tests.calib.problem.made_problem import problem
from trinoc.calib.advice.field_difference import field_differences
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.problem import with_lens_free
from trinoc.calib.problem.variables import retract
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.numerics.precision import as_numpy

CAMERAS = tuple(LENSES)


@pytest.fixture(scope="module")
def problem_and_covariance():
    """Problem at the truth, and its reported covariance of lenses and cameras."""
    free = np.tile(np.arange(9) < 8, (3, 1))
    here = with_lens_free(problem(board_poses(6), Systematics()), free)
    return here, compute_information(here).observability.covariance


def a_half(problem, covariance, random):
    """Lenses and cameras off by errors of this covariance."""
    head = np.zeros(len(problem.free))
    head[np.flatnonzero(problem.free)] = random.multivariate_normal(
        np.zeros(len(covariance)), covariance, method="cholesky"
    )
    boards = np.zeros((len(problem.state.rig_from_board), 6))
    return as_numpy(retract(problem.state, problem.parametrization, head, boards))


def elsewhere(state):
    """The same cameras in another frame, half a degree and some millimetres off."""
    motion = board_poses(1, seed=3, tilt_deg=0.5)[0]
    motion = motion @ np.diag([1.0, -1.0, -1.0, 0.005])
    poses = np.stack([chained(pose, inverse(motion)) for pose in state.cam_from_rig])
    return eqx.tree_at(lambda s: s.cam_from_rig, state, poses)


def test_the_frames_of_the_halves_are_not_in_it(problem_and_covariance):
    problem, covariance = problem_and_covariance
    random = np.random.default_rng(0)
    first, second = (a_half(problem, covariance, random) for _ in range(2))
    maps = field_differences(problem, (first, second), 2 * covariance, CAMERAS)
    moved = field_differences(problem, (elsewhere(first), second), 2 * covariance, CAMERAS)
    same = field_differences(problem, (elsewhere(first), first), 2 * covariance, CAMERAS)
    assert [each.camera for each in maps] == list(CAMERAS)
    for one, other, none in zip(maps, moved, same, strict=True):
        assert one.difference_px.shape == (2, 25, 2)
        assert one.uv_px.min() > 0
        assert (one.uv_px < SIZE_PX).all()
        np.testing.assert_allclose(other.difference_px, one.difference_px, atol=0.01)
        np.testing.assert_array_equal(other.sigma_px, one.sigma_px)
        np.testing.assert_allclose(none.difference_px, 0.0, atol=0.01)
        assert one.rms_px[0] > 0.03


def test_halves_that_err_as_they_claim_differ_by_one_sigma(problem_and_covariance):
    problem, covariance = problem_and_covariance
    random, squares = np.random.default_rng(1), []
    for _ in range(40):
        halves = [a_half(problem, covariance, random) for _ in range(2)]
        maps = field_differences(problem, halves, 2 * covariance, CAMERAS)
        squares.append([each.rms_over_sigma**2 for each in maps])
    assert np.sqrt(np.mean(squares, axis=0)) == pytest.approx(np.ones((3, 2)), abs=0.12)


def test_the_points_lie_where_the_boards_were_and_farther(problem_and_covariance):
    problem, covariance = problem_and_covariance
    (first_map, *_) = field_differences(problem, [problem.state] * 2, covariance, CAMERAS)
    assert first_map.distance_mm[1] == pytest.approx(3 * first_map.distance_mm[0])
    assert 400 < first_map.distance_mm[0] < 900
    assert np.isfinite(first_map.over_sigma).all()
    assert len(BOARD) == 30
