"""Dark blobs that could be circles of the sheet, as ellipses from their moments."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.ellipse_pixels import inverse_square_root
from trinoc.calib.tuning.every_group import CalibTuning

# numerical: for time: no circle that can be measured has an outline of fewer pixels.
_SHORTEST_OUTLINE_PX = 8


class Blobs(NamedTuple):
    """Candidate circles.

    centres_px : (n, 2).
    shape_px2 : (n, 2, 2), S of the ellipse (x - c)^T S^-1 (x - c) = 1 of the outer edge.
    """

    centres_px: Float[np.ndarray, "n 2"]
    shape_px2: Float[np.ndarray, "n 2 2"]

    def __len__(self) -> int:
        return len(self.centres_px)

    def rescale(self, factor: float) -> "Blobs":
        """Blobs of a picture `factor` times smaller, in pixels of the large one."""
        middle = 0.5 * (factor - 1)
        return Blobs(self.centres_px * factor + middle, self.shape_px2 * factor**2)


class BlobScale(NamedTuple):
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
    grey: Float[np.ndarray, "h w"], noise_sigma: float, scale: BlobScale, tuning: CalibTuning
) -> Blobs:
    """Connected dark regions of a round enough shape."""
    smooth = cv2.GaussianBlur(grey, (0, 0), scale.smoothing_px)
    dark = _dark(smooth, noise_sigma / (2 * np.sqrt(np.pi) * scale.smoothing_px), scale, tuning)
    steps = (cv2.MORPH_OPEN, scale.opening_px), (cv2.MORPH_CLOSE, scale.closing_px)
    for step, side_px in steps:
        if side_px:
            kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side_px, side_px))
            dark = cv2.morphologyEx(dark, step, kernel)
    return _moments(dark, tuning)


def _dark(
    smooth: Float[np.ndarray, "h w"], noise_sigma: float, scale: BlobScale, tuning: CalibTuning
) -> np.ndarray:
    """Mask (0 or 1) of the pixels below the middle of their neighbourhood's extremes."""
    block_px = tuning.detection.block_px
    height, width = smooth.shape
    # The picture is smooth, so every second pixel shows its extremes.
    half = np.ascontiguousarray(smooth[::2, ::2])
    cell = np.ones((block_px // 2 + 1,) * 2, dtype=np.uint8)
    middles = slice(block_px // 4, None, block_px // 2)
    low = cv2.erode(half, cell)[middles, middles]
    high = cv2.dilate(half, cell)[middles, middles]
    side = 2 * scale.reach_blocks + 1
    around = np.ones((side, side), dtype=np.uint8)
    low, high = cv2.erode(low, around), cv2.dilate(high, around)
    # Extremes of pure noise lie some seven sigmas apart; flat neighbourhoods hold no ink.
    middle = np.where(high - low > 9.0 * noise_sigma + 1e-6, 0.5 * (high + low), low - 1.0)
    middle = cv2.blur(middle.astype(np.float32), (3, 3))
    rows, columns = middle.shape
    full = cv2.resize(middle, (columns * block_px, rows * block_px))
    missing = [(0, max(0, height - rows * block_px)), (0, max(0, width - columns * block_px))]
    full = np.pad(full[:height, :width], missing, mode="edge")
    return cv2.compare(smooth, full, cv2.CMP_LT)


def _moments(dark: np.ndarray, tuning: CalibTuning) -> Blobs:
    """Ellipses with the moments of the regions' outer outlines; holes count as filled."""
    height, width = dark.shape
    outlines, hierarchy = cv2.findContours(dark, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    rows = []
    parents = [] if hierarchy is None else hierarchy[0][:, 3]
    for outline, parent in zip(outlines, parents, strict=True):
        if parent >= 0 or len(outline) < _SHORTEST_OUTLINE_PX:
            continue
        m = cv2.moments(outline)
        left, top, across, down = cv2.boundingRect(outline)
        is_clear = left > 0 and top > 0 and left + across < width and top + down < height
        if m["m00"] > 0.5 and is_clear:
            rows.append([m[key] for key in ("m00", "m10", "m01", "mu20", "mu11", "mu02")])
    table = np.array(rows).reshape(-1, 6)
    area = table[:, 0]
    xx, xy, yy = (table[:, 3:] / area[:, None]).T
    root = np.sqrt(np.maximum(xx * yy - xy * xy, 1e-9))
    roundness = area / (4 * np.pi * root)
    least, most = tuning.detection.roundness
    keep = (roundness > least) & (roundness < most)
    if np.sum(keep) > tuning.detection.most_blobs:
        keep &= area >= np.sort(area[keep])[-tuning.detection.most_blobs]
    centres = table[:, 1:3] / area[:, None]
    shape = 4.0 * np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)[keep]
    # Half a pixel more on every side, as outlines run through the centres of pixels.
    shape = shape + shape @ inverse_square_root(shape) + 0.25 * np.eye(2)
    return Blobs(centres[keep], shape)
