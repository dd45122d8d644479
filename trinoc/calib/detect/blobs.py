"""Dark blobs that could be circles of the sheet, as ellipses from their moments."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

# The threshold lies midway between the darkest and the brightest grey of a neighbourhood of
# `reach` blocks to each side.
_BLOCK_PX = 8
_SMALLEST_AREA_PX = 8
# A blob may cover at most this share of the picture, and at least this share of its box.
_LARGEST_SHARE = 0.1
_LEAST_FILLED = 0.18
# Area over the area of the ellipse with the same second moments: 1 for a disc, (1 - k^2) /
# (1 + k^2) for a ring with a hole of k radii.
_ROUNDNESS = (0.42, 1.12)
_MOST_BLOBS = 700


class Blobs(NamedTuple):
    """Candidate circles.

    centres_px : (n, 2).
    shape_px2 : (n, 2, 2), S of the ellipse (x - c)^T S^-1 (x - c) = 1 of the outer edge.
    """

    centres_px: Float[np.ndarray, "n 2"]
    shape_px2: Float[np.ndarray, "n 2 2"]

    def __len__(self) -> int:
        return len(self.centres_px)

    def take(self, index: np.ndarray) -> "Blobs":
        """The blobs of an index or a mask."""
        return Blobs(self.centres_px[index], self.shape_px2[index])


class Scale(NamedTuple):
    """How one search looks at the picture.

    smoothing_px : sigma of the Gaussian applied first.
    reach_blocks : neighbourhood of the threshold, in blocks to each side.
    opening_px : side of an opening that cuts thin dark lines off the blobs; 0 for none.
    closing_px : side of a closing that fills thin white lines through the blobs; 0 for none.
    """

    smoothing_px: float
    reach_blocks: int
    opening_px: int = 0
    closing_px: int = 0


def find_blobs(
    grey: Float[np.ndarray, "h w"], noise_sigma: float, scale: Scale, hole_ratio: float
) -> Blobs:
    """Connected dark regions of a round enough shape.

    hole_ratio : inner over outer radius of the sheet's rings; 0 if it has none.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), scale.smoothing_px)
    dark = _dark(smooth, noise_sigma / (2 * np.sqrt(np.pi) * scale.smoothing_px), scale)
    if scale.opening_px:
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (scale.opening_px,) * 2)
        dark = cv2.morphologyEx(dark, cv2.MORPH_OPEN, kernel)
    if scale.closing_px:
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (scale.closing_px,) * 2)
        dark = cv2.morphologyEx(dark, cv2.MORPH_CLOSE, kernel)
    return _moments(dark, hole_ratio)


def _dark(smooth: Float[np.ndarray, "h w"], noise_sigma: float, scale: Scale) -> np.ndarray:
    """Mask (0 or 1) of the pixels below the middle of their neighbourhood's extremes."""
    height, width = smooth.shape
    cell = np.ones((_BLOCK_PX + 1, _BLOCK_PX + 1), dtype=np.uint8)
    low = cv2.erode(smooth, cell)[_BLOCK_PX // 2 :: _BLOCK_PX, _BLOCK_PX // 2 :: _BLOCK_PX]
    high = cv2.dilate(smooth, cell)[_BLOCK_PX // 2 :: _BLOCK_PX, _BLOCK_PX // 2 :: _BLOCK_PX]
    side = 2 * scale.reach_blocks + 1
    around = np.ones((side, side), dtype=np.uint8)
    low, high = cv2.erode(low, around), cv2.dilate(high, around)
    # Extremes of pure noise lie some seven sigmas apart; flat neighbourhoods hold no ink.
    middle = np.where(high - low > 9.0 * noise_sigma + 1e-6, 0.5 * (high + low), low - 1.0)
    middle = cv2.blur(middle.astype(np.float32), (3, 3))
    rows, columns = middle.shape
    full = cv2.resize(middle, (columns * _BLOCK_PX, rows * _BLOCK_PX))
    full = cv2.copyMakeBorder(
        full[:height, :width],
        0,
        max(0, height - rows * _BLOCK_PX),
        0,
        max(0, width - columns * _BLOCK_PX),
        cv2.BORDER_REPLICATE,
    )
    return cv2.compare(smooth, full, cv2.CMP_LT)


def _moments(dark: np.ndarray, hole_ratio: float) -> Blobs:
    height, width = dark.shape
    _, labels, stats, centroids = cv2.connectedComponentsWithStats(dark, connectivity=4)
    left, top, box_width, box_height, area = stats.T
    inside = (left > 0) & (top > 0) & (left + box_width < width) & (top + box_height < height)
    keep = (
        inside
        & (area >= _SMALLEST_AREA_PX)
        & (area <= _LARGEST_SHARE * height * width)
        & (area >= _LEAST_FILLED * box_width * box_height)
    )
    keep[0] = False
    kept = np.flatnonzero(keep)
    if len(kept) > _MOST_BLOBS:
        kept = kept[np.argsort(area[kept])[-_MOST_BLOBS:]]
    number = np.full(len(area), -1, dtype=np.int32)
    number[kept] = np.arange(len(kept), dtype=np.int32)
    flat = np.flatnonzero(dark)
    blob = number[np.asarray(labels, dtype=np.int32).ravel()[flat]]
    flat, blob = flat[blob >= 0], blob[blob >= 0]
    rows, columns = np.divmod(flat, width)
    centres = centroids[kept]
    x = columns - centres[blob, 0]
    y = rows - centres[blob, 1]
    count = len(kept)
    second = (
        np.stack([np.bincount(blob, product, count) for product in (x * x, x * y, y * y)], axis=1)
        / np.maximum(area[kept], 1)[:, None]
    )
    xx, xy, yy = second.T
    determinant = np.maximum(xx * yy - xy * xy, 1e-9)
    roundness = area[kept] / (4 * np.pi * np.sqrt(determinant))
    is_round = (roundness > _ROUNDNESS[0]) & (roundness < _ROUNDNESS[1])
    ring_roundness = (1 - hole_ratio**2) / (1 + hole_ratio**2)
    is_ring = (hole_ratio > 0) & (roundness < 0.5 * (1 + ring_roundness))
    factor = np.where(is_ring, 4.0 / (1 + hole_ratio**2), 4.0)
    shape = factor[:, None, None] * np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
    return Blobs(centres[is_round], shape[is_round])
