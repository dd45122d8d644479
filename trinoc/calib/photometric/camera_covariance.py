"""What the end of the extended fit says: covariance for noise that neighbours share."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.camera_scene import CameraScene
from trinoc.calib.photometric.camera_steps import (
    Equations,
    Point,
    pose_information,
    share_of_rest,
)
from trinoc.calib.photometric.clipped_noise import clipped, is_clear
from trinoc.calib.photometric.correlated_noise import autocorrelation, correlated_sum
from trinoc.calib.photometric.unknowns import LOOK_NAMES, CameraState

# Sharpening lowers the variance of what an edge says to a half of white noise's, not further.
_LEAST_SPREAD = 0.4


class CameraFit(NamedTuple):
    """Where the extended fit ended.

    Fields
    ------
    state : of all unknowns.
    active : places of those that were free.
    covariance : (p, p) of a step of the pose, for the noise that the residuals show, shared by
        neighbours.
    chi_square : reduced, of the residuals over their own noise.
    sigma : noise at the grey level between paper and ink.
    kept : (n,) pixels that stayed.
    correlation : of neighbours' noise, by lag.
    spread_of : standard deviations of the unknowns of the look, 0 for those that were held.
    sums : normal equations at the end.
    by_shift : (3, n) derivatives of the pixels by the third column of the homography.
    inflation : variance of the pose over that of independent noise as large as was assumed.
    """

    state: CameraState
    active: list[int]
    covariance: Float[np.ndarray, "p p"]
    chi_square: float
    sigma: float
    kept: Bool[np.ndarray, "n"]
    correlation: Float[np.ndarray, "9 9"]
    spread_of: Float[np.ndarray, "15"]
    sums: Equations
    by_shift: Float[np.ndarray, "3 n"]
    inflation: float


def judged(scene: CameraScene, point: Point, sums: Equations, active: list[int]) -> CameraFit:
    """The fit at its last point: pose covariance as a sandwich over correlated residuals."""
    size = scene.model.size
    follow = share_of_rest(sums.matrix, active, size)
    motion = -follow
    motion[:size] = np.eye(size)
    rows = motion.T.astype(sums.rows.dtype) @ sums.rows
    if sums.local is not None and scene.blocks is not None:
        of_levels, eliminated = sums.local
        levels = eliminated.by_rest @ motion
        rows = rows - np.einsum("kn,nkp->pn", of_levels, levels[scene.blocks.of_pixel])
    standard = sums.residual / sums.sigma
    # Saturated pixels are certain, and say nothing of the noise.
    kept = point.kept
    clear = kept & is_clear(point.prediction.level, point.sigma, scene.top)
    correlation = autocorrelation(scene.grid, standard, clear)
    middle = correlated_sum(scene.grid, rows * np.sqrt(sums.weight), correlation)
    inverse = np.linalg.pinv(pose_information(sums.matrix, active, size), hermitian=True)
    chi_square = float(np.sum(standard[clear] ** 2) / max(clear.sum() - len(active), 1))
    everything = np.sqrt(np.abs(np.diag(np.linalg.pinv(sums.matrix[np.ix_(active, active)]))))
    spread = np.zeros(scene.layout.size)
    spread[active] = everything
    look = spread[size : size + len(LOOK_NAMES)]
    levels = point.prediction.level
    half = point.state.light[0] * (1 + 0.5 * point.state.look_of("ratio"))
    near = np.argsort(np.abs(levels - half))[: max(len(levels) // 50, 1)]
    covariance = _sandwich(inverse, middle) * chi_square
    by_shift = point.prediction.by_shift
    if np.isfinite(scene.top):
        by_shift = by_shift * clipped(point.prediction.level, point.sigma, scene.top).slope
    information = np.linalg.pinv(inverse, hermitian=True)
    inflation = float(np.trace(information @ covariance)) / size
    if not inflation > 0:
        # Nothing is left of what the pixels would say: there is no fit.
        covariance = np.full_like(covariance, np.nan)
    return CameraFit(
        point.state,
        active,
        covariance,
        chi_square,
        float(np.median(point.sigma[near])),
        kept,
        correlation,
        look,
        sums,
        by_shift,
        inflation,
    )


def _sandwich(
    inverse: Float[np.ndarray, "p p"], middle: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, "p p"]:
    """inverse middle inverse, in no direction far below `inverse`.

    Correlations that are estimated one lag at a time need not be those of any noise.
    """
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    values, vectors = np.linalg.eigh(root.T @ middle @ root)
    spread = root @ vectors * np.sqrt(np.maximum(values, _LEAST_SPREAD))
    return spread @ spread.T
