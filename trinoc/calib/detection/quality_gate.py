"""Tests of fitted ellipses: complete, undisturbed circles at the predicted position."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detection.ellipse_fit import Ellipses
from trinoc.calib.detection.ellipse_pixels import (
    inverse_square_root,
    quick_median,
    smallest_axis,
)
from trinoc.calib.detection.plane_mapping import PlaneMapping, fit_plane_mapping
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import CalibTuning


def are_plausible(
    fitted: Ellipses,
    centre_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    noise_sigma: float,
) -> np.ndarray:
    """Mask of the ellipses that can be images of circles of the sheet.

    Position, relative size, contrast, share of inliers and residual are tested.

    Parameters
    ----------
    fitted : (n,) fitted ellipses.
    centre_px, shape_px2 : (n, 2), (n, 2, 2) ellipses predicted from the lattice.
    noise_sigma : standard deviation of the image noise, grey levels.
    """
    deviation = fitted.centres_px - centre_px
    squared_radii = np.einsum("ni,nij,nj->n", deviation, np.linalg.inv(shape_px2), deviation)
    area_ratio = np.sqrt(np.linalg.det(fitted.shape_px2) / np.linalg.det(shape_px2))
    area_ratio = area_ratio / quick_median(area_ratio)
    contrast = fitted.paper * fitted.ink
    typical = quick_median(contrast)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.abs(fitted.residual_sigma / contrast)
        typical_misfit = max(0.12, 1.6 * float(quick_median(relative)))
        allowed = np.sqrt((1.6 * noise_sigma / contrast) ** 2 + typical_misfit**2)
    return (
        np.isfinite(squared_radii)
        & (squared_radii < 0.5**2)
        & (np.abs(np.log(area_ratio)) < np.log(1.5))
        & (contrast > 0.3 * typical)
        & (contrast < 3.0 * typical)
        & (fitted.inlier_share > 0.8)
        & (relative < allowed)
    )


def are_undisturbed(fitted: Ellipses, noise_sigma: float) -> np.ndarray:
    """Mask of the circles without an unusually large residual, for example at the edge of a shadow.

    Parameters
    ----------
    fitted : (n,) fitted ellipses.
    noise_sigma : standard deviation of the image noise, grey levels.
    """
    contrast = np.abs(fitted.paper * fitted.ink)
    beyond_noise = np.maximum(fitted.residual_sigma**2 - noise_sigma**2, 0.0)
    misfit = np.sqrt(beyond_noise) / contrast
    return misfit < 2.5 * quick_median(misfit) + 0.02 + 0.6 * noise_sigma / contrast


def _have_expected_shapes(
    fitted: Ellipses, shape_px2: Float[np.ndarray, "n 2 2"], sigma_px: Float[np.ndarray, "n"]
) -> np.ndarray:
    """Mask of the ellipses whose axes and direction agree with the prediction.

    The ellipse of a partly covered circle does not agree.

    shape_px2 : (n, 2, 2) predicted shape matrices.
    sigma_px : (n,) standard deviation of each centre.
    """
    frame = inverse_square_root(shape_px2)
    relative = frame @ fitted.shape_px2 @ frame
    scale = quick_median(np.sqrt(np.linalg.det(relative)))
    misfit = np.abs(relative / scale - np.eye(2)).max(axis=(1, 2))
    noise = 3.0 * sigma_px / smallest_axis(shape_px2)
    return misfit < 3.0 * quick_median(misfit) + np.minimum(noise, 0.2) + 0.05


def select_agreeing(
    fitted: Ellipses, index: Int[np.ndarray, "m"], pattern: Pattern, tuning: CalibTuning
) -> tuple[np.ndarray, PlaneMapping]:
    """Select the circles that agree with one smooth mapping from the sheet to the image.

    Parameters
    ----------
    fitted : (m,) measured ellipses.
    index : (m,) pattern index of each circle.
    pattern : the sheet.
    tuning : tuned constants of calibration.

    Returns
    -------
    (m,) mask of the circles that agree, and the mapping.
    """
    agrees = np.ones(len(index), dtype=bool)
    sigma_px = np.sqrt(np.trace(fitted.covariance_px2, axis1=1, axis2=2))
    tolerance_px = 0.03 * smallest_axis(fitted.shape_px2)
    centres_mm, radius_mm = pattern.centres_mm[index], pattern.radius_mm[index]
    mapping = fit_plane_mapping(centres_mm, fitted.centres_px, radius_mm, tuning=tuning)
    for _ in range(2):
        centre, shape = mapping.ellipses(centres_mm, radius_mm)
        deviation = fitted.centres_px - centre
        error_px = np.sqrt(deviation[:, 0] ** 2 + deviation[:, 1] ** 2)
        previous = agrees
        agrees = error_px < 3.0 * quick_median(error_px[agrees]) + 3.0 * sigma_px + tolerance_px
        agrees &= _have_expected_shapes(fitted, shape, sigma_px)
        if np.array_equal(previous, agrees) or np.sum(agrees) < tuning.detection.fewest_places:
            break
        mapping = fit_plane_mapping(
            centres_mm[agrees], fitted.centres_px[agrees], radius_mm[agrees], tuning=tuning
        )
    return agrees, mapping
