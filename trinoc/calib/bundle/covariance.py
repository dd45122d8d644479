"""Covariance of refined cameras and segments, and the gauge: directions that remain undetermined.

Cameras: their information, with the lines eliminated, is inverted in the directions that it
determines. Position, orientation and scale of the rig may be undetermined.

Segments: for exact cameras, the ends of a segment are the maximum-likelihood estimate from its
fragments (`geometry.triangulation`), with covariance H^-1. By the implicit function theorem, a
change dc of the cameras moves the ends by dX = -H^-1 (J_X^T W J_c) dc = A dc. The covariance of
several segments is therefore the block-diagonal matrix of their independent parts, plus A S A^T,
where S is the covariance of the cameras. The second part does not average out over segments.

The noise of segments and calibration is estimated by Helmert's estimator: the weighted squared
residuals of a group, divided by its redundancy. The redundancy is the number of observations minus
the number of parameters that the group determines. Source: K.-R. Koch, Parameter Estimation and
Hypothesis Testing in Linear Models, 1999, section 3.6.
"""

import contextlib
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.bundle.camera import CameraState
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.geometry.projection import project_by_matrix
from trinoc.geometry.triangulation import triangulate_segment
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.small_matrices import inverse_positive_definite
from trinoc.numerics.tails import chi_square_limit

# numerical: directions with a smaller share of the largest eigenvalue of the unit-diagonal
# information are undetermined: rounding leaves about 1e-13, and determined directions far more.
FREE_EIGENVALUE = 1e-10
RIGID_GAUGE = "position, orientation and scale of the whole rig"
AIMED_GAUGE = "orientation and scale of the whole rig"


class DeterminedPart(NamedTuple):
    """Rank, covariance and gauge of the refined camera parameters.

    Attributes
    ----------
    rank : number of determined directions.
    covariance : (k, k) covariance of the parameters, with variance 0 in undetermined directions
        (pseudo-inverse of the information in scaled coordinates).
    gauge : description of the undetermined directions, such as the scale of the rig; empty if there
        are none.
    """

    rank: int
    covariance: Float[np.ndarray, "k k"]
    gauge: str


def determined_part(
    information: Float[np.ndarray, "k k"], sheet_information: Float[np.ndarray, "k k"]
) -> DeterminedPart:
    """Separate determined from undetermined directions of the refined camera parameters.

    Parameters
    ----------
    information : (k, k) information about the local coordinates of all cameras, from lines and
        calibration prior. The lines are eliminated.
    sheet_information : (k, k) part of `information` that comes from the calibration prior. A
        direction in which this prior is weak (correlated errors of lens and distance) still counts
        as determined, because directions are compared in sigmas of the prior.
    """
    units = _units(information, sheet_information)
    scaled_information = units.T @ information @ units
    scale = _positive_root(np.diag(scaled_information))
    values, vectors = np.linalg.eigh(scaled_information / scale[:, None] / scale[None, :])
    is_determined = values > FREE_EIGENVALUE * values[-1]
    by_direction = (units / scale) @ vectors[:, is_determined]
    undetermined = int((~is_determined).sum())
    gauge = {0: "", 4: AIMED_GAUGE, 7: RIGID_GAUGE}.get(
        undetermined, f"{undetermined} directions of the cameras"
    )
    return DeterminedPart(
        int(is_determined.sum()), (by_direction / values[is_determined]) @ by_direction.T, gauge
    )


def _units(
    information: Float[np.ndarray, "k k"], sheet_information: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, "k k"]:
    """Matrix, (k, k), whose columns are changes of the k camera parameters that count as equally
    large.

    For parameters with a calibration prior, each column is a change of one prior sigma. Each other
    column changes one parameter by its sigma for exact other parameters.
    """
    units = np.diag(1 / _positive_root(np.diag(information)))
    has_prior = np.flatnonzero(np.diag(sheet_information) > 0)
    if len(has_prior):
        scale = np.sqrt(np.diag(sheet_information)[has_prior])
        prior_correlation = sheet_information[np.ix_(has_prior, has_prior)] / np.outer(scale, scale)
        with contextlib.suppress(np.linalg.LinAlgError):
            units[np.ix_(has_prior, has_prior)] = (
                np.linalg.inv(np.linalg.cholesky(prior_correlation)).T / scale[:, None]
            )
    return units


