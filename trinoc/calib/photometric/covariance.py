"""The covariance of a fitted pose, for noise that neighbours may share."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.equations import local_rows
from trinoc.calib.photometric.fit_state import PictureFitState
from trinoc.calib.photometric.noise import autocorrelation, sum_correlated
from trinoc.calib.photometric.scene import PixelScene


class PoseCovariance(NamedTuple):
    """What the end of a fit says of its pose and its noise.

    Fields
    ------
    matrix : (p, p) of a step of the pose, lengths in units of its distance; NaN where nothing is
        left of what the pixels would say.
    chi_square : reduced, of the residuals over their own noise.
    correlation : of neighbours' noise, by lag; None where it is none.
    inflation : variance of the pose over that of independent noise as large as was assumed.
    """

    matrix: Float[np.ndarray, "p p"]
    chi_square: float
    correlation: Float[np.ndarray, "9 9"] | None
    inflation: float


def pose_covariance(
    scene: PixelScene, point: PictureFitState, *, correlated: bool
) -> PoseCovariance:
    """At the end of a fit: a sandwich over residuals that are correlated, or the inverse of the
    information where they are known not to be."""
    size, free = scene.model.size, point.free
    residual, sigma = point.residual(scene)
    # Saturated pixels are certain, and say nothing of the noise.
    clear = point.is_clear(scene)
    standard = residual / sigma
    chi_square = float(np.sum(standard[clear] ** 2) / max(clear.sum() - free.sum(), 1))
    matrix, _, follow_of_levels = point.normal_equations()
    follow = share_of_rest(matrix, free, size)
    information = pose_information(matrix, follow)
    if not np.isfinite(information).all():
        return PoseCovariance(np.full((size, size), np.nan), chi_square, None, np.nan)
    inverse = np.linalg.pinv(information, hermitian=True)
    if not correlated:
        return PoseCovariance(inverse * chi_square, chi_square, None, chi_square)
    grid = scene.grid
    correlation = autocorrelation(grid, standard, clear, scene.tuning.significant_sigmas)
    rows = _rows_of_pose(scene, point, follow, follow_of_levels) * (point.kept / sigma)
    middle = sum_correlated(grid, rows, correlation)
    matrix = _sandwich(inverse, middle, scene.tuning.least_spread) * chi_square
    inflation = float(np.trace(np.linalg.pinv(inverse, hermitian=True) @ matrix)) / size
    if not inflation > 0:
        matrix = np.full_like(matrix, np.nan)
    return PoseCovariance(matrix, chi_square, correlation, inflation)


def spread_of_values(scene: PixelScene, point: PictureFitState) -> Float[np.ndarray, "k"]:
    """Standard deviations of the unknowns beside the pose, 0 for those that were held."""
    spread, free = np.zeros(len(point.free)), point.free
    inverse = np.linalg.pinv(point.normal_equations()[0][np.ix_(free, free)])
    spread[free] = np.sqrt(np.abs(np.diag(inverse)))
    return spread[scene.model.size :]


def share_of_rest(
    matrix: Float[np.ndarray, "k k"], free: Bool[np.ndarray, "k"], pose_size: int
) -> Float[np.ndarray, "k p"]:
    """By how much the other free unknowns follow the pose, 0 for those that are held."""
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
    """Information of the pose once the other unknowns follow it: the Schur complement."""
    size = follow.shape[1]
    return matrix[:size, :size] - matrix[:size] @ follow


def _rows_of_pose(
    scene: PixelScene,
    point: PictureFitState,
    follow: Float[np.ndarray, "k p"],
    follow_of_levels: Float[np.ndarray, "b 6 k"],
) -> Float[np.ndarray, "p n"]:
    """Derivatives of each pixel by the pose, all other unknowns following it."""
    size = scene.model.size
    motion = -follow
    motion[:size] = np.eye(size)
    by_motion = np.asarray(point.prediction.by_motion)
    by_homography = np.concatenate([by_motion @ motion[:size], motion[size:]])
    rows = by_homography.T @ point.rows(scene)
    if scene.local and scene.blocks is not None:
        by_levels = local_rows(point.rows_by_local(scene), scene.blocks.basis)
        levels = follow_of_levels @ motion
        rows = rows + np.einsum("kn,nkp->pn", by_levels, levels[scene.blocks.of_pixel])
    return rows


def _sandwich(
    inverse: Float[np.ndarray, "p p"], middle: Float[np.ndarray, "p p"], least_spread: float
) -> Float[np.ndarray, "p p"]:
    """inverse middle inverse, in no direction below `least_spread` times `inverse`.

    Correlations that are estimated one lag at a time need not be those of any noise.
    """
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    values, vectors = np.linalg.eigh(root.T @ middle @ root)
    spread = root @ vectors * np.sqrt(np.maximum(values, least_spread))
    return spread @ spread.T
