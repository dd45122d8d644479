"""A rig to be fitted: its views, where the fit starts or ended, and what of it is free."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.variables import Chart, RigState
from trinoc.calib.problem.views import View, ViewTable, view_table
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.registry import stack_lenses
from trinoc.geometry.pose import Pose

# numerical: share of the variance by which errors that are alike are set apart.
_APART = 1e-6


class Problem(NamedTuple):
    """Everything that the fit takes.

    Fields
    ------
    views : what was seen.
    target : the board.
    state : where the fit starts, or where it ended.
    chart : units, and what is free.
    shots : how many there are; arrays have more rows.
    sigma_factor : (c,) by how much the places' sigmas are multiplied for each camera.
    spent : how many numbers the residuals determine of where the board's places lie.
    spent_on_lenses : how many they determine of what has a prior in the lenses.
    """

    views: tuple[View, ...]
    target: AbstractTarget
    state: RigState
    chart: Chart
    shots: int
    sigma_factor: Float[np.ndarray, "c"]
    spent: float = 0.0
    spent_on_lenses: float = 0.0

    @property
    def cameras(self) -> int:
        """How many cameras there are."""
        return len(self.chart.lens_of_camera)

    @property
    def image_sizes_px(self) -> dict[int, tuple[int, int]]:
        """(width, height) of each camera's pictures."""
        return {view.camera: view.detection.image_size_px for view in self.views}

    @property
    def table(self) -> ViewTable:
        """The views as arrays."""
        table = view_table(self.views, self.target)
        by_view = self.sigma_factor[np.asarray(table.camera)]
        by_view[: len(self.views)] *= [view.sigma_ratio for view in self.views]
        return table._replace(whitening=table.whitening / by_view[:, None, None, None])


class EndedProblem(NamedTuple):
    """Where a fit ended, and how well that is known.

    Fields
    ------
    problem : at its end.
    covariance : (f, f) of the free steps of the head.
    variance_factor : of the shots' noise, which is in the covariance.
    """

    problem: Problem
    covariance: Float[np.ndarray, "f f"]
    variance_factor: float


def cam_from_board(state: RigState, view: View) -> Pose:
    """The pose of a view's board before its camera."""
    pose = Pose(np.asarray(state.cam_from_rig)[view.camera])
    pose @= Pose(np.asarray(state.rig_from_board)[view.shot])
    return (
        pose @ Pose(np.asarray(state.set_from_board)[view.board])
        if len(state.set_from_board)
        else pose
    )


