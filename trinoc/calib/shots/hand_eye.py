"""Two cameras that each see a board of their own: how both pairs are fixed, from their motions.

What one camera sees of its board in a shot is T, what the other sees of the other board is U. With
the cameras fixed to each other by X and the boards by Y, U = X T Y in every shot.
Source: F. Dornaika and R. Horaud, "Simultaneous robot-world and hand-eye calibration", IEEE
Transactions on Robotics and Automation 14(4), 1998; rotations as F. Park and B. Martin, "Robot
sensor calibration: solving AX = XB on the Euclidean group", ibid. 10(5), 1994.
"""

from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.motions import chained, inverse

FEWEST_SHOTS = 3
# Turns about one axis alone leave how far the cameras lie along it open: those about others have
# this share of them at least.
_LEAST_SHARE = 0.05


class HandEye(NamedTuple):
    """`second` = cameras . `first` . boards, for every shot's pair of poses (3, 4)."""

    cameras: Float[np.ndarray, "3 4"]
    boards: Float[np.ndarray, "3 4"]


def hand_eye(
    first: Float[np.ndarray, "s 3 4"], second: Float[np.ndarray, "s 3 4"]
) -> HandEye | None:
    """The motions that explain all pairs best; None where they leave something open."""
    pairs = list(combinations(range(len(first)), 2))
    if len(first) < FEWEST_SHOTS:
        return None
    before = [chained(first[t], inverse(first[s])) for s, t in pairs]
    after = [chained(second[t], inverse(second[s])) for s, t in pairs]
    axes = np.stack([_rotation_vector(motion) for motion in before])
    turned = np.stack([_rotation_vector(motion) for motion in after])
    spread = np.linalg.svd(axes, compute_uv=False)
    if not spread[1] > _LEAST_SHARE * spread[0]:
        return None
    rotation = _nearest_rotation(turned.T @ axes)
    rows = np.concatenate([motion[:, :3] - np.eye(3) for motion in after])
    right = [rotation @ one[:, 3] - two[:, 3] for one, two in zip(before, after, strict=True)]
    shift, *_ = np.linalg.lstsq(rows, np.concatenate(right), rcond=None)
    cameras = np.column_stack([rotation, shift])
    own = [
        chained(inverse(chained(cameras, one)), two) for one, two in zip(first, second, strict=True)
    ]
    mean = np.mean(own, axis=0)
    return HandEye(cameras, np.column_stack([_nearest_rotation(mean[:, :3]), mean[:, 3]]))


def _rotation_vector(motion: Float[np.ndarray, "3 4"]) -> Float[np.ndarray, "3"]:
    return cv2.Rodrigues(motion[:, :3])[0].ravel()


def _nearest_rotation(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    u, _, v = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
