"""A rig to be fitted: its views, where the fit starts or ended, and what of it is free."""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.variables import HeadSlices, Parametrization, Priors, RigState
from trinoc.calib.problem.views import View, ViewTable, view_table
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.registry import stack_lenses
from trinoc.geometry.pose import Pose
from trinoc.numerics.precision import ArrayLike

# numerical: share of the variance by which errors that are alike are set apart.
_APART = 1e-6


class Problem(NamedTuple):
    """Everything that the fit takes.

    Fields
    ------
    views : what was seen.
    target : the board.
    state : where the fit starts, or where it ended.
    parametrization : units, and what is free.
    shots : how many there are; arrays have more rows.
    sigma_factor : (c,) by how much the places' sigmas are multiplied for each camera.
    spent : how many numbers the residuals determine of where the board's places lie.
    spent_on_lenses : how many they determine of what has a prior in the lenses.
    tuning : constants of the method, which every step of the fit reads.
    """

    views: tuple[View, ...]
    target: AbstractTarget
    state: RigState
    parametrization: Parametrization
    shots: int
    sigma_factor: Float[np.ndarray, "c"]
    spent: float = 0.0
    spent_on_lenses: float = 0.0
    tuning: CalibTuning = TUNING

    @property
    def slices(self) -> HeadSlices:
        """Where the steps of each kind of unknown stand in the head."""
        return self.parametrization.slices

    @property
    def free(self) -> Float[ArrayLike, "h"]:
        """1 for steps of the head that are taken, 0 for others."""
        return self.parametrization.free

    @property
    def priors(self) -> Priors:
        """What was known of the unknowns beforehand."""
        return self.parametrization.priors

    @property
    def cameras(self) -> int:
        """How many cameras there are."""
        return len(self.parametrization.lens_of_camera)

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
    head = np.array(problem.free)
    head[problem.slices.lenses] = free.astype(float).ravel()
    given = np.asarray(problem.state.lenses.coefficients)
    whole = ~free.any(axis=1, keepdims=True) | is_given(problem.priors)[:, None]
    model = problem.state.lenses
    never = np.array([[name in model.never_fitted for name in model.coefficient_names]], dtype=bool)
    kept = np.where(free[:, len(AFFINE_PARAMETERS) :] | whole | never, given, 0.0)
    state = eqx.tree_at(lambda state: state.lenses.coefficients, problem.state, kept)
    return with_head_free(problem._replace(state=state), head)


def with_fixed_aspect(problem: Problem) -> Problem:
    """The problem in which the focal lengths fx and fy of each fitted lens change in proportion."""
    fx, fy = AFFINE_PARAMETERS.index("fx_px"), AFFINE_PARAMETERS.index("fy_px")
    free = np.array(problem.free)
    free_of_lens = free[problem.slices.lenses].reshape(problem.parametrization.lens_shape)
    basis = np.array(problem.parametrization.lens_basis)
    basis[:, fy, fx] = basis[:, fy, fy]
    free_of_lens[:, fy] = 0.0
    free[problem.slices.lenses] = free_of_lens.ravel()
    parametrization = dataclasses.replace(problem.parametrization, lens_basis=basis, free=free)
    return problem._replace(parametrization=parametrization)


def is_given(priors: Priors) -> Bool[np.ndarray, "l"]:
    """Which lenses are known by a covariance; the prior of splines has a mean of 0."""
    each = zip(np.asarray(priors.lens_mean), np.asarray(priors.lens_information), strict=True)
    return np.array([bool(mean.any() and information.any()) for mean, information in each])


def with_priors(problem: Problem, **values: ArrayLike) -> Problem:
    """The problem with other values of fields of `Priors`."""
    priors = dataclasses.replace(problem.priors, **values)
    parametrization = dataclasses.replace(problem.parametrization, priors=priors)
    return problem._replace(parametrization=parametrization)


