"""Subpixel fit of chessboard corners to the grey levels around them.

Two edges with unit normals n1 and n2 cross at the corner c. Gaussian blur of the ink (-1 dark, 1
light) gives the profile

    P(x) = E[sign(z1 + e1) sign(z2 + e2)],    z = n.(x - c) / blur,    E[e1 e2] = n1.n2,

with standard normal e1 and e2. The model of the image is (m + d P + q P^2)(1 + g.x). Here m is the
mean level, d the contrast, q the curvature of the camera's response, g the slope of the light. All
terms except g are
symmetric about the corner. Errors of the model of blur and response (sharpening, saturation) are
symmetric as well and do not move the corner.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection.ellipse_pixels import column_32 as _column, normal_cdf
from trinoc.calib.detection.search_image import SearchImage
from trinoc.calib.detection.window_noise import WindowPixels, sandwich_covariance
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.numerics.small_least_squares import Residuals, gauss_newton

# numerical: parameters of a corner, in the order of the Jacobian's columns.
_CORNER, _ANGLES, _LOG_BLUR, _MEAN, _CONTRAST, _CURVATURE, _SLOPE = (
    slice(0, 2), slice(2, 4), 4, 5, 6, 7, slice(8, 10)
)  # fmt: skip
# numerical: number of parameters, and those whose derivative is odd about the corner.
_PARAMETERS, _ODD = 10, (0, 1, 8, 9)
# numerical: number of steps, after which the fit has converged; initial value and prior standard
# deviation of the logarithm of the blur in px; largest step of each parameter.
_STEPS, _START, _WIDTH = 5, -0.3, 1.0
_LARGEST_STEP = np.array([1.0, 1.0, 0.2, 0.2, 0.4, *[np.inf] * 5])  # numerical: as above
_DENSITY = np.float32(1.0 / np.sqrt(2.0 * np.pi))  # numerical: of the normal distribution at 0


class FittedCorners(NamedTuple):
    """Fitted corner positions, with covariances.

    Attributes
    ----------
    corners_px : (n, 2) positions.
    covariance_px2 : (n, 2, 2) covariances of the positions.
    """

    corners_px: Float[np.ndarray, "n 2"]
    covariance_px2: Float[np.ndarray, "n 2 2"]


class _Windows(NamedTuple):
    """Square windows of k pixels around n corners, pixels row by row.

    Attributes
    ----------
    side : side of a window in pixels.
    origin_px : (n, 2) centre pixel of each window, which is the pixel nearest to the corner.
    x, y : (k,) column and row of each pixel relative to the centre pixel.
    grey : (n, k) grey levels.
    used : (n, k) mask of the pixels that are inside the image and within the radius of the corner.
    """

    side: int
    origin_px: Float[np.ndarray, "n 2"]
    x: Float[np.ndarray, "k"]
    y: Float[np.ndarray, "k"]
    grey: Float[np.ndarray, "n k"]
    used: Bool[np.ndarray, "n k"]

    @property
    def pixels(self) -> WindowPixels:
        """Pixel positions relative to the first pixel of each window, for `sandwich_covariance`."""
        row, column = np.indices((self.side, self.side)).reshape(2, 1, -1)
        shape = self.used.shape
        return WindowPixels(
            self.side, np.broadcast_to(column, shape), np.broadcast_to(row, shape), self.used
        )


def fit_corners(
    image: SearchImage,
    start_px: Float[np.ndarray, "n 2"],
    radius_px: Float[np.ndarray, "n"],
    tuning: CalibTuning,
) -> FittedCorners:
    """Fit each corner of crossing edges to the grey levels within a radius.

    Parameters
    ----------
    image : grey image with its noise.
    start_px : (n, 2) approximate corner positions.
    radius_px : (n,) radius of the region of pixels that each fit uses.
    tuning : tuned constants of calibration.

    Returns
    -------
    Positions and covariances. If a fit fails, the result is the approximate position with a
    standard deviation of `radius_px`.
    """
    windows = _cut_windows(image, start_px, radius_px)
    noise = max(image.noise_sigma, 1e-3 * float(np.ptp(windows.grey)), 1e-9)

    # 32 bit like the pixels, which avoids a conversion of the derivatives.
    weight = windows.used.astype(np.float32)
    residual = jacobian = np.zeros(0, np.float32)

    def residuals(state: Float[np.ndarray, "n p"]) -> Residuals:
        nonlocal residual, jacobian
        model, by_parameter = _predict(windows, state)
        residual = (model - windows.grey) / noise
        jacobian = np.divide(by_parameter, noise, order="C")
        prior_deviation = np.zeros((len(state), _PARAMETERS))
        prior_deviation[:, _LOG_BLUR] = state[:, _LOG_BLUR] - _START
        precision = np.zeros_like(prior_deviation)
        precision[:, _LOG_BLUR] = 1 / _WIDTH**2
        return Residuals(
            residual[..., None], jacobian[:, :, None], weight, prior_deviation, precision
        )

    state, equations = gauss_newton(
        residuals,
        lambda state, step: state + step,
        _start_corners(windows, start_px, radius_px),
        steps=_STEPS,
        largest_step=_LARGEST_STEP,
    )
    corners_px = windows.origin_px + state[:, _CORNER]
    succeeded = np.linalg.norm(corners_px - start_px, axis=1) < 0.5 * radius_px
    white_covariance = equations.covariance()
    succeeded &= np.isfinite(white_covariance).all(axis=(1, 2))
    white_covariance[~succeeded] = np.eye(_PARAMETERS)
    # `residual` and `jacobian` belong to the final state.
    covariance_px2 = sandwich_covariance(
        windows.pixels,
        state[:, _CORNER] + windows.side // 2,
        residual,
        jacobian,
        white_covariance,
        _ODD,
        tuning,
    )
    covariance_px2[~succeeded] = radius_px[~succeeded, None, None] ** 2 * np.eye(2)
    return FittedCorners(np.where(succeeded[:, None], corners_px, start_px), covariance_px2)


def _cut_windows(
    image: SearchImage, centres_px: Float[np.ndarray, "n 2"], radius_px: Float[np.ndarray, "n"]
) -> _Windows:
    half, (width, height) = int(np.ceil(radius_px.max())), image.size_px
    reach = np.arange(-half, half + 1)
    y, x = (part.ravel() for part in np.meshgrid(reach, reach, indexing="ij"))
    origin = np.rint(centres_px)
    column, row = (origin.astype(int).T[:, :, None] + np.stack([x, y])[:, None]).astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    grey = image.grey[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    relative = np.stack([column, row], axis=-1) - centres_px[:, None]
    used = inside & (np.sum(relative**2, axis=-1) <= radius_px[:, None] ** 2)
    dtype = np.float32
    return _Windows(
        2 * half + 1, origin, x.astype(dtype), y.astype(dtype), grey.astype(dtype), used
    )


def _start_corners(
    windows: _Windows, start_px: Float[np.ndarray, "n 2"], radius_px: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n p"]:
    """Initial parameters of each corner, from a quadratic saddle surface fitted to the grey levels.

    The edges lie along the directions of zero curvature of the saddle.
    """
    state = np.zeros((len(start_px), _PARAMETERS))
    state[:, _CORNER], state[:, _LOG_BLUR] = start_px - windows.origin_px, _START
    u, v = (
        axis - _column(corner) for axis, corner in zip((windows.x, windows.y), state[:, _CORNER].T)
    )
    weight = windows.used * np.exp(-2.0 * (u * u + v * v) / _column(radius_px) ** 2)
    terms = np.stack([np.ones_like(u), u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=-1)
    weighted = (weight[..., None] * terms).mT
    saddle = np.linalg.solve(
        (weighted @ terms).astype(float) + 1e-6 * np.eye(6),
        (weighted @ windows.grey[..., None]).astype(float),
    )[..., 0]
    curvature = saddle[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
    values, vectors = np.linalg.eigh(curvature)
    root = np.sqrt(np.maximum(values * [-1, 1], 1e-9 * np.abs(values).max(axis=1, keepdims=True)))
    for k, sign in enumerate((1, -1)):
        # The saddle is level along e; the normal of e is (-e_v, e_u).
        e = root[:, 1, None] * vectors[:, :, 0] + sign * root[:, 0, None] * vectors[:, :, 1]
        state[:, 2 + k] = np.arctan2(e[:, 0], -e[:, 1])
    state[:, _CONTRAST] = 1.0
    product = _predict(windows, state)[0] * windows.used
    count = windows.used.sum(axis=1)
    state[:, _MEAN] = (windows.grey * windows.used).sum(axis=1) / count
    # Regression of the grey levels on the profile.
    spread = product - windows.used * _column(product.sum(axis=1) / count)
    state[:, _CONTRAST] = (spread * windows.grey).sum(axis=1) / np.maximum(
        (spread**2).sum(axis=1), 1e-9
    )
    return state


def _predict(
    windows: _Windows, state: Float[np.ndarray, "n p"]
) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, "n k p"]]:
    """Predicted grey levels of the pixels, (n, k), and their derivatives, (n, k, p), in 32 bit.

    The derivatives are with respect to the p parameters of a corner. Those with respect to one
    parameter are contiguous in memory, for speed.
    """
    u, v = (
        axis - _column(corner) for axis, corner in zip((windows.x, windows.y), state[:, _CORNER].T)
    )
    inverse_blur = _column(np.exp(-state[:, _LOG_BLUR]))
    cosine, sine = (f(state[:, _ANGLES]).astype(np.float32).T[..., None] for f in (np.cos, np.sin))
    z = _rotate(cosine, u, sine, v)
    z *= inverse_blur
    along = _rotate(cosine, v, -sine, u)
    along *= inverse_blur
    side = normal_cdf(z)
    side *= 2
    side -= 1
    density = -0.5 * z
    density *= z
    np.exp(density, out=density)
    density *= 2 * _DENSITY
    # Terms of first and second degree in the correlation n1.n2 of both errors.
    correlation = cosine[0] * cosine[1] + sine[0] * sine[1]
    both = correlation * density[0]
    both *= density[1]
    second_order = 0.5 * correlation * z[0]
    second_order *= z[1]
    second_order += 1
    product = side[0] * side[1]
    product += both * second_order
    by_z = 0.5 * correlation * z[::-1]
    by_z -= z * second_order
    by_z *= both
    density *= side[::-1]
    by_z += density
    mean, contrast, curvature = (_column(state[:, k]) for k in (_MEAN, _CONTRAST, _CURVATURE))
    slope = state[:, _SLOPE].astype(np.float32)
    light = slope[:, :1] * windows.x
    light += 1
    light += slope[:, 1:] * windows.y
    level = product * curvature
    level += contrast
    level *= product
    level += mean
    by_product = 2 * curvature * product
    by_product += contrast
    by_product *= light
    by_z *= by_product
    jacobian = np.empty((len(state), _PARAMETERS, u.shape[1]), np.float32)
    np.multiply(_rotate(cosine[0], by_z[0], cosine[1], by_z[1]), -inverse_blur, out=jacobian[:, 0])
    np.multiply(_rotate(sine[0], by_z[0], sine[1], by_z[1]), -inverse_blur, out=jacobian[:, 1])
    np.multiply(by_z, along, out=np.moveaxis(jacobian[:, _ANGLES], 1, 0))
    by_z *= z
    np.negative(by_z[0] + by_z[1], out=jacobian[:, _LOG_BLUR])
    jacobian[:, _MEAN] = light
    np.multiply(light, product, out=jacobian[:, _CONTRAST])
    product *= product
    np.multiply(light, product, out=jacobian[:, _CURVATURE])
    np.multiply(level, windows.x, out=jacobian[:, 8])
    np.multiply(level, windows.y, out=jacobian[:, 9])
    level *= light
    return level, jacobian.mT


def _rotate(
    cosine: Float[np.ndarray, "*a 1"],
    u: Float[np.ndarray, "n k"],
    sine: Float[np.ndarray, "*a 1"],
    v: Float[np.ndarray, "n k"],
) -> Float[np.ndarray, "*a k"]:
    """Return cosine * u + sine * v, computed with one temporary array."""
    total = cosine * u
    total += sine * v
    return total
