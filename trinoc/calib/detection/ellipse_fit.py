"""Ellipses fitted to the grey levels of the pixels round them.

A circle's picture is light times (1 - ink x coverage), and the coverage across its edge is the
normal distribution function of the distance to the ellipse over the blur. Fitting that to all
pixels near the edge takes everything they say about the centre: no threshold, no sampled
profile. The model is symmetric about the centre, so what it leaves out (the edge's curvature,
the lens's true spread) does not move the centre.
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
# numerical: the hole follows if it is free, the light's slope comes last if it is.
_HOLE, _SLOPE = 8, slice(-2, None)
# numerical: limits of a step. A pixel alone blurs by .29.
_SMALLEST_BLUR_PX, _LARGEST_BLUR_PX = 0.25, 12.0
# numerical: a pixel is the mean over a square of side 1, which blurs by itself.
_PIXEL_VARIANCE = 1.0 / 12.0
_DENSITY = np.float32(1.0 / np.sqrt(2.0 * np.pi))  # numerical: of the normal distribution at 0


class Ellipses(NamedTuple):
    """State and outcome of the fit.

    centres_px : (n, 2).
    shape_px2 : (n, 2, 2) S of (x - c)^T S^-1 (x - c) = 1.
    blur_px : (n,) sigma of the edge.
    paper : (n,) grey of the paper at the centre.
    ink : (n,) share of the light that ink takes away.
    hole : (n,) 1 for a ring, 0 for a disc, as fitted.
    hole_sigma : (n,).
    slope : (n, 2) relative change of the light per pixel along x and y.
    covariance_px2 : (n, 2, 2) of the centres.
    residual_sigma : (n,) rms residual of the pixels kept.
    kept : (n,) share of the pixels that the model explains.
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
    kept: Float[np.ndarray, "n"]

    def take(self, index: np.ndarray) -> "Ellipses":
        """The ellipses of an index or a mask."""
        return Ellipses(*(field[index] for field in self))

    def concatenate(self, other: "Ellipses") -> "Ellipses":
        """These ellipses, then the others."""
        return Ellipses(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def rescale(self, factor: int) -> "Ellipses":
        """Ellipses of a picture reduced by `factor`, in pixels of the picture itself."""
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
    taken_share: float,
) -> Ellipses:
    """Grey levels, blur and holes read off the pixels of given ellipses.

    hole_ratio : inner over outer radius of rings; 0 for a sheet without any.
    taken_share : the share of the pixels round the ellipses that `pixels` holds.
    """
    count = len(centres_px)
    y1, y2 = _to_circle_frame(pixels, centres_px, inverse_square_root(shape_px2))
    radius = np.sqrt(y1 * y1 + y2 * y2)
    paper = _masked_mean(pixels.grey, pixels.used & (radius > 1.22))
    dark = _masked_mean(pixels.grey, pixels.used & (radius > 0.62) & (radius < 0.82))
    contrast = np.where(np.abs(paper - dark) > 1e-6, paper - dark, 1e-6)
    coverage = (paper[:, None] - pixels.grey) / contrast[:, None]
    # Between 16 and 84 % the edge is two blurs wide.
    on_edge = pixels.used & (np.abs(coverage - 0.5) < 0.34) & (radius > 0.78) & (radius < 1.3)
    # The area of a unit-wide seam along the edge is its length; only a share is looked at.
    trace = shape_px2[:, 0, 0] + shape_px2[:, 1, 1]
    length = np.pi * np.sqrt(0.5 * trace + np.sqrt(np.linalg.det(shape_px2)))
    blur = float(quick_median(on_edge.sum(axis=1) / (2 * length * taken_share)))
    zero = np.zeros(count)
    hole = zero
    if hole_ratio > 0:
        amid = pixels.used & (radius < 0.8 * hole_ratio)
        hole = np.clip(1.0 - _masked_mean(coverage, amid), 0.0, 1.0) * np.any(amid, axis=1)
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
        kept=zero,
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
    """Gauss-Newton steps, one for each of `outlier_shares`, then the covariance.

    hole_ratio : inner over outer radius of rings; 0 leaves holes out.
    slope_sigma : (n,) how far the slope of the light may be from that of `start`, whose holes are
        kept; None fits the holes and keeps the slope.
    outlier_shares : pixels whose residual exceeds this share of the contrast, 4.5 sigma of the
        noise, and what is usual in the picture, are left out of the step.
    """
    free_slope = slope_sigma is not None
    free_hole = hole_ratio > 0 and not free_slope
    state = start
    for share in outlier_shares:
        frame = inverse_square_root(state.shape_px2)
        jacobian, residual = _linearise(pixels, state, frame, hole_ratio, free_hole, free_slope)
        kept = _keep_pixels(pixels, residual, state, share, noise_sigma, tuning)
        weighted = jacobian * kept[:, None, :]
        normal = (weighted @ np.swapaxes(jacobian, 1, 2)).astype(float)
        right = (weighted @ residual[:, :, None])[:, :, 0].astype(float)
        variance = _masked_mean(residual**2, kept) + 1e-12
        _add_priors(normal, right, state, start, variance, slope_sigma, tuning)
        change = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        change = np.where(np.isfinite(change), change, 0.0)
        state = _step_ellipses(state, frame, change, free_hole, free_slope)
    # Near the end the model is straight enough to carry the residual to the last step.
    residual = residual - (change.astype(np.float32)[:, None, :] @ jacobian)[:, 0]
    kept = _keep_pixels(pixels, residual, state, outlier_shares[-1], noise_sigma, tuning)
    return _with_covariance(state, normal, pixels, residual, kept, noise_sigma, free_hole)


