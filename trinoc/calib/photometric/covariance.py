"""Covariance of a fitted pose, for noise that may be correlated between neighbouring pixels."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.equations import local_rows
from trinoc.calib.photometric.fit_state import ImageFitState
from trinoc.calib.photometric.noise import autocorrelation, sum_correlated
from trinoc.calib.photometric.scene import PixelScene


class PoseCovariance(NamedTuple):
    """Covariance of a fitted pose, and statistics of the noise.

    Fields
    ------
    matrix : (p, p) covariance of a step of the pose, lengths in units of its distance; NaN if the
        pixels do not determine it.
    chi_square : reduced chi-square of the residuals.
    correlation : correlation of the noise of neighbouring pixels by lag; None if it was not
        estimated.
    inflation : variance of the pose divided by that for independent noise with the assumed sigmas.
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
    scene : constants of the fit.
    fit_state : end of the fit.
    correlated : True for a sandwich covariance with the estimated correlation of the noise; False
        for the inverse of the information.
    """
    size, free = scene.model.size, fit_state.free
    residual, sigma = fit_state.residual(scene)
    # Saturated pixels have no noise.
    clear = fit_state.is_clear(scene)
    standard = residual / sigma
    chi_square = float(np.sum(standard[clear] ** 2) / max(clear.sum() - free.sum(), 1))
    matrix, _, follow_of_levels = fit_state.normal_equations()
    follow = elimination_matrix(matrix, free, size)
    information = pose_information(matrix, follow)
    if not np.isfinite(information).all():
        return PoseCovariance(np.full((size, size), np.nan), chi_square, None, np.nan)
    inverse = np.linalg.pinv(information, hermitian=True)
    if not correlated:
        return PoseCovariance(inverse * chi_square, chi_square, None, chi_square)
    grid = scene.grid
    correlation = autocorrelation(grid, standard, clear, scene.tuning.significant_sigmas)
    rows = _rows_of_pose(scene, fit_state, follow, follow_of_levels) * (fit_state.inliers / sigma)
    middle = sum_correlated(grid, rows, correlation)
    matrix = _sandwich(inverse, middle, scene.tuning.least_spread) * chi_square
    inflation = float(np.trace(np.linalg.pinv(inverse, hermitian=True) @ matrix)) / size
    if not inflation > 0:
        matrix = np.full_like(matrix, np.nan)
    return PoseCovariance(matrix, chi_square, correlation, inflation)


def spread_of_values(scene: PixelScene, fit_state: ImageFitState) -> Float[np.ndarray, "k"]:
    """Standard deviations of the unknowns other than the pose; 0 for fixed ones."""
    spread, free = np.zeros(len(fit_state.free)), fit_state.free
    inverse = np.linalg.pinv(fit_state.normal_equations()[0][np.ix_(free, free)])
    spread[free] = np.sqrt(np.abs(np.diag(inverse)))
    return spread[scene.model.size :]


def elimination_matrix(
    matrix: Float[np.ndarray, "k k"], free: Bool[np.ndarray, "k"], pose_size: int
) -> Float[np.ndarray, "k p"]:
    """Derivative of the optimal other unknowns by the pose, with opposite sign; 0 for fixed ones.

    matrix : (k, k) normal matrix of (pose, other unknowns).
    free : (k,) mask of the estimated unknowns.
    """
    rest = np.flatnonzero(free)[pose_size:]
    inner = matrix[np.ix_(rest, rest)]
    scale = 1 / np.sqrt(np.maximum(np.diag(inner), 1e-300))
    scaled = inner * scale[:, None] * scale
    follow = np.zeros((len(matrix), pose_size))
    if np.isfinite(scaled).all():
        side = scale[:, None] * matrix[rest, :pose_size]
        follow[rest] = scale[:, None] * np.linalg.lstsq(scaled, side)[0]
    return follow


def pose_information(
    matrix: Float[np.ndarray, "k k"], follow: Float[np.ndarray, "k p"]
) -> Float[np.ndarray, "p p"]:
    """Information of the pose after elimination of the other unknowns (Schur complement)."""
    size = follow.shape[1]
    return matrix[:size, :size] - matrix[:size] @ follow


def _rows_of_pose(
    scene: PixelScene,
    fit_state: ImageFitState,
    follow: Float[np.ndarray, "k p"],
    follow_of_levels: Float[np.ndarray, "b 6 k"],
) -> Float[np.ndarray, "p n"]:
    """Derivatives of each pixel by the pose, with all other unknowns at their optimum.

    follow : see `elimination_matrix`.
    follow_of_levels : the same for the local levels, see `ImageFitState.normal_equations`.
    """
    size = scene.model.size
    motion = -follow
    motion[:size] = np.eye(size)
    by_motion = np.asarray(fit_state.prediction.by_motion)
    by_homography = np.concatenate([by_motion @ motion[:size], motion[size:]])
    rows = by_homography.T @ fit_state.rows(scene)
    if scene.has_local_light and scene.blocks is not None:
        by_levels = local_rows(fit_state.rows_by_local(scene), scene.blocks.basis)
        levels = follow_of_levels @ motion
        rows = rows + np.einsum("kn,nkp->pn", by_levels, levels[scene.blocks.of_pixel])
    return rows


def _sandwich(
    inverse: Float[np.ndarray, "p p"], middle: Float[np.ndarray, "p p"], smallest_spread: float
) -> Float[np.ndarray, "p p"]:
    """Sandwich covariance: inverse @ middle @ inverse, at least `smallest_spread` times `inverse`.

    The lower limit is needed because correlations estimated lag by lag may be inconsistent.
    """
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    values, vectors = np.linalg.eigh(root.T @ middle @ root)
    spread = root @ vectors * np.sqrt(np.maximum(values, smallest_spread))
    return spread @ spread.T
