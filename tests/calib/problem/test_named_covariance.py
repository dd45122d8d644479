"""The covariance of the named parameters equals that by finite differences."""

import equinox as eqx
import numpy as np
import pytest

from tests.calib.made_shots import LENSES, board_poses
from tests.calib.problem.made_problem import problem
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.named_covariance import World, named_covariance
from trinoc.calib.problem.variables import retract
from trinoc.numerics.precision import as_numpy

CAMERAS = tuple(LENSES)
WORLDS = {"a shot": World(np.asarray(1), None), "a camera": World(None, np.asarray(2))}


@pytest.fixture(scope="module")
def here():
    three_shots = problem(board_poses(3))
    return three_shots, compute_information(three_shots)


def values_after(here, head, boards, world):
    """Values of the named parameters, counted from the poses before the step."""
    problem, information = here
    none = np.zeros((len(information.free),) * 2)
    moved = as_numpy(eqx.filter_jit(retract)(problem.state, problem.parametrization, head, boards))
    return named_covariance(
        problem._replace(state=moved), information, none, 0.0, CAMERAS, world
    ).values


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_a_step_of_the_head_moves_boards_along_and_names_with_both(here, world):
    problem, information = here
    random = np.random.default_rng(0)
    step = random.normal(size=len(information.free))
    head = np.zeros(len(problem.free))
    head[information.free] = 1e-6 * step
    boards = np.einsum("sph,h->sp", information.board_by_parameters, head)
    slope = values_after(here, head, boards, world) - values_after(here, -head, -boards, world)
    slope /= 2e-6
    named = named_covariance(
        problem, information, np.outer(step, step), 0.0, CAMERAS, world
    ).covariance
    # Turns of rigid motions count from where the cameras stand: their values do not move.
    rows = np.flatnonzero(np.abs(slope) > 1e-6 * np.abs(slope).max())
    assert len(rows) > 20
    expected = np.outer(slope, slope)[np.ix_(rows, rows)]
    np.testing.assert_allclose(named[np.ix_(rows, rows)], expected, rtol=1e-3, atol=1e-7)


def test_the_world_s_board_has_an_error_of_its_own_with_the_variance_factor(here):
    problem, information = here
    none = np.zeros((len(information.free),) * 2)
    slopes = []
    for column in np.eye(6):
        boards = np.zeros((len(problem.state.rig_from_board), 6))
        boards[1] = 1e-6 * column
        head = np.zeros(len(problem.free))
        ends = [values_after(here, head, sign * boards, WORLDS["a shot"]) for sign in (1, -1)]
        slopes.append((ends[0] - ends[1]) / 2e-6)
    by_board = np.stack(slopes, axis=1)
    for factor in (1.0, 4.0):
        named = named_covariance(problem, information, none, factor, CAMERAS, WORLDS["a shot"])
        expected = factor * by_board @ information.board_covariance[1] @ by_board.T
        np.testing.assert_allclose(named.covariance, expected, rtol=1e-3, atol=1e-6)
