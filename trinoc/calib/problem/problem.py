"""The calibration problem as one value: observations, state, priors, and the estimated
parameters.
"""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.variables import ParameterSlices, Parametrization, Priors, RigState
from trinoc.calib.problem.views import BoardObservation, ObservationTable, observation_table
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.registry import stack_lenses
from trinoc.geometry.pose import Pose
from trinoc.numerics.precision import ArrayLike

# numerical: share of the variance that keeps fully correlated errors invertible.
_INDEPENDENT_SHARE = 1e-6


class Problem(NamedTuple):
    """Calibration problem: all inputs of a fit. After the fit, `state` is the solution.

    Attributes
    ----------
    views : observations of the board, one for each camera and shot.
    target : the board.
    state : values of all unknowns, before or after the fit.
    parametrization : units of the parameters, priors, and the mask of estimated parameters.
    shots : number of shots. Arrays with an axis of shots are padded and may be longer.
    sigma_factor : (c,) factor by which the point sigmas of each camera are multiplied.
    shape_dof : effective number of board-shape parameters determined by the residuals.
    lens_dof : effective number of lens parameters determined by the residuals, of lenses with a
        prior.
    tuning : constants of the method for every step of the fit.
    """

    views: tuple[BoardObservation, ...]
    target: AbstractTarget
    state: RigState
    parametrization: Parametrization
    shots: int
    sigma_factor: Float[np.ndarray, "c"]
    shape_dof: float = 0.0
    lens_dof: float = 0.0
    tuning: CalibTuning = TUNING

    @property
    def slices(self) -> ParameterSlices:
        """Index range of each kind of parameter (lenses, cameras, ...) in the vector of shared
        parameters.

        Shared parameters are those that all shots have in common: lenses, camera poses, relative
        poses of boards that are fixed to each other, and board shape.
        """
        return self.parametrization.slices

    @property
    def free(self) -> Float[ArrayLike, "h"]:
        """Mask of the h shared parameters (lenses, cameras, board shape): 1 if estimated, 0 if
        fixed.
        """
        return self.parametrization.free

    @property
    def priors(self) -> Priors:
        """Priors of the unknowns."""
        return self.parametrization.priors

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        return len(self.parametrization.lens_of_camera)

    @property
    def image_sizes_px(self) -> dict[int, tuple[int, int]]:
        """(width, height) of each camera's images; the key is the index of the camera."""
        return {view.camera: view.detection.image_size_px for view in self.views}

    @property
    def table(self) -> ObservationTable:
        """Observations as padded arrays. Residuals are whitened by point sigmas times all sigma
        factors.
        """
        table = observation_table(self.views, self.target)
        factor = self.sigma_factor[np.asarray(table.camera)]
        factor[: len(self.views)] *= [view.sigma_ratio for view in self.views]
        return table._replace(whitening=table.whitening / factor[:, None, None, None])


class SolvedProblem(NamedTuple):
    """Solution of a calibration problem with its covariance.

    Attributes
    ----------
    problem : the problem at its solution.
    covariance : (f, f) covariance of the f estimated shared parameters (lenses, cameras, board
        shape).
    variance_factor : noise variance estimated from the scatter between the shots, divided by the
        variance that the point sigmas state. The covariance contains it.
    """

    problem: Problem
    covariance: Float[np.ndarray, "f f"]
    variance_factor: float


def cam_from_board(state: RigState, view: BoardObservation) -> Pose:
    """Pose of the board of one observation in the frame of the observing camera."""
    pose = Pose(np.asarray(state.cam_from_rig)[view.camera])
    pose @= Pose(np.asarray(state.rig_from_board)[view.shot])
    return (
        pose @ Pose(np.asarray(state.set_from_board)[view.board])
        if len(state.set_from_board)
        else pose
    )


