"""Noise on a slope of grey levels looks like short edges: which lines are only that."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.numerics import sums
from trinoc.segments.nevatia_babu.edge_points import EdgePoints

# Beside an edge the grey levels are compared from here, in widths of its profile, to so many
# pixels farther out.
_FROM_WIDTHS, _FURTHER_PX = 1.5, 3.0
# Beside an edge the grey levels are flat; in a soft shadow they slope on both sides.
_MOST_SLOPE = 0.25
_BOX = (3, 3)


def is_on_ramp(
    grey: Float[np.ndarray, "h w"],
    points: EdgePoints,
    first: Int[np.ndarray, "r"],
    usual_blur_px2: float,
) -> Bool[np.ndarray, "r"]:
    """Lines whose slope goes on beyond both sides, by `_MOST_SLOPE` of what it is on the line.

    Both sides must show it: another edge beside an edge of the scene makes one side steep.
    """
    smooth = cv2.blur(grey, _BOX, borderType=cv2.BORDER_REPLICATE)
    near = np.float32(_FROM_WIDTHS) * np.sqrt(
        points.kernel_variance_px2 + np.float32(usual_blur_px2)
    )
    sides = [
        sums(
            _level(smooth, points, sign * (near + np.float32(_FURTHER_PX)))
            - _level(smooth, points, sign * near),
            first,
        )
        for sign in (-1, 1)
    ]
    slope = np.minimum(-sides[0], sides[1]) / _FURTHER_PX
    return slope > _MOST_SLOPE * sums(points.strength, first)


def _level(
    grey: Float[np.ndarray, "h w"], points: EdgePoints, across_px: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Grey level so far from each point across its edge, toward the brighter side."""
    height, width = grey.shape
    column = np.rint(points.uv_px[:, 0] + across_px * points.normal[:, 0]).astype(np.int64)
    row = np.rint(points.uv_px[:, 1] + across_px * points.normal[:, 1]).astype(np.int64)
    return grey.ravel()[np.clip(row, 0, height - 1) * width + np.clip(column, 0, width - 1)]
