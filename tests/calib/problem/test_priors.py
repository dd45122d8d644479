"""A prior has the same weight in the cost, its gradient and the information."""

import dataclasses
import functools

import equinox as eqx
import jax
import numpy as np
import pytest

from tests.calib.made_shots import board_poses
from tests.calib.problem.equations import cost_of_points
from tests.calib.problem.made_problem import problem
from trinoc.calib.problem.board_shape import with_free_points
from trinoc.calib.problem.equations import PointsProblem
from trinoc.calib.problem.problem import lens_of_index
from trinoc.calib.problem.sheet import BentPaper, WarpedBoard
from trinoc.calib.problem.variables import Priors, evaluate_prior, retract
from trinoc.geometry.pose import PoseModel
from trinoc.numerics.robust_loss import GemanMcClure

KINDS = ("lens", "aim", "sheet", "places")


def with_every_prior(sheet_model):
    """State, parametrization and table of cameras over a fixed sheet, with every kind of prior.

    The state is off every prior mean and no point is observed, so that only the priors are left.
    """
    random = np.random.default_rng(0)
    here = with_free_points(problem(board_poses(2)))
    parametrization, state = here.parametrization, here.state
    lenses, size = parametrization.lens_shape
    roots = np.asarray(parametrization.lens_scale)[:, :, None] * random.normal(
        0, 0.01, (lenses, size, size)
    )
    covariance = roots @ np.swapaxes(roots, 1, 2)
    terms = len(sheet_model.names)
    sheet_root = random.normal(size=(terms, terms))
    slices = parametrization.slices
    before = parametrization.free[: slices.sheets.start]
    after = parametrization.free[slices.points]
    shape_root = random.normal(size=(len(after), len(after)))
    means = np.stack([lens_of_index(here, k).parameters for k in range(lenses)])
    priors = Priors(
        lens_mean=means + roots @ random.normal(size=size),
        lens_information=np.linalg.inv(covariance),
        aim_information=random.uniform(0.5, 2.0, here.cameras),
        sheet_information=sheet_root @ sheet_root.T,
        shape_information=shape_root @ shape_root.T / len(after),
    )
    parametrization = dataclasses.replace(
        parametrization,
        lens_basis=roots,
        priors=priors,
        pose_model=PoseModel.AIM_FREE,
        sheet_model=sheet_model,
        sheet_scale=random.uniform(0.5, 2.0, terms),
        free=np.concatenate([np.ones_like(before), np.ones(terms), np.ones_like(after)]),
    )
    state = dataclasses.replace(
        state, sheet=random.normal(size=terms), shape=random.normal(size=state.shape.shape)
    )
    table = here.table
    return state, parametrization, table._replace(whitening=np.zeros_like(table.whitening))


def rows_of(parametrization, kind):
    """Rows of the head that belong to the steps of one kind of unknown with a prior."""
    slices = parametrization.slices
    rows = {
        "lens": slices.lenses,
        "aim": slices.cameras,
        "sheet": slices.sheets,
        "places": slices.points,
    }[kind]
    return np.arange(rows.start, rows.stop)


@eqx.filter_jit
def _cost(state, parametrization, table, loss, head):
    moved = retract(state, parametrization, head, np.zeros((len(state.rig_from_board), 6)))
    return cost_of_points(PointsProblem(parametrization, table, loss), moved)


@functools.cache
def equations_with_priors(sheet_model_name):
    models = {"board": WarpedBoard(np.array([[60.0, 50.0]])), "paper": BentPaper(np.array(80.0))}
    state, parametrization, table = with_every_prior(models[sheet_model_name])
    loss = GemanMcClure.from_scale(np.full(len(table.shot), np.inf))
    equations = PointsProblem(parametrization, table, loss)
    normal_equations = eqx.filter_jit(lambda law, point: law.equations(point))(equations, state)
    return (
        functools.partial(_cost, state, parametrization, table, loss),
        parametrization,
        normal_equations,
    )


@pytest.mark.parametrize("sheet_model", ["board", "paper"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_prior_is_the_same_in_cost_gradient_and_information(kind, sheet_model):
    """The cost is quadratic in the step, so that its differences are exact."""
    cost, parametrization, equations = equations_with_priors(sheet_model)
    rows, random = rows_of(parametrization, kind), np.random.default_rng(1)
    for _ in range(2):
        step = np.zeros(len(parametrization.free))
        step[rows] = random.normal(size=len(rows))
        before, here, after = (float(cost(sign * step)) for sign in (-1.0, 0.0, 1.0))
        slope = 0.25 * (after - before)
        curvature = 0.5 * (after - 2 * here + before)
        assert abs(slope) > 1e-3
        assert curvature > 1e-3
        assert slope == pytest.approx(float(equations.gradient[0] @ step), rel=1e-6)
        assert curvature == pytest.approx(float(step @ equations.information.head @ step), rel=1e-6)


def test_the_cost_is_the_squared_mahalanobis_distance_from_what_was_known():
    state, parametrization, _ = with_every_prior(WarpedBoard(np.array([[60.0, 50.0]])))
    off = (
        np.asarray(jax.vmap(lambda lens: lens.parameters)(state.lenses))
        - parametrization.priors.lens_mean
    )
    expected = np.einsum("lp,lpq,lq->", off, parametrization.priors.lens_information, off)
    for cam_from_rig, information in zip(
        state.cam_from_rig, parametrization.priors.aim_information, strict=True
    ):
        axis, centre = cam_from_rig[2, :3], -cam_from_rig[:, :3].T @ cam_from_rig[:, 3]
        aim_mm = (centre - centre[2] / axis[2] * axis)[:2]
        expected += information * aim_mm @ aim_mm
    expected += state.sheet @ parametrization.priors.sheet_information @ state.sheet
    expected += state.shape.ravel() @ parametrization.priors.shape_information @ state.shape.ravel()
    assert float(jax.jit(evaluate_prior)(state, parametrization).cost) == pytest.approx(
        expected, rel=1e-9
    )


def test_what_is_held_has_no_prior_to_pull_at_it():
    state, parametrization, table = with_every_prior(WarpedBoard(np.array([[60.0, 50.0]])))
    parametrization = eqx.tree_at(
        lambda c: c.free, parametrization, np.zeros_like(parametrization.free)
    )
    loss = GemanMcClure.from_scale(np.full(len(table.shot), np.inf))
    equations = eqx.filter_jit(lambda law, point: law.equations(point))(
        PointsProblem(parametrization, table, loss), state
    )
    np.testing.assert_array_equal(equations.gradient[0], 0.0)
    np.testing.assert_array_equal(equations.information.head, 0.0)
