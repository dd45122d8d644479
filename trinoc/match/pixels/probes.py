"""Probes: pieces of known lines in pictures, along which an edge is asked for.

A probe is sampled at STEPS places along, in the same number whatever its length, and at OFFSETS
across. Two places make a block.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped

from trinoc.geometry.intrinsics import Intrinsics, distort_pixels
from trinoc.image.light import Light
from trinoc.image.strip import interpolate_levels
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.tails import MAD_TO_SIGMA

# numerical: half the kernel, in px, four standard deviations.
_HALF = 5


class PictureGradient(NamedTuple):
    """Fields
    ------
    by_uv : (2, h, w) derivative along u and along v, grey levels per px.
    noise : standard deviation of either, between pixels, from white noise in the picture.
    """

    by_uv: Float[np.ndarray, "2 h w"]
    noise: float


def picture_gradient(picture: Shaped[np.ndarray, "..."]) -> PictureGradient:
    """Gaussian derivatives of the grey levels, in 255ths of full white.

    Raises InputError for what is no picture.
    """
    light = Light.from_picture(picture)
    smooth, slope = _kernels()
    border = cv2.BORDER_REPLICATE
    along_u = cv2.sepFilter2D(light.light, cv2.CV_32F, slope, smooth, borderType=border)
    along_v = cv2.sepFilter2D(light.light, cv2.CV_32F, smooth, slope, borderType=border)
    gain = np.sqrt(
        (smooth**2).sum()
        * (slope**2).sum()
        * _interpolated_variance(smooth)
        * _interpolated_variance(slope)
    )
    # A quarter of the pixels tell it to a percent.
    noise = light.noise_sigma(stride=(2, 2))
    return PictureGradient(np.stack([along_u, along_v]), float(noise * gain))


def _interpolated_variance(kernel: np.ndarray) -> float:
    """What interpolation leaves of the variance, on the mean of all places between pixels."""
    shared = (kernel[1:] * kernel[:-1]).sum() / (kernel**2).sum()
    return float((2 + shared) / 3)


def _kernels() -> tuple[np.ndarray, np.ndarray]:
    """(smoothing, derivative), for correlation; a ramp of one level per px answers with one."""
    at = np.arange(-_HALF, _HALF + 1)
    smooth = np.exp(-0.5 * (at / DEFAULT.guided.smoothing_px) ** 2)
    smooth /= smooth.sum()
    slope = at * smooth
    return smooth, slope / (slope * at).sum()


# numerical: places along a probe.
STEPS = 64
# numerical: blocks of a probe.
BLOCKS = STEPS // 2
# numerical: the least distance of two places, px: nearer ones would see the same noise.
STEP_PX = 2.0
# numerical: pixels next to the border of a picture are half made up by filters.
_BORDER_PX = 4.0


class Samples(NamedTuple):
    """Fields
    ------
    uv_px : (n, s, 2) places along each probe, in pixels of the picture, single precision.
    normal : (n, s, 2) unit normals there, on the right of the way.
    inside : (n, s) whether a place is on its probe and in the picture.
    """

    uv_px: Float[np.ndarray, "n s 2"]
    normal: Float[np.ndarray, "n s 2"]
    inside: Bool[np.ndarray, "n s"]


def probe_steps_px(ends_px: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    """Distance of two places along each probe, px."""
    length = np.linalg.norm(ends_px[:, 1] - ends_px[:, 0], axis=1)
    return np.maximum(length / STEPS, STEP_PX)


def sample_probes(
    ends_px: Float[np.ndarray, "n 2 2"], lens: Intrinsics, size_px: tuple[int, int]
) -> Samples:
    """Places along probes given by their undistorted ends."""
    way = ends_px[:, 1] - ends_px[:, 0]
    length = np.linalg.norm(way, axis=1)
    unit = way / np.maximum(length, 1e-9)[:, None]
    at = (np.arange(STEPS) + 0.5) * probe_steps_px(ends_px)[:, None]
    uv = ends_px[:, None, 0] + at[..., None] * unit[:, None]
    right = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    normal = np.broadcast_to(right[:, None], uv.shape)
    if lens.has_distortion:
        both = distort_pixels(lens, np.stack([uv, uv + normal], axis=2).reshape(-1, 2, 2))
        both = both.reshape(*uv.shape[:2], 2, 2)
        uv, normal = both[:, :, 0], both[:, :, 1] - both[:, :, 0]
        normal = normal / np.linalg.norm(normal, axis=2, keepdims=True)
    most = np.array(size_px) - 1 - _BORDER_PX
    inside = (at < length[:, None] + 1e-6) & ((uv >= _BORDER_PX) & (uv <= most)).all(axis=2)
    return Samples(uv.astype(np.float32), normal.astype(np.float32), inside)


# numerical: half the width of the band, in px.
SHOULDER = 3
# numerical: half the width of the ridge, in px.
REACH = 2
# numerical: places across, px.
OFFSETS = np.arange(-REACH - SHOULDER, REACH + SHOULDER + 1)
# numerical: blocks of a window; one begins half a window after the other.
WINDOWS = (2, 4, 8, 16, 32)
# numerical: where windows begin.
_BEGIN = [np.arange(0, BLOCKS - size + 1, max(size // 2, 1)) for size in WINDOWS]
WINDOW_FIRST = np.concatenate(_BEGIN)
_WINDOW_KIND = np.repeat(np.arange(len(WINDOWS)), [len(begin) for begin in _BEGIN])
WINDOW_SIZE = np.array(WINDOWS)[_WINDOW_KIND]
# numerical: the last block of each window.
WINDOW_LAST = WINDOW_FIRST + WINDOW_SIZE - 1
_BLOCK = np.arange(BLOCKS)[:, None]
_IN_WINDOW = ((_BLOCK >= WINDOW_FIRST) & (_BLOCK <= WINDOW_LAST)).astype(np.float32)
# numerical: what white noise has in common in a block and the next, and the one after that.
_ONE, _TWO, _THREE = (
    np.exp(-((k * STEP_PX / DEFAULT.guided.smoothing_px) ** 2) / 4) for k in (1, 2, 3)
)
# numerical: from the three above.
NEXT = float((_ONE + 2 * _TWO + _THREE) / (2 + 2 * _ONE))
# numerical: from the three above.
SECOND = float((_THREE) / (2 + 2 * _ONE))


def block_gradients(
    by_uv: Float[np.ndarray, "2 h w"], places: Samples
) -> tuple[Float[np.ndarray, "n o b"], Float[np.ndarray, "n o b"], Bool[np.ndarray, "n b"]]:
    """(gradient across and along at OFFSETS, means of each block's two places; whether both are
    inside)."""
    by_u, by_v = (
        0.5 * (found[..., ::2] + found[..., 1::2])
        for found in (interpolate_levels(of, places.uv_px, places.normal, OFFSETS) for of in by_uv)
    )
    normal_u, normal_v = (places.normal[:, None, ::2, k] for k in (0, 1))
    known = places.inside[:, ::2] & places.inside[:, 1::2]
    return by_u * normal_u + by_v * normal_v, by_u * normal_v - by_v * normal_u, known


def ridge(across: Float[np.ndarray, "n o b"]) -> Float[np.ndarray, "n r b"]:
    """The gradient at offsets up to REACH above the mean of that on both sides."""
    inner = across[:, SHOULDER:-SHOULDER]
    return inner - 0.5 * (across[:, : -2 * SHOULDER] + across[:, 2 * SHOULDER :])


def ridge_sigma(
    height: Float[np.ndarray, "n r b"], known: Bool[np.ndarray, "n b"], least: float
) -> Float[np.ndarray, "n"]:
    """Standard deviation of one block's ridge about what is common along the probe; at least
    `least`, that of the picture's noise."""
    # Second differences: neither what is common nor what changes evenly counts, such as an edge
    # that comes nearer.
    change = np.abs(height[..., 2:] - 2 * height[..., 1:-1] + height[..., :-2])
    held = known[:, 2:] & known[:, 1:-1] & known[:, :-2]
    change[np.broadcast_to(~held[:, None], change.shape)] = np.inf
    in_order = np.sort(change.reshape(len(height), -1), axis=1)
    count = held.sum(axis=1) * height.shape[1]
    middle = np.stack([np.maximum(count - 1, 0) // 2, count // 2], axis=1)
    middle = np.take_along_axis(in_order, middle, axis=1).mean(axis=1)
    gain = MAD_TO_SIGMA / np.sqrt(6 - 8 * NEXT + 2 * SECOND)
    return np.maximum(np.where(count > 0, gain * middle, 0.0), least).astype(height.dtype)


def windows(values: Float[np.ndarray, "*l b"]) -> Float[np.ndarray, "*l x"]:
    """Sums over all windows."""
    return values @ _IN_WINDOW


def whole_windows(inside: Bool[np.ndarray, "*l b"]) -> Bool[np.ndarray, "*l x"]:
    """Whether all blocks of each window are inside."""
    return windows((~inside).astype(np.float32)) < 0.5


def window_spread(growth: Float[np.ndarray, "k"]) -> Float[np.ndarray, "x"]:
    """Standard deviation of every window's sum, in those of one block."""
    return np.sqrt(WINDOW_SIZE * growth[_WINDOW_KIND]).astype(np.float32)


def window_scores(
    by_uv: Float[np.ndarray, "2 h w"], least: float, places: Samples
) -> tuple[Float[np.ndarray, "n x"], Bool[np.ndarray, "n x"]]:
    """(sums of ridge, over sigma and the root of blocks, of every window on each probe itself;
    whether all of it is inside)."""
    across, _, known = block_gradients(by_uv, places)
    height = ridge(across)
    sigma = ridge_sigma(height, known, least)
    alone = window_spread(np.ones(len(WINDOWS)))
    return windows(height[:, REACH]) / sigma[:, None] / alone, whole_windows(known)
