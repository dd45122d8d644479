"""Fit of ellipses to the grey levels around them.

The model of a circle's image is light (1 - ink coverage). Across the edge, the coverage is
Phi(d / blur), with d the distance to the ellipse and Phi the normal distribution function. The fit
uses all pixels near the edge, without a threshold or sampled profiles. The model is symmetric
about the centre. Its simplifications (curvature of the edge, shape of the lens's blur) are
symmetric as well and do not move the centre.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection.ellipse_pixels import (
    EllipsePixels,
    column_32 as _column,
    inverse_square_root,
    normal_cdf,
    quick_median,
    smallest_axis,
)
from trinoc.calib.detection.window_noise import WindowPixels, sandwich_covariance
from trinoc.calib.tuning.every_group import CalibTuning

# numerical: parameters of one circle, in the order of the Jacobian's columns.
_CENTRE, _SHAPE, _BLUR, _PAPER, _INK = slice(0, 2), slice(2, 5), 5, 6, 7
_ALWAYS = 8  # numerical: as above
# numerical: next the hole if it is estimated; last the slope of the light if it is estimated.
_HOLE, _SLOPE = 8, slice(-2, None)
# numerical: limits of the blur. Integration over a pixel alone has sigma .29.
_SMALLEST_BLUR_PX, _LARGEST_BLUR_PX = 0.25, 12.0
# numerical: variance of the blur by integration over a square pixel, px^2.
_PIXEL_VARIANCE = 1.0 / 12.0
_DENSITY = np.float32(1.0 / np.sqrt(2.0 * np.pi))  # numerical: of the normal distribution at 0


class Ellipses(NamedTuple):
    """Images of n circles as fitted ellipses, with the quality of each fit.

    Attributes
    ----------
    centres_px : (n, 2) centres.
    shape_px2 : (n, 2, 2) shape matrices S of the ellipses, (x - c)^T S^-1 (x - c) = 1.
    blur_px : (n,) sigma of the edge's blur.
    paper : (n,) grey level of the paper, extrapolated to the centre of the circle.
    ink : (n,) share of the light that the ink absorbs.
    hole : (n,) estimated visibility of the circle's hole: 1 for a ring, 0 for a disc.
    hole_sigma : (n,) standard deviation of `hole`.
    slope : (n, 2) relative change of the light per pixel along x and y.
    covariance_px2 : (n, 2, 2) covariance of the centres.
    residual_sigma : (n,) rms residual of the inlier pixels, grey levels.
    inlier_share : (n,) share of the pixels that are inliers.
    """

    centres_px: Float[np.ndarray, "n 2"]
    shape_px2: Float[np.ndarray, "n 2 2"]
    blur_px: Float[np.ndarray, "n"]
    paper: Float[np.ndarray, "n"]
    ink: Float[np.ndarray, "n"]
    hole: Float[np.ndarray, "n"]
    hole_sigma: Float[np.ndarray, "n"]
    slope: Float[np.ndarray, "n 2"]
    covariance_px2: Float[np.ndarray, "n 2 2"]
    residual_sigma: Float[np.ndarray, "n"]
    inlier_share: Float[np.ndarray, "n"]

    def take(self, index: np.ndarray) -> "Ellipses":
        """Ellipses at the given indices or in a mask."""
        return Ellipses(*(field[index] for field in self))

    def concatenate(self, other: "Ellipses") -> "Ellipses":
        """Ellipses of this set, then those of the other set."""
        return Ellipses(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def rescale(self, factor: int) -> "Ellipses":
        """Convert ellipses of an image reduced by `factor` to pixels of the full image."""
        blur2 = factor**2 * np.maximum(self.blur_px**2 - _PIXEL_VARIANCE, 0.0) + _PIXEL_VARIANCE
        return self._replace(
            centres_px=self.centres_px * factor + 0.5 * (factor - 1),
            shape_px2=self.shape_px2 * factor**2,
            blur_px=np.sqrt(blur2),
            slope=self.slope / factor,
            covariance_px2=self.covariance_px2 * factor**2,
        )


def start_ellipses(
    pixels: EllipsePixels,
    centres_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    *,
    hole_ratio: float,
    sampled_share: float,
) -> Ellipses:
    """Initial values of the fit for ellipses with approximate centres and shapes.

    Grey levels, blur and holes are estimated from the pixels.

    Parameters
    ----------
    pixels : pixels around the ellipses.
    centres_px, shape_px2 : (n, 2), (n, 2, 2) approximate centres and shape matrices.
    hole_ratio : inner radius of the rings divided by the outer radius; 0 for a sheet without rings.
    sampled_share : share of the pixels around the ellipses that `pixels` contains.
    """
    count = len(centres_px)
    y1, y2 = _to_circle_frame(pixels, centres_px, inverse_square_root(shape_px2))
    radius = np.sqrt(y1 * y1 + y2 * y2)
    paper = _masked_mean(pixels.grey, pixels.used & (radius > 1.22))
    dark = _masked_mean(pixels.grey, pixels.used & (radius > 0.62) & (radius < 0.82))
    contrast = np.where(np.abs(paper - dark) > 1e-6, paper - dark, 1e-6)
    coverage = (paper[:, None] - pixels.grey) / contrast[:, None]
    # The edge is two blurs wide between coverages of 16 and 84 %.
    on_edge = pixels.used & (np.abs(coverage - 0.5) < 0.34) & (radius > 0.78) & (radius < 1.3)
    # The number of pixels on the edge is its length times its width times the sampled share.
    trace = shape_px2[:, 0, 0] + shape_px2[:, 1, 1]
    length = np.pi * np.sqrt(0.5 * trace + np.sqrt(np.linalg.det(shape_px2)))
    blur = float(quick_median(on_edge.sum(axis=1) / (2 * length * sampled_share)))
    zero = np.zeros(count)
    hole = zero
    if hole_ratio > 0:
        in_hole = pixels.used & (radius < 0.8 * hole_ratio)
        hole = np.clip(1.0 - _masked_mean(coverage, in_hole), 0.0, 1.0) * np.any(in_hole, axis=1)
    return Ellipses(
        centres_px=centres_px,
        shape_px2=shape_px2,
        blur_px=np.full(count, np.clip(blur, 0.4, _LARGEST_BLUR_PX)),
        paper=paper,
        ink=np.clip(contrast / np.where(np.abs(paper) > 1e-6, paper, 1e-6), -20.0, 20.0),
        hole=hole,
        hole_sigma=zero,
        slope=np.zeros((count, 2)),
        covariance_px2=np.zeros((count, 2, 2)),
        residual_sigma=zero,
        inlier_share=zero,
    )


def refine_ellipses(
    pixels: EllipsePixels,
    start: Ellipses,
    *,
    hole_ratio: float,
    slope_sigma: Float[np.ndarray, "n"] | None,
    noise_sigma: float,
    outlier_shares: tuple[float, ...],
    tuning: CalibTuning,
) -> Ellipses:
    """Refine ellipses by Gauss-Newton steps, one step per entry of `outlier_shares`.

    Parameters
    ----------
    pixels : pixels around the ellipses.
    start : (n,) initial ellipses.
    hole_ratio : inner radius of the rings divided by the outer radius; 0 excludes holes from the
        model.
    slope_sigma : (n,) prior standard deviation of the slope of the light; the prior mean is
        `start.slope`. The slope is estimated and the holes are fixed. If None, the holes are
        estimated and the slope is fixed.
    noise_sigma : standard deviation of the image noise, grey levels.
    outlier_shares : largest residual of an inlier in each step, as a fraction of the contrast
        between paper and ink. This limit increases with the noise (4.5 sigma) and with the typical
        misfit of the image.
    tuning : tuned constants of calibration.

    Returns
    -------
    Ellipses with covariances for independent noise.
    """
    free_slope = slope_sigma is not None
    free_hole = hole_ratio > 0 and not free_slope
    state = start
    for share in outlier_shares:
        frame = inverse_square_root(state.shape_px2)
        jacobian, residual = _linearise(pixels, state, frame, hole_ratio, free_hole, free_slope)
        inliers = _select_inliers(pixels, residual, state, share, noise_sigma, tuning)
        weighted = jacobian * inliers[:, None, :]
        normal = (weighted @ np.swapaxes(jacobian, 1, 2)).astype(float)
        right = (weighted @ residual[:, :, None])[:, :, 0].astype(float)
        variance = _masked_mean(residual**2, inliers) + 1e-12
        _add_priors(normal, right, state, start, variance, slope_sigma, tuning)
        change = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        change = np.where(np.isfinite(change), change, 0.0)
        state = _step_ellipses(state, frame, change, free_hole, free_slope)
    # Near convergence a linear update of the residual is sufficient for the last step.
    residual = residual - (change.astype(np.float32)[:, None, :] @ jacobian)[:, 0]
    inliers = _select_inliers(pixels, residual, state, outlier_shares[-1], noise_sigma, tuning)
    return _with_covariance(state, normal, pixels, residual, inliers, noise_sigma, free_hole)


def _linearise(
    pixels: EllipsePixels,
    state: Ellipses,
    frame: Float[np.ndarray, "n 2 2"],
    hole_ratio: float,
    free_hole: bool,
    free_slope: bool,
) -> tuple[Float[np.ndarray, "n k p"], Float[np.ndarray, "n p"]]:
    """Jacobian of the model, (n, k, p), and residuals of the pixels, (n, p), in 32 bit.

    A residual is the observed minus the predicted grey level.

    frame : (n, 2, 2) S^(-1/2) of each shape matrix.
    free_hole, free_slope : True if the hole, or the slope of the light, is estimated.
    """
    y1, y2 = _to_circle_frame(pixels, state.centres_px, frame)
    radius = np.sqrt(y1 * y1 + y2 * y2)
    np.maximum(radius, np.float32(0.05), out=radius)
    w11, w12, w22 = (_column(frame[:, i, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    # Gradient of the relative radius per pixel, and from it the distance to the ellipse.
    inverse_radius = 1.0 / radius
    gx = (w11 * y1 + w12 * y2) * inverse_radius
    gy = (w12 * y1 + w22 * y2) * inverse_radius
    # The gradient vanishes at the centre, far from the edge.
    inverse_gradient = 1.0 / np.sqrt(np.maximum(gx * gx + gy * gy, np.float32(1e-6)))
    distance = (radius - 1.0) * inverse_gradient
    inverse_blur = _column(1.0 / state.blur_px)
    z = distance * inverse_blur
    coverage = normal_cdf(-z)
    light = _column(state.paper)
    if np.any(state.slope) or free_slope:
        local = state.centres_px - pixels.origin_px
        dx, dy = pixels.x - _column(local[:, 0]), pixels.y - _column(local[:, 1])
        light = light * (1.0 + _column(state.slope[:, 0]) * dx + _column(state.slope[:, 1]) * dy)
    inked = light * _column(state.ink)
    edge = inked * (np.exp(-0.5 * z * z) * (_DENSITY * inverse_blur))
    columns = _ALWAYS + free_hole + 2 * free_slope
    jacobian = np.empty((len(y1), columns, y1.shape[1]), np.float32)
    across = edge * inverse_gradient
    np.multiply(across, -gx, out=jacobian[:, 0])
    np.multiply(across, -gy, out=jacobian[:, 1])
    across *= 0.5 * inverse_radius
    np.multiply(across, y1 * y1, out=jacobian[:, 2])
    np.multiply(across, 2.0 * y1 * y2, out=jacobian[:, 3])
    np.multiply(across, y2 * y2, out=jacobian[:, 4])
    np.multiply(edge, -z, out=jacobian[:, _BLUR])
    if hole_ratio > 0:
        inner = normal_cdf((np.float32(hole_ratio) - radius) * inverse_gradient * inverse_blur)
        if free_hole:
            np.multiply(inked, inner, out=jacobian[:, _HOLE])
        coverage -= _column(state.hole) * inner
    model = light - inked * coverage
    # In a black region the level of the paper is 0, and the fit fails.
    with np.errstate(divide="ignore", invalid="ignore"):
        np.multiply(model, _column(1.0 / state.paper), out=jacobian[:, _PAPER])
    np.multiply(light, -coverage, out=jacobian[:, _INK])
    if free_slope:
        np.multiply(model, dx, out=jacobian[:, -2])
        np.multiply(model, dy, out=jacobian[:, -1])
    return jacobian, pixels.grey - model


def _select_inliers(
    pixels: EllipsePixels,
    residual: Float[np.ndarray, "n p"],
    state: Ellipses,
    share: float,
    noise_sigma: float,
    tuning: CalibTuning,
) -> Bool[np.ndarray, "n p"]:
    """Mask of the inlier pixels.

    The residual of an inlier can be explained by noise and by the typical misfit of the image.

    share : an inlier's residual may always be this large, as a fraction of the contrast between
        paper and ink.
    """
    contrast = np.abs(state.paper * state.ink) + 1e-12
    relative = np.abs(residual) * _column(1.0 / contrast)
    is_moderate = pixels.used & (relative < tuning.detection.largest_misfit)
    # Sharpening in the camera causes residuals at all circles.
    typical = float(quick_median(np.sqrt(_masked_mean(relative**2, is_moderate))))
    noise = 4.5 * noise_sigma / contrast
    return pixels.used & (relative < _column(np.sqrt(noise**2 + max(share, 3.5 * typical) ** 2)))


def _add_priors(
    normal: Float[np.ndarray, "n k k"],
    right: Float[np.ndarray, "n k"],
    state: Ellipses,
    start: Ellipses,
    variance: Float[np.ndarray, "n"],
    slope_sigma: Float[np.ndarray, "n"] | None,
    tuning: CalibTuning,
) -> None:
    """Add priors to the normal equations, in place.

    The prior means are the median blur of all circles and the slope of the light in `start`. A
    small ridge is added for all parameters.

    normal, right : normal matrices and right-hand sides.
    variance : (n,) variance of the residuals.
    """
    diagonal = np.einsum("nkk->nk", normal)
    diagonal += 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-12
    common = quick_median(state.blur_px)
    weight = variance / (tuning.detection.blur_width * common) ** 2
    diagonal[:, _BLUR] += weight
    right[:, _BLUR] += weight * (common - state.blur_px)
    if slope_sigma is not None:
        weight = (variance / (slope_sigma**2 + 1e-12))[:, None]
        diagonal[:, _SLOPE] += weight
        right[:, _SLOPE] += weight * (start.slope - state.slope)


def _step_ellipses(
    state: Ellipses,
    frame: Float[np.ndarray, "n 2 2"],
    change: Float[np.ndarray, "n k"],
    free_hole: bool,
    free_slope: bool,
) -> Ellipses:
    """Ellipses after one step, clipped to shapes that the image of a circle can have.

    change : (n, k) step of the parameters.
    """
    limit = 0.5 * smallest_axis(state.shape_px2)[:, None]
    move = np.clip(change[:, _CENTRE], -limit, limit)
    strain = np.clip(change[:, _SHAPE], -0.4, 0.4)
    stretch = np.eye(2) + strain[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    determinant = np.linalg.det(stretch)
    stretch = np.where((determinant > 0.1)[:, None, None], stretch, np.eye(2))
    precision = frame @ stretch @ frame
    blur = state.blur_px * np.clip(1.0 + change[:, _BLUR] / state.blur_px, 0.6, 1.6)
    hole = state.hole
    if free_hole:
        hole = np.clip(hole + change[:, _HOLE], -1.0, 2.0)
    return state._replace(
        centres_px=state.centres_px + move,
        shape_px2=np.linalg.inv(precision),
        blur_px=np.clip(blur, _SMALLEST_BLUR_PX, _LARGEST_BLUR_PX),
        paper=state.paper + change[:, _PAPER],
        ink=np.clip(state.ink + change[:, _INK], -20.0, 20.0),
        hole=hole,
        slope=state.slope + change[:, _SLOPE] if free_slope else state.slope,
    )


def _with_covariance(
    state: Ellipses,
    normal: Float[np.ndarray, "n k k"],
    pixels: EllipsePixels,
    residual: Float[np.ndarray, "n p"],
    inliers: Bool[np.ndarray, "n p"],
    noise_sigma: float,
    free_hole: bool,
) -> Ellipses:
    """Copy of the fitted ellipses with covariances, residual sigma and share of inliers.

    normal : normal matrices of the last step.
    residual, inliers : residuals of the pixels after this step, and mask of the inlier pixels.
    free_hole : True if the step estimated the sizes of the white holes of rings; `hole_sigma` is
        then computed as well.
    """
    variance = _masked_mean(residual**2, inliers)
    # By chance, residuals can be smaller than the noise: it is the lower limit.
    covariance = np.linalg.inv(normal) * np.maximum(variance, noise_sigma**2)[:, None, None]
    hole_sigma = state.hole_sigma
    if free_hole:
        hole_sigma = np.sqrt(np.maximum(covariance[:, _HOLE, _HOLE], 0.0))
    return state._replace(
        covariance_px2=covariance[:, _CENTRE, _CENTRE],
        hole_sigma=hole_sigma,
        residual_sigma=np.sqrt(variance),
        inlier_share=inliers.sum(axis=1) / np.maximum(pixels.used.sum(axis=1), 1),
    )


def with_window_noise(
    fitted: Ellipses,
    pixels: EllipsePixels,
    start: Ellipses,
    *,
    hole_ratio: float,
    slope_sigma: Float[np.ndarray, "n"],
    noise_sigma: float,
    outlier_share: float,
    tuning: CalibTuning,
) -> Ellipses:
    """Copy of the ellipses with covariances of their centres for correlated noise of the pixels.

    Parameters
    ----------
    fitted : (n,) ellipses at the end of the fit.
    pixels : pixels around the ellipses.
    start, slope_sigma : prior of the slope of the light, as in `refine_ellipses`.
    hole_ratio, noise_sigma, outlier_share, tuning : as in `refine_ellipses`.

    References
    ----------
    See `trinoc.calib.detection.window_noise`.
    """
    frame = inverse_square_root(fitted.shape_px2)
    jacobian, residual = _linearise(pixels, fitted, frame, hole_ratio, False, True)
    inliers = _select_inliers(pixels, residual, fitted, outlier_share, noise_sigma, tuning)
    normal = ((jacobian * inliers[:, None]) @ np.swapaxes(jacobian, 1, 2)).astype(float)
    variance = _masked_mean(residual**2, inliers) + 1e-12
    _add_priors(normal, np.zeros(normal.shape[:2]), fitted, start, variance, slope_sigma, tuning)
    inverse = np.linalg.inv(normal)
    half = int(max(np.abs(axis[pixels.used]).max(initial=0) for axis in (pixels.x, pixels.y)))
    column, row = (
        np.where(pixels.used, axis, 0).astype(int) + half for axis in (pixels.x, pixels.y)
    )
    rows = np.swapaxes(jacobian, 1, 2)
    covariance = sandwich_covariance(
        WindowPixels(2 * half + 1, column, row, inliers),
        fitted.centres_px - pixels.origin_px + half,
        residual,
        rows,
        inverse,
        range(2),
        tuning,
    )
    # The prior of the slope has an error of its own.
    by_slope = inverse[:, _CENTRE, _SLOPE] * (variance / (slope_sigma + 1e-6))[:, None, None]
    return fitted._replace(covariance_px2=covariance + by_slope @ by_slope.mT)


def _to_circle_frame(
    pixels: EllipsePixels, centres_px: Float[np.ndarray, "n 2"], frame: Float[np.ndarray, "n 2 2"]
) -> tuple[Float[np.ndarray, "n p"], Float[np.ndarray, "n p"]]:
    """Pixel coordinates in the frame in which each ellipse is the unit circle.

    frame : (n, 2, 2) S^(-1/2) of each shape matrix.
    """
    local = centres_px - pixels.origin_px
    dx, dy = pixels.x - _column(local[:, 0]), pixels.y - _column(local[:, 1])
    w11, w12, w22 = (_column(frame[:, i, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    return w11 * dx + w12 * dy, w12 * dx + w22 * dy


def _masked_mean(values: np.ndarray, mask: np.ndarray) -> Float[np.ndarray, "n"]:
    return (values * mask).sum(axis=1, dtype=float) / np.maximum(mask.sum(axis=1), 1)