def lens_number(problem: Problem, number: int) -> AbstractLens:
    """One of the stacked lenses of the state."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[number], problem.state.lenses)


class Freedom(NamedTuple):
    """What is fitted of the lenses.

    Fields
    ------
    lens_of_camera : (c,) which lens each camera has.
    free : (l, q) which parameters of each lens are fitted.
    """

    lens_of_camera: np.ndarray
    free: Bool[np.ndarray, "l q"]


def with_lens_free(problem: Problem, free: Bool[np.ndarray, "l q"]) -> Problem:
    """The problem with other parameters of the lenses held; held coefficients are zero, but for
    lenses that are held as a whole or known by a covariance, and for what is never fitted."""
    head = np.array(problem.chart.free)
    head[: problem.chart.lens_count] = free.astype(float).ravel()
    given = np.asarray(problem.state.lenses.coefficients)
    whole = ~free.any(axis=1, keepdims=True) | is_given(problem.chart)[:, None]
    model = problem.state.lenses
    never = np.array([[name in model.never_fitted for name in model.coefficient_names]], dtype=bool)
    kept = np.where(free[:, len(AFFINE_PARAMETERS) :] | whole | never, given, 0.0)
    state = eqx.tree_at(lambda state: state.lenses.coefficients, problem.state, kept)
    return problem._replace(chart=_with_free(problem.chart, head), state=state)


def is_given(chart: Chart) -> Bool[np.ndarray, "l"]:
    """Which lenses are known by a covariance; the prior of splines has a mean of 0."""
    priors = zip(np.asarray(chart.lens_mean), np.asarray(chart.lens_information), strict=True)
    return np.array([bool(mean.any() and information.any()) for mean, information in priors])


def with_lens_prior(problem: Problem, number: int, factor: Float[np.ndarray, "k r"]) -> Problem:
    """The problem whose lens `number` is known as it starts, to a covariance L L^T of its first k
    parameters; those without variance are held."""
    chart, covariance = problem.chart, factor @ factor.T
    rows = np.flatnonzero(np.diag(covariance) > 0)
    sigma = np.sqrt(np.diag(covariance)[rows])
    # What is off alike, such as both focal lengths of a data sheet, is two unknowns, not one.
    apart = covariance[np.ix_(rows, rows)] / np.outer(sigma, sigma) + _APART * np.eye(len(rows))
    mean, information = np.array(chart.lens_mean), np.array(chart.lens_information)
    mean[number] = np.asarray(lens_number(problem, number).parameters)
    information[number][np.ix_(rows, rows)] = np.linalg.inv(apart) / np.outer(sigma, sigma)
    free = np.array(chart.free)
    free[number * chart.lens_shape[1] + rows] = 1.0
    chart = eqx.tree_at(
        lambda c: (c.lens_mean, c.lens_information, c.free), chart, (mean, information, free)
    )
    # As many as the shots can tell of it; they tell of thousands of numbers.
    return problem._replace(chart=chart, spent_on_lenses=problem.spent_on_lenses + float(len(rows)))


def with_wider_lenses(
    problem: Problem, lenses: Sequence[AbstractLens], image_sizes_px: Sequence[tuple[int, int]]
) -> Problem:
    """The problem with lenses of a model whose parameters begin with those of its own.

    What is added is free, without a prior, of lenses that are not held as a whole.
    """
    count, size = problem.chart.lens_shape
    more = len(lenses[0].parameter_names) - size
    names, never = lenses[0].parameter_names[size:], lenses[0].never_fitted
    scale = np.stack(
        [lens.parameter_scales(each) for lens, each in zip(lenses, image_sizes_px[:count])]
    )
    head = np.asarray(problem.chart.free)
    of_lens, of_rest = head[: count * size].reshape(count, size), head[count * size :]
    added = of_lens.any(axis=1, keepdims=True) * np.array([name not in never for name in names])
    chart = eqx.tree_at(
        lambda c: (c.lens_basis, c.lens_mean, c.free, c.lens_information),
        problem.chart,
        (
            basis_of_scales(scale),
            np.pad(problem.chart.lens_mean, ((0, 0), (0, more))),
            np.append(np.append(of_lens, added, axis=1).ravel(), of_rest),
            np.pad(problem.chart.lens_information, ((0, 0), (0, more), (0, more))),
        ),
    )
    state = eqx.tree_at(lambda state: state.lenses, problem.state, stack_problem_lenses(lenses))
    return problem._replace(state=state, chart=chart)


def with_sheet_held(problem: Problem) -> Problem:
    """The problem with the board taken as it was found."""
    head = np.array(problem.chart.free)
    head[problem.chart.sheet_first :] = 0.0
    return problem._replace(chart=_with_free(problem.chart, head))


def with_head_held(problem: Problem) -> Problem:
    """The problem with lenses, cameras and board as they are: only where it stands is free."""
    return problem._replace(chart=_with_free(problem.chart, np.zeros(len(problem.chart.free))))


def with_head_free(problem: Problem, free: Float[np.ndarray, "h"]) -> Problem:
    """The problem with other steps of the head free: 1 where they are, else 0."""
    return problem._replace(chart=_with_free(problem.chart, free))


def _with_free(chart: Chart, free: Float[np.ndarray, "h"]) -> Chart:
    return eqx.tree_at(lambda chart: chart.free, chart, free)


def basis_of_scales(scale: Float[np.ndarray, "l q"]) -> Float[np.ndarray, "l q q"]:
    """A `Chart.lens_basis` by which each parameter has a step of its own."""
    return scale[:, :, None] * np.eye(scale.shape[1])[None]


def stack_problem_lenses(lenses: Sequence[AbstractLens]) -> AbstractLens:
    """Lenses of one model along a first axis, in double precision."""
    plain = partial(jax.tree.map, partial(np.asarray, dtype=np.float64))
    return stack_lenses([plain(lens) for lens in lenses])
