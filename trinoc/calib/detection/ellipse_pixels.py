"""Pixels around many ellipses as padded rows with a mask, and fast 32-bit arithmetic on them."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# numerical: nodes of a table of the normal distribution function, for linear interpolation.
_REACH, _STEPS_PER_UNIT = 5.0, 256
# numerical: as above.
_NODES = np.arange(-_REACH * _STEPS_PER_UNIT, _REACH * _STEPS_PER_UNIT + 2) / _STEPS_PER_UNIT
# numerical: as above. By `math`, because SciPy's functions take a tenth of a second to import.
_VALUE = np.array([math.erfc(-node / math.sqrt(2)) / 2 for node in _NODES], np.float32)
_STEP = np.diff(_VALUE, append=_VALUE[-1:])  # numerical: as above


class EllipsePixels(NamedTuple):
    """Pixels around n circles, at most p pixels for each circle.

    Attributes
    ----------
    origin_px : (n, 2) integer reference pixel of each circle.
    x, y : (n, p) column and row of each pixel relative to `origin_px`.
    grey : (n, p) grey levels.
    used : (n, p) mask of the pixels; False for padding.
    """

    origin_px: Float[np.ndarray, "n 2"]
    x: Float[np.ndarray, "n p"]
    y: Float[np.ndarray, "n p"]
    grey: Float[np.ndarray, "n p"]
    used: Bool[np.ndarray, "n p"]


def pixels_around(
    grey: Float[np.ndarray, "h w"],
    centres_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    inner: Float[np.ndarray, "n"],
    outer: Float[np.ndarray, "n"],
    *,
    step: int = 1,
) -> EllipsePixels:
    """Pixels of the image in an elliptical ring around each ellipse.

    Parameters
    ----------
    grey : grey levels of the image.
    centres_px, shape_px2 : (n, 2), (n, 2, 2) centres and shape matrices of the ellipses.
    inner, outer : (n,) limits of the ring, in radii of the ellipse.
    step : only every `step`-th row and column is used.
    """
    height, width = grey.shape
    origin = np.rint(centres_px)
    half = outer[:, None] * np.sqrt(shape_px2[:, [0, 1], [0, 1]])
    half_x, half_y = (int(np.ceil(side / step)) * step for side in half.max(axis=0))
    step_x = np.arange(-half_x, half_x + 1, step)
    step_y = np.arange(-half_y, half_y + 1, step)
    column = origin[:, 0, None].astype(np.int32) + step_x
    row = origin[:, 1, None].astype(np.int32) + step_y
    a = np.linalg.inv(shape_px2).astype(np.float32)
    from_centre = (origin - centres_px).astype(np.float32)
    dx = (step_x.astype(np.float32) + from_centre[:, 0, None])[:, None, :]
    dy = (step_y.astype(np.float32) + from_centre[:, 1, None])[:, :, None]
    # (x - c)^T A (x - c), the squared radius in units of the ellipse's.
    radius2 = a[:, 0, 0, None, None] * dx + 2.0 * a[:, 0, 1, None, None] * dy
    radius2 *= dx
    radius2 += a[:, 1, 1, None, None] * dy * dy
    outside_x, outside_y = (column < 0) | (column >= width), (row < 0) | (row >= height)
    radius2[outside_x[:, None, :] | outside_y[:, :, None]] = np.inf
    wanted = radius2 < (outer**2).astype(np.float32)[:, None, None]
    if np.any(inner > 0):
        wanted &= radius2 >= (inner**2).astype(np.float32)[:, None, None]
    flat = np.flatnonzero(wanted)
    circle, within = np.divmod(flat, len(step_x) * len(step_y))
    row_number, column_number = np.divmod(within, len(step_x))
    count = np.bincount(circle, minlength=len(origin))
    first = np.cumsum(count) - count
    rank = np.arange(len(flat)) - first[circle]
    row_length = max(int(count.max(initial=0)), 1)
    slot = circle * row_length + rank

    def pack(values: np.ndarray) -> Float[np.ndarray, "n p"]:
        rows = np.zeros(len(origin) * row_length, dtype=np.float32)
        rows[slot] = values
        return rows.reshape(len(origin), row_length)

    return EllipsePixels(
        origin_px=origin,
        x=pack(step_x[column_number]),
        y=pack(step_y[row_number]),
        grey=pack(grey[row[circle, row_number], column[circle, column_number]]),
        used=np.arange(row_length) < count[:, None],
    )


def inverse_square_root(shape: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n 2 2"]:
    """Symmetric matrix S^(-1/2) of each shape matrix S. It maps the ellipse to the unit circle."""
    a, b, c = shape[:, 0, 0], shape[:, 0, 1], shape[:, 1, 1]
    root = np.sqrt(a * c - b * b)
    # By Cayley and Hamilton, S^(1/2) = (S + root I) / sqrt(trace + 2 root); its inverse has the
    # same denominator over its determinant.
    scale = 1.0 / (root * np.sqrt(a + c + 2.0 * root))
    return (np.stack([c + root, -b, -b, a + root], axis=1) * scale[:, None]).reshape(-1, 2, 2)


def smallest_axis(shape: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    """Smaller semi-axis of each ellipse, from its shape matrix."""
    a, b, c = shape[:, 0, 0], shape[:, 0, 1], shape[:, 1, 1]
    smallest = 0.5 * (a + c) - np.sqrt(0.25 * (a - c) ** 2 + b * b)
    return np.sqrt(np.maximum(smallest, 1e-12))


def normal_cdf(z: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Normal distribution function Phi(z) in 32 bit, by linear interpolation.

    The error is at most 2e-7.
    """
    position = np.clip(z, -_REACH, _REACH)
    position += np.float32(_REACH)
    position *= np.float32(_STEPS_PER_UNIT)
    node = position.astype(np.int32)
    position -= node
    position *= _STEP[node]
    position += _VALUE[node]
    return position


def quick_median(values: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "..."]:
    """Median along the last axis, faster than `np.median`.

    For an even number of values, the larger of the two middle values is returned.
    """
    return np.sort(values, axis=-1)[..., values.shape[-1] // 2]


def column_32(values: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 1"]:
    """Values of n circles as a 32-bit column vector, for arithmetic with (n, p) pixel arrays."""
    return values.astype(np.float32)[:, None]
