"""Which fitted ellipses are to be believed: whole circles of the sheet, undisturbed."""

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
    """Whether a fit is a whole circle near the place and of the size that the lattice says."""
    off = fitted.centres_px - centre_px
    miss2 = np.einsum("ni,nij,nj->n", off, np.linalg.inv(shape_px2), off)
    area_ratio = np.sqrt(np.linalg.det(fitted.shape_px2) / np.linalg.det(shape_px2))
    area_ratio = area_ratio / quick_median(area_ratio)
    contrast = fitted.paper * fitted.ink
    typical = quick_median(contrast)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.abs(fitted.residual_sigma / contrast)
        misfit = max(0.12, 1.6 * float(quick_median(relative)))
        allowed = np.sqrt((1.6 * noise_sigma / contrast) ** 2 + misfit**2)
    return (
        np.isfinite(miss2)
        & (miss2 < 0.5**2)
        & (np.abs(np.log(area_ratio)) < np.log(1.5))
        & (contrast > 0.3 * typical)
        & (contrast < 3.0 * typical)
        & (fitted.kept > 0.8)
        & (relative < allowed)
    )


def are_undisturbed(fitted: Ellipses, noise_sigma: float) -> np.ndarray:
    """Circles whose edge fits as well as is usual: none with a shadow's edge across it."""
    contrast = np.abs(fitted.paper * fitted.ink)
    beyond_noise = np.maximum(fitted.residual_sigma**2 - noise_sigma**2, 0.0)
    misfit = np.sqrt(beyond_noise) / contrast
    return misfit < 2.5 * quick_median(misfit) + 0.02 + 0.6 * noise_sigma / contrast


def _have_expected_shapes(
    fitted: Ellipses, shape_px2: Float[np.ndarray, "n 2 2"], own_px: Float[np.ndarray, "n"]
) -> np.ndarray:
    """Ellipses as long, as wide and as slanted as the sheet's: none with a finger on its edge."""
    frame = inverse_square_root(shape_px2)
    relative = frame @ fitted.shape_px2 @ frame
    scale = quick_median(np.sqrt(np.linalg.det(relative)))
    misfit = np.abs(relative / scale - np.eye(2)).max(axis=(1, 2))
    unsure = 3.0 * own_px / smallest_axis(shape_px2)
    return misfit < 3.0 * quick_median(misfit) + np.minimum(unsure, 0.2) + 0.05


def select_agreeing(
    fitted: Ellipses, index: Int[np.ndarray, "m"], pattern: Pattern, tuning: CalibTuning
) -> tuple[np.ndarray, PlaneMapping]:
    """Circles that lie where a smooth picture of the sheet puts them, and that picture."""
    good = np.ones(len(index), dtype=bool)
    own = np.sqrt(np.trace(fitted.covariance_px2, axis1=1, axis2=2))
    sharp = 0.03 * smallest_axis(fitted.shape_px2)
    centres_mm, radius_mm = pattern.centres_mm[index], pattern.radius_mm[index]
    mapping = fit_plane_mapping(centres_mm, fitted.centres_px, radius_mm, tuning=tuning)
    for _ in range(2):
        centre, shape = mapping.ellipses(centres_mm, radius_mm)
        off = fitted.centres_px - centre
        miss = np.sqrt(off[:, 0] ** 2 + off[:, 1] ** 2)
        before = good
        good = miss < 3.0 * quick_median(miss[good]) + 3.0 * own + sharp
        good &= _have_expected_shapes(fitted, shape, own)
        if np.array_equal(before, good) or np.sum(good) < tuning.detection.fewest_places:
            break
        mapping = fit_plane_mapping(
            centres_mm[good], fitted.centres_px[good], radius_mm[good], tuning=tuning
        )
    return good, mapping
