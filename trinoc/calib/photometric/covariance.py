"""Covariance of a fitted pose, for noise that may be correlated between neighbouring pixels."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.equations import local_rows
from trinoc.calib.photometric.fit_state import ImageFitState
from trinoc.calib.photometric.noise import autocorrelation, sum_correlated
from trinoc.calib.photometric.scene import PixelScene


class PoseCovariance(NamedTuple):
    """Covariance of a fitted pose, and statistics of the image noise.

    Attributes
    ----------
    matrix : (p, p) covariance of a small step of the pose: angles in radians, lengths divided by
        the camera's distance. NaN if the pixels do not determine the pose.
    chi_square : reduced chi-square of the pixel residuals.
    correlation : (9, 9) correlation of the noise of two pixels, by their offset (rows, columns);
        offset 0 is in the centre. None if it was not estimated.
    inflation : mean factor by which `matrix` exceeds the covariance for independent noise with the
        assumed sigmas.
    """

    matrix: Float[np.ndarray, "p p"]
    chi_square: float
    correlation: Float[np.ndarray, "9 9"] | None
    inflation: float


def pose_covariance(
    scene: PixelScene, fit_state: ImageFitState, *, correlated: bool
) -> PoseCovariance:
    """Covariance of the pose at the end of a fit.

    Parameters
    ----------
    scene : pixels and constants of the fit.
    fit_state : result of the last step of the fit.
    correlated : True for a sandwich covariance, which includes the estimated correlation of the
        noise of neighbouring pixels. False for the inverse of the information matrix.
    """
    size, free = scene.model.size, fit_state.free
    residual, sigma = fit_state.residual(scene)
    # Saturated pixels have no noise.
    clear = fit_state.is_clear(scene)
    standard = residual / sigma
    chi_square = float(np.sum(standard[clear] ** 2) / max(clear.sum() - free.sum(), 1))
    matrix, _, levels_by_unknowns = fit_state.normal_equations()
    elimination = elimination_matrix(matrix, free, size)
    information = pose_information(matrix, elimination)
    if not np.isfinite(information).all():
        return PoseCovariance(np.full((size, size), np.nan), chi_square, None, np.nan)
    inverse = np.linalg.pinv(information, hermitian=True)
    if not correlated:
        return PoseCovariance(inverse * chi_square, chi_square, None, chi_square)
    grid = scene.grid
    correlation = autocorrelation(grid, standard, clear, scene.tuning.significant_sigmas)
    rows = _pose_derivatives(scene, fit_state, elimination, levels_by_unknowns) * (
        fit_state.inliers / sigma
    )
    middle = sum_correlated(grid, rows, correlation)
    matrix = _sandwich(inverse, middle, scene.tuning.least_spread) * chi_square
    inflation = float(np.trace(np.linalg.pinv(inverse, hermitian=True) @ matrix)) / size
    if not inflation > 0:
        matrix = np.full_like(matrix, np.nan)
    return PoseCovariance(matrix, chi_square, correlation, inflation)


def spread_of_values(scene: PixelScene, fit_state: ImageFitState) -> Float[np.ndarray, "k"]:
    """Standard deviations of the unknowns other than the pose, (k,); 0 for fixed unknowns."""
    spread, free = np.zeros(len(fit_state.free)), fit_state.free
    inverse = np.linalg.pinv(fit_state.normal_equations()[0][np.ix_(free, free)])
    spread[free] = np.sqrt(np.abs(np.diag(inverse)))
    return spread[scene.model.size :]


def elimination_matrix(
    matrix: Float[np.ndarray, "k k"], free: Bool[np.ndarray, "k"], pose_size: int
) -> Float[np.ndarray, "k p"]:
    """Matrix E that eliminates the other unknowns from the normal equations of the pose.

    If the pose changes by d, the optimal change of the other unknowns is -E d.

    Parameters
    ----------
    matrix : (k, k) normal matrix, the p parameters of the pose first.
    free : (k,) mask of the estimated unknowns; those of the pose are all estimated.
    pose_size : number p of pose parameters.

    Returns
    -------
    (k, p) matrix. The rows of the pose and of fixed unknowns are 0.
    """
    image_parameters = np.flatnonzero(free)[pose_size:]
    inner = matrix[np.ix_(image_parameters, image_parameters)]
    scale = 1 / np.sqrt(np.maximum(np.diag(inner), 1e-300))
    scaled = inner * scale[:, None] * scale
    elimination = np.zeros((len(matrix), pose_size))
    if np.isfinite(scaled).all():
        side = scale[:, None] * matrix[image_parameters, :pose_size]
        elimination[image_parameters] = scale[:, None] * np.linalg.lstsq(scaled, side)[0]
    return elimination


def pose_information(
    matrix: Float[np.ndarray, "k k"], elimination: Float[np.ndarray, "k p"]
) -> Float[np.ndarray, "p p"]:
    """Information matrix (p, p) of the pose after elimination of the other unknowns.

    This is a Schur complement.

    Parameters
    ----------
    matrix : (k, k) normal matrix, the p parameters of the pose first.
    elimination : (k, p) result of `elimination_matrix`.
    """
    size = elimination.shape[1]
    return matrix[:size, :size] - matrix[:size] @ elimination


def _pose_derivatives(
    scene: PixelScene,
    fit_state: ImageFitState,
    elimination: Float[np.ndarray, "k p"],
    levels_by_unknowns: Float[np.ndarray, "b 6 k"],
) -> Float[np.ndarray, "p n"]:
    """Total derivative (p, n) of each pixel's grey level with respect to the pose.

    The other unknowns follow the pose to their new optimum.

    elimination : (k, p) result of `elimination_matrix`.
    levels_by_unknowns : (b, 6, k) derivative of the optimal local light of each block with respect
        to all unknowns; see `ImageFitState.normal_equations`.
    """
    size = scene.model.size
    motion = -elimination
    motion[:size] = np.eye(size)
    by_motion = np.asarray(fit_state.prediction.by_motion)
    by_homography = np.concatenate([by_motion @ motion[:size], motion[size:]])
    rows = by_homography.T @ fit_state.rows(scene)
    if scene.has_local_light and scene.blocks is not None:
        by_levels = local_rows(fit_state.rows_by_local(scene), scene.blocks.basis)
        levels = levels_by_unknowns @ motion
        rows = rows + np.einsum("kn,nkp->pn", by_levels, levels[scene.blocks.of_pixel])
    return rows


def _sandwich(
    inverse: Float[np.ndarray, "p p"], middle: Float[np.ndarray, "p p"], smallest_spread: float
) -> Float[np.ndarray, "p p"]:
    """Sandwich covariance inverse @ middle @ inverse, at least `smallest_spread` times `inverse`.

    The lower limit is needed because the estimated correlations may not form a valid covariance.
    """
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    values, vectors = np.linalg.eigh(root.T @ middle @ root)
    spread = root @ vectors * np.sqrt(np.maximum(values, smallest_spread))
    return spread @ spread.T