def _positive_root(diagonal: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
    """Square root with a positive minimum, so that no division by zero occurs."""
    return np.sqrt(np.maximum(diagonal, 1e-30 * diagonal.max() or 1.0))


def segment_and_errors(
    cameras: CameraState,
    fragments_px: Float[ArrayLike, "v 2 2"],
    covariance_px2: Float[ArrayLike, "v 4 4"],
    is_observed: Bool[ArrayLike, "v"],
) -> tuple[Float[ArrayLike, "2 3"], Float[ArrayLike, "6 6"], Float[ArrayLike, "6 k"]]:
    """Triangulate a 3-D segment from its images, and propagate the errors of images and cameras.

    A fragment is the part of a detected segment that shows this 3-D segment.

    Parameters
    ----------
    cameras : v stacked cameras.
    fragments_px : (v, 2, 2) both ends of the fragment in each view.
    covariance_px2 : (v, 4, 4) covariance of these ends.
    is_observed : (v,) whether the segment is observed in each view.

    Returns
    -------
    The ends, (2, 3) in mm; their covariance for exact cameras, (6, 6) in mm^2; and the Jacobian of
    the ends, (6, k), with respect to the local coordinates of all cameras.
    """
    fragments_px = jnp.where(is_observed[:, None, None], fragments_px, 0.0)
    identity = jnp.eye(4, dtype=covariance_px2.dtype)
    covariance_px2 = jnp.where(is_observed[:, None, None], covariance_px2, identity[None])
    undistort = jax.vmap(lambda camera, ends: jax.vmap(camera.lens.undistort_pixel)(ends))
    matrices = jax.vmap(lambda camera: camera.matrix_px)(cameras)
    segment = triangulate_segment(
        matrices, undistort(cameras, fragments_px), covariance_px2, is_observed
    )

    def one_view(
        camera: CameraState,
        fragment_px: ArrayLike,
        covariance: ArrayLike,
        is_observed_here: ArrayLike,
    ) -> ArrayLike:
        def residual(ends: ArrayLike, step: ArrayLike) -> ArrayLike:
            stepped = camera.retract(step)
            image = jax.vmap(project_by_matrix, in_axes=(None, 0))(stepped.matrix_px, ends)
            observed = jax.vmap(stepped.lens.undistort_pixel)(fragment_px)
            return (image - observed).reshape(4)

        at_rest = jnp.zeros(len(camera.names))
        by_ends, by_step = jax.jacfwd(residual, argnums=(0, 1))(segment.ends_mm, at_rest)
        information = jnp.where(is_observed_here, inverse_positive_definite(covariance), 0.0)
        return by_ends.reshape(4, 6).T @ information @ by_step

    coupling = jax.vmap(one_view)(cameras, fragments_px, covariance_px2, is_observed)
    follow = -jnp.einsum("ij,vjp->ivp", segment.covariance_mm2, coupling)
    return segment.ends_mm, segment.covariance_mm2, follow.reshape(6, -1)


def segment_factor(
    squared: Float[np.ndarray, "t v"],
    is_observed: Bool[np.ndarray, "t v"],
    cameras_trace: float,
    tuning: CalibTuning,
) -> tuple[float, Bool[np.ndarray, "t v"]]:
    """Estimate the factor by which the stated sigmas of the fragments must be multiplied.

    A fragment is the part of a detected segment that a track uses. Only tracks all of whose
    fragments are inliers are used. A track with n views has 2 n - 4 redundant distances. If the
    total redundancy is below 1, the factor is 1.

    Parameters
    ----------
    squared : (t, v) squared distance of each fragment from its line, in stated sigmas.
    is_observed : (t, v) whether each track is observed in each view.
    cameras_trace : number of camera parameters that the fragments determine. The redundancy is
        reduced by this number.
    tuning : limit of the test for inliers.

    Returns
    -------
    The factor, and the mask (t, v) of the inlier fragments.
    """
    # Limit for the two distances of a fragment's ends.
    inlier_squared = chi_square_limit(tuning.bundle.outlier_chance, 2)
    factor = 1.0
    for _ in range(10):
        inlier = is_observed & (squared <= inlier_squared * max(factor, 1e-3) ** 2)
        all_inliers = (inlier == is_observed).all(axis=1) & (is_observed.sum(axis=1) >= 3)
        redundancy = (2 * is_observed[all_inliers].sum(axis=1) - 4).sum() - cameras_trace
        if redundancy < 1:
            return 1.0, inlier
        update = float(np.sqrt(squared[all_inliers].sum() / redundancy))
        if abs(update - factor) < 1e-4 * factor:
            break
        factor = update
    return factor, inlier


def sheet_factor(chi_square: float, redundancy: float, tuning: CalibTuning) -> float:
    """Estimate the factor by which the stated sigmas of the calibration must be multiplied.

    It is sqrt(chi_square / redundancy), or 1 if the redundancy is small.

    chi_square : chi-square of the calibration's fit, plus that of the change of the cameras by the
        refinement.
    redundancy : degrees of freedom of both together.
    """
    if redundancy < tuning.bundle.fewest_for_sheet:
        return 1.0
    return float(np.sqrt(chi_square / redundancy))
