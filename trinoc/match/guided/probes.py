"""Probes: pieces of known lines in pictures, along which an edge is asked for.

A probe is sampled at STEPS places along, in the same number whatever its length, and at OFFSETS
across. Two places make a block.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.geometry import Intrinsics, distort_pixels

STEPS = 64
BLOCKS = STEPS // 2
# The least distance of two places, px: nearer ones would see the same noise.
STEP_PX = 2.0
# Pixels next to the border of a picture are half made up by filters.
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


def step_of(ends_px: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    """Distance of two places along each probe, px."""
    length = np.linalg.norm(ends_px[:, 1] - ends_px[:, 0], axis=1)
    return np.maximum(length / STEPS, STEP_PX)


def samples_of(
    ends_px: Float[np.ndarray, "n 2 2"], lens: Intrinsics, size_px: tuple[int, int]
) -> Samples:
    """Places along probes given by their undistorted ends."""
    way = ends_px[:, 1] - ends_px[:, 0]
    length = np.linalg.norm(way, axis=1)
    unit = way / np.maximum(length, 1e-9)[:, None]
    at = (np.arange(STEPS) + 0.5) * step_of(ends_px)[:, None]
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