def with_lens_prior(problem: Problem, number: int, factor: Float[np.ndarray, "k r"]) -> Problem:
    """The problem whose lens `number` is known as it starts, to a covariance L L^T of its first k
    parameters; those without variance are held."""
    covariance = factor @ factor.T
    rows = np.flatnonzero(np.diag(covariance) > 0)
    sigma = np.sqrt(np.diag(covariance)[rows])
    # What is off alike, such as both focal lengths of a data sheet, is two unknowns, not one.
    apart = covariance[np.ix_(rows, rows)] / np.outer(sigma, sigma) + _APART * np.eye(len(rows))
    mean = np.array(problem.priors.lens_mean)
    information = np.array(problem.priors.lens_information)
    mean[number] = np.asarray(lens_number(problem, number).parameters)
    information[number][np.ix_(rows, rows)] = np.linalg.inv(apart) / np.outer(sigma, sigma)
    free = np.array(problem.free)
    free[problem.slices.lens(number)][rows] = 1.0
    known = with_head_free(with_priors(problem, lens_mean=mean, lens_information=information), free)
    # As many as the shots can tell of it; they tell of thousands of numbers.
    return known._replace(spent_on_lenses=problem.spent_on_lenses + float(len(rows)))


def with_wider_lenses(
    problem: Problem, lenses: Sequence[AbstractLens], image_sizes_px: Sequence[tuple[int, int]]
) -> Problem:
    """The problem with lenses of a model whose parameters begin with those of its own.

    What is added is free, without a prior, of lenses that are not held as a whole.
    """
    count, size = problem.parametrization.lens_shape
    more = len(lenses[0].parameter_names) - size
    names, never = lenses[0].parameter_names[size:], lenses[0].never_fitted
    scale = np.stack(
        [lens.parameter_scales(each) for lens, each in zip(lenses, image_sizes_px[:count])]
    )
    head = np.asarray(problem.free)
    of_lens, of_rest = head[: count * size].reshape(count, size), head[count * size :]
    added = of_lens.any(axis=1, keepdims=True) * np.array([name not in never for name in names])
    wider = with_priors(
        problem,
        lens_mean=np.pad(problem.priors.lens_mean, ((0, 0), (0, more))),
        lens_information=np.pad(problem.priors.lens_information, ((0, 0), (0, more), (0, more))),
    )
    parametrization = dataclasses.replace(
        wider.parametrization,
        lens_basis=basis_of_scales(scale),
        free=np.append(np.append(of_lens, added, axis=1).ravel(), of_rest),
    )
    state = eqx.tree_at(lambda state: state.lenses, problem.state, stack_problem_lenses(lenses))
    return problem._replace(state=state, parametrization=parametrization)


def with_sheet_held(problem: Problem) -> Problem:
    """The problem with the board taken as it was found."""
    head = np.array(problem.free)
    head[problem.slices.sheets.start :] = 0.0
    return with_head_free(problem, head)


def with_head_held(problem: Problem) -> Problem:
    """The problem with lenses, cameras and board as they are: only where it stands is free."""
    return with_head_free(problem, np.zeros(len(problem.free)))


def with_head_free(problem: Problem, free: Float[np.ndarray, "h"]) -> Problem:
    """The problem with other steps of the head free: 1 where they are, else 0."""
    parametrization = dataclasses.replace(problem.parametrization, free=free)
    return problem._replace(parametrization=parametrization)


def basis_of_scales(scale: Float[np.ndarray, "l q"]) -> Float[np.ndarray, "l q q"]:
    """A `Parametrization.lens_basis` by which each parameter has a step of its own."""
    return scale[:, :, None] * np.eye(scale.shape[1])[None]


def stack_problem_lenses(lenses: Sequence[AbstractLens]) -> AbstractLens:
    """Lenses of one model along a first axis, in double precision."""
    plain = partial(jax.tree.map, partial(np.asarray, dtype=np.float64))
    return stack_lenses([plain(lens) for lens in lenses])
