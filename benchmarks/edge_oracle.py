"""The best that a detector can do: a blurred step fitted to the picture at the true edge.

The fit is told everything but four numbers: where the edge is, how blurred it is and what noise
there is. It finds the place across, the turn, and the two grey levels with their slopes. What
error is left is the noise's, the pixels' and the neighbours', not the detector's.
"""

import cv2
import numpy as np
from scipy.special import ndtr

# A pixel belongs to one edge alone where no other edge or rim is so near and no shadow's edge is.
ALONE_PX, SHADOW_SLOPE = 4, 1.0
# Pixels this far to both sides take part; those near the ends of the edge do not.
BESIDE_PX, END_PX, LEAST_LENGTH_PX = 4.0, 2.0, 6.0
_PIXEL_VARIANCE = 1 / 12
_ROUNDS = 8
# A fit that wanders farther has lost the edge; it counts with this error.
LOST_PX = 1.5


def fitted_across(
    grey: np.ndarray, edge: np.ndarray, blur_px: float, undisturbed: np.ndarray
) -> np.ndarray | None:
    """Error across the edge x1 y1 x2 y2 at every half pixel of its length, in px.

    Only pixels that are `undisturbed` take part. None for an edge of which too few are, and for
    one that is too short or too near the border. Least squares by Gauss and
    Newton; the pixels' box widens the blur by its variance.
    """
    first, second = edge[:2], edge[2:4]
    length = float(np.hypot(*(second - first)))
    if length < LEAST_LENGTH_PX:
        return None
    unit = (second - first) / length
    low = np.floor(np.minimum(first, second) - BESIDE_PX).astype(int)
    high = np.ceil(np.maximum(first, second) + BESIDE_PX).astype(int)
    height, width = grey.shape
    if (low < 0).any() or high[0] >= width or high[1] >= height:
        return None
    v, u = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    along = ((u - first[0]) * unit[0] + (v - first[1]) * unit[1]).ravel()
    across = ((v - first[1]) * unit[0] - (u - first[0]) * unit[1]).ravel()
    near = (along > END_PX) & (along < length - END_PX) & (np.abs(across) < BESIDE_PX)
    near &= undisturbed[v.ravel(), u.ravel()]
    along, across = along[near] - length / 2, across[near]
    level = grey[v.ravel()[near], u.ravel()[near]].astype(float)
    if len(level) < 40 or np.ptp(along) < length / 2:
        return None
    sigma = np.sqrt(blur_px**2 + _PIXEL_VARIANCE)
    offset, turn = 0.0, 0.0
    for _ in range(_ROUNDS):
        d = (across - offset - turn * along) / sigma
        step = ndtr(d)
        linear = np.stack([np.ones_like(d), along, across, step, step * along], axis=-1)
        height_of, *_ = np.linalg.lstsq(linear, level, rcond=None)
        slope = -height_of[3] * np.exp(-0.5 * d * d) / (np.sqrt(2 * np.pi) * sigma)
        whole = np.column_stack([linear, slope, slope * along])
        change, *_ = np.linalg.lstsq(whole, level - linear @ height_of, rcond=1e-9)
        offset, turn = offset + change[5], turn + change[6]
        if not abs(offset) + abs(turn) * length / 2 < LOST_PX:
            break
    places = np.arange(0.25, length, 0.5) - length / 2
    error = np.nan_to_num(np.abs(offset + turn * places), nan=LOST_PX)
    return np.minimum(error, LOST_PX)


def undisturbed_pixels(others: np.ndarray, shadow_slope: np.ndarray) -> np.ndarray:
    """Pixels far from all `others`, rows x1 y1 x2 y2, and from the edges of shadows."""
    near = (shadow_slope >= SHADOW_SLOPE).astype(np.uint8)
    for x1, y1, x2, y2 in np.rint(16 * others).astype(int):
        cv2.line(near, (x1, y1), (x2, y2), 1, 2 * ALONE_PX + 1, cv2.LINE_8, 4)
    return near == 0