def _linearise(
    pixels: EllipsePixels,
    state: Ellipses,
    frame: Float[np.ndarray, "n 2 2"],
    hole_ratio: float,
    free_hole: bool,
    free_slope: bool,
) -> tuple[Float[np.ndarray, "n k p"], Float[np.ndarray, "n p"]]:
    """Jacobian of the model, and observed minus predicted grey, in 32 bit."""
    y1, y2 = _to_circle_frame(pixels, state.centres_px, frame)
    radius = np.sqrt(y1 * y1 + y2 * y2)
    np.maximum(radius, np.float32(0.05), out=radius)
    w11, w12, w22 = (_column(frame[:, i, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    # Gradient of the radius in pixels, and the distance to the ellipse it makes.
    inverse_radius = 1.0 / radius
    gx = (w11 * y1 + w12 * y2) * inverse_radius
    gy = (w12 * y1 + w22 * y2) * inverse_radius
    # At the very centre there is no gradient, and no edge that would need one.
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
    # Where all is black there is no paper, and the fit comes to nothing.
    with np.errstate(divide="ignore", invalid="ignore"):
        np.multiply(model, _column(1.0 / state.paper), out=jacobian[:, _PAPER])
    np.multiply(light, -coverage, out=jacobian[:, _INK])
    if free_slope:
        np.multiply(model, dx, out=jacobian[:, -2])
        np.multiply(model, dy, out=jacobian[:, -1])
    return jacobian, pixels.grey - model


def _keep_pixels(
    pixels: EllipsePixels,
    residual: Float[np.ndarray, "n p"],
    state: Ellipses,
    share: float,
    noise_sigma: float,
    tuning: CalibTuning,
) -> Bool[np.ndarray, "n p"]:
    """Pixels whose residual is no larger than noise and the sheet's usual misfit explain."""
    contrast = np.abs(state.paper * state.ink) + 1e-12
    relative = np.abs(residual) * _column(1.0 / contrast)
    near = pixels.used & (relative < tuning.detection.largest_misfit)
    # Sharpening in the camera and the like leave residuals no single circle is to blame for.
    usual = float(quick_median(np.sqrt(_masked_mean(relative**2, near))))
    noise = 4.5 * noise_sigma / contrast
    return pixels.used & (relative < _column(np.sqrt(noise**2 + max(share, 3.5 * usual) ** 2)))


def _add_priors(
    normal: Float[np.ndarray, "n k k"],
    right: Float[np.ndarray, "n k"],
    state: Ellipses,
    start: Ellipses,
    variance: Float[np.ndarray, "n"],
    slope_sigma: Float[np.ndarray, "n"] | None,
    tuning: CalibTuning,
) -> None:
    """Draw each blur to the sheet's and each slope to the start's; keep the equations regular."""
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
    """The ellipses after a step that is kept from leaving what a circle can be."""
    limit = 0.5 * smallest_axis(state.shape_px2)[:, None]
    move = np.clip(change[:, _CENTRE], -limit, limit)
    bend = np.clip(change[:, _SHAPE], -0.4, 0.4)
    stretch = np.eye(2) + bend[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
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
    kept: Bool[np.ndarray, "n p"],
    noise_sigma: float,
    free_hole: bool,
) -> Ellipses:
    variance = _masked_mean(residual**2, kept)
    # Pixels that agree by luck do not make a circle surer than the picture's noise allows.
    covariance = np.linalg.inv(normal) * np.maximum(variance, noise_sigma**2)[:, None, None]
    hole_sigma = state.hole_sigma
    if free_hole:
        hole_sigma = np.sqrt(np.maximum(covariance[:, _HOLE, _HOLE], 0.0))
    return state._replace(
        covariance_px2=covariance[:, _CENTRE, _CENTRE],
        hole_sigma=hole_sigma,
        residual_sigma=np.sqrt(variance),
        kept=kept.sum(axis=1) / np.maximum(pixels.used.sum(axis=1), 1),
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
    """The ellipses with the covariance that the noise of their own pixels gives their centres.

    pixels : round the ellipses. start, slope_sigma : what was known of the light's slope. The rest
        is as `refine_ellipses` has it.
    """
    frame = inverse_square_root(fitted.shape_px2)
    jacobian, residual = _linearise(pixels, fitted, frame, hole_ratio, False, True)
    kept = _keep_pixels(pixels, residual, fitted, outlier_share, noise_sigma, tuning)
    normal = ((jacobian * kept[:, None]) @ np.swapaxes(jacobian, 1, 2)).astype(float)
    variance = _masked_mean(residual**2, kept) + 1e-12
    _add_priors(normal, np.zeros(normal.shape[:2]), fitted, start, variance, slope_sigma, tuning)
    inverse = np.linalg.inv(normal)
    half = int(max(np.abs(each[pixels.used]).max(initial=0) for each in (pixels.x, pixels.y)))
    column, row = (
        np.where(pixels.used, each, 0).astype(int) + half for each in (pixels.x, pixels.y)
    )
    rows = np.swapaxes(jacobian, 1, 2)
    covariance = sandwich_covariance(
        WindowPixels(2 * half + 1, column, row, kept),
        fitted.centres_px - pixels.origin_px + half,
        residual,
        rows,
        inverse,
        range(2),
        tuning,
    )
    # What was known of the slope is off by its sigma.
    by_slope = inverse[:, _CENTRE, _SLOPE] * (variance / (slope_sigma + 1e-6))[:, None, None]
    return fitted._replace(covariance_px2=covariance + by_slope @ by_slope.mT)


def _to_circle_frame(
    pixels: EllipsePixels, centres_px: Float[np.ndarray, "n 2"], frame: Float[np.ndarray, "n 2 2"]
) -> tuple[Float[np.ndarray, "n p"], Float[np.ndarray, "n p"]]:
    """Pixels in the frame in which the ellipse is the unit circle."""
    local = centres_px - pixels.origin_px
    dx, dy = pixels.x - _column(local[:, 0]), pixels.y - _column(local[:, 1])
    w11, w12, w22 = (_column(frame[:, i, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    return w11 * dx + w12 * dy, w12 * dx + w22 * dy


def _masked_mean(values: np.ndarray, mask: np.ndarray) -> Float[np.ndarray, "n"]:
    return (values * mask).sum(axis=1, dtype=float) / np.maximum(mask.sum(axis=1), 1)