def lens_of_index(problem: Problem, lens_index: int) -> AbstractLens:
    """Lens with index `lens_index` of the problem's state."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[lens_index], problem.state.lenses)


class FreeLensParameters(NamedTuple):
    """Assignment of lenses to cameras, and the estimated parameters of each lens.

    Attributes
    ----------
    lens_of_camera : (c,) index of each camera's lens.
    free : (l, q) mask of the estimated parameters of l lenses with q parameters each.
    """

    lens_of_camera: np.ndarray
    free: Bool[np.ndarray, "l q"]


def with_lens_free(problem: Problem, free: Bool[np.ndarray, "l q"]) -> Problem:
    """Problem in which a mask selects the lens parameters that are estimated.

    Distortion coefficients that are not estimated are set to 0. They keep their values in three
    cases: all parameters of the lens are fixed, the lens has a prior, or the model never estimates
    the coefficient.

    free : (l, q) mask of the estimated parameters of l lenses.
    """
    all_free = np.array(problem.free)
    all_free[problem.slices.lenses] = free.astype(float).ravel()
    coefficients = np.asarray(problem.state.lenses.coefficients)
    keeps_values = ~free.any(axis=1, keepdims=True) | has_lens_prior(problem.priors)[:, None]
    model = problem.state.lenses
    never_fitted = np.array(
        [[name in model.never_fitted for name in model.coefficient_names]], dtype=bool
    )
    values = np.where(
        free[:, len(AFFINE_PARAMETERS) :] | keeps_values | never_fitted, coefficients, 0.0
    )
    state = eqx.tree_at(lambda state: state.lenses.coefficients, problem.state, values)
    return with_free_parameters(problem._replace(state=state), all_free)


def with_fixed_aspect(problem: Problem) -> Problem:
    """Problem in which the ratio fx / fy of every estimated lens is fixed at its present value."""
    fx, fy = AFFINE_PARAMETERS.index("fx_px"), AFFINE_PARAMETERS.index("fy_px")
    free = np.array(problem.free)
    lens_free = free[problem.slices.lenses].reshape(problem.parametrization.lens_shape)
    basis = np.array(problem.parametrization.lens_basis)
    basis[:, fy, fx] = basis[:, fy, fy]
    lens_free[:, fy] = 0.0
    free[problem.slices.lenses] = lens_free.ravel()
    parametrization = dataclasses.replace(problem.parametrization, lens_basis=basis, free=free)
    return problem._replace(parametrization=parametrization)


def has_lens_prior(priors: Priors) -> Bool[np.ndarray, "l"]:
    """Mask, (l,), of the lenses whose prior comes from a given covariance.

    The priors of spline corrections do not count; their mean is 0.
    """
    means_and_information = zip(
        np.asarray(priors.lens_mean), np.asarray(priors.lens_information), strict=True
    )
    return np.array(
        [bool(mean.any() and information.any()) for mean, information in means_and_information]
    )


def with_priors(problem: Problem, **values: ArrayLike) -> Problem:
    """Problem in which some fields of its `Priors` are replaced. values : new arrays, by field
    name.
    """
    priors = dataclasses.replace(problem.priors, **values)
    parametrization = dataclasses.replace(problem.parametrization, priors=priors)
    return problem._replace(parametrization=parametrization)


def with_lens_prior(problem: Problem, lens_index: int, factor: Float[np.ndarray, "k r"]) -> Problem:
    """Problem with a Gaussian prior of one lens. The prior mean is the present value of the lens.

    lens_index : index of the lens.
    factor : (k, r) factor L of the covariance L L^T of the first k lens parameters. A parameter of
        variance 0 is fixed.
    """
    covariance = factor @ factor.T
    rows = np.flatnonzero(np.diag(covariance) > 0)
    sigma = np.sqrt(np.diag(covariance)[rows])
    # Fully correlated parameters, such as both focal lengths of a data sheet, stay two unknowns.
    correlation = covariance[np.ix_(rows, rows)] / np.outer(
        sigma, sigma
    ) + _INDEPENDENT_SHARE * np.eye(len(rows))
    mean = np.array(problem.priors.lens_mean)
    information = np.array(problem.priors.lens_information)
    mean[lens_index] = np.asarray(lens_of_index(problem, lens_index).parameters)
    information[lens_index][np.ix_(rows, rows)] = np.linalg.inv(correlation) / np.outer(
        sigma, sigma
    )
    free = np.array(problem.free)
    free[problem.slices.lens(lens_index)][rows] = 1.0
    with_prior = with_free_parameters(
        with_priors(problem, lens_mean=mean, lens_information=information), free
    )
    # Thousands of coordinates of the shots determine all of them.
    return with_prior._replace(lens_dof=problem.lens_dof + float(len(rows)))


def with_wider_lenses(
    problem: Problem, lenses: Sequence[AbstractLens], image_sizes_px: Sequence[tuple[int, int]]
) -> Problem:
    """Problem in which each lens is replaced by a lens of a more general model.

    The first parameters of the general model must be those of the present model. The additional
    parameters are estimated without a prior. They are fixed if all parameters of the lens are
    fixed.

    lenses : lenses of the general model, with the present values.
    image_sizes_px : (width, height) of the images of each lens.
    """
    count, size = problem.parametrization.lens_shape
    added_count = len(lenses[0].parameter_names) - size
    names, never_fitted = lenses[0].parameter_names[size:], lenses[0].never_fitted
    scale = np.stack(
        [lens.parameter_scales(size_px) for lens, size_px in zip(lenses, image_sizes_px[:count])]
    )
    all_free = np.asarray(problem.free)
    lens_free, other_free = all_free[: count * size].reshape(count, size), all_free[count * size :]
    added_free = lens_free.any(axis=1, keepdims=True) * np.array(
        [name not in never_fitted for name in names]
    )
    wider = with_priors(
        problem,
        lens_mean=np.pad(problem.priors.lens_mean, ((0, 0), (0, added_count))),
        lens_information=np.pad(
            problem.priors.lens_information, ((0, 0), (0, added_count), (0, added_count))
        ),
    )
    parametrization = dataclasses.replace(
        wider.parametrization,
        lens_basis=basis_of_scales(scale),
        free=np.append(np.append(lens_free, added_free, axis=1).ravel(), other_free),
    )
    state = eqx.tree_at(lambda state: state.lenses, problem.state, stack_problem_lenses(lenses))
    return problem._replace(state=state, parametrization=parametrization)


def with_fixed_board_shape(problem: Problem) -> Problem:
    """Problem with the board fixed at its present shape."""
    all_free = np.array(problem.free)
    all_free[problem.slices.sheets.start :] = 0.0
    return with_free_parameters(problem, all_free)


def with_only_boards_free(problem: Problem) -> Problem:
    """Problem in which only the board pose of each shot is estimated.

    Lenses, camera poses and board shape are fixed.
    """
    return with_free_parameters(problem, np.zeros(len(problem.free)))


def with_free_parameters(problem: Problem, free: Float[np.ndarray, "h"]) -> Problem:
    """Problem with another mask of estimated shared parameters (lenses, cameras, board shape).

    free : (h,) 1 for an estimated parameter, 0 for a fixed one.
    """
    parametrization = dataclasses.replace(problem.parametrization, free=free)
    return problem._replace(parametrization=parametrization)


def basis_of_scales(scale: Float[np.ndarray, "l q"]) -> Float[np.ndarray, "l q q"]:
    """Diagonal matrices for `Parametrization.lens_basis`, (l, q, q).

    scale : (l, q) change of each lens parameter for a unit change of its local coordinate.
    """
    return scale[:, :, None] * np.eye(scale.shape[1])[None]


def stack_problem_lenses(lenses: Sequence[AbstractLens]) -> AbstractLens:
    """Stack lenses of one model along a new first axis, in double precision."""
    plain = partial(jax.tree.map, partial(np.asarray, dtype=np.float64))
    return stack_lenses([plain(lens) for lens in lenses])
