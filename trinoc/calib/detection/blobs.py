"""Search for dark blobs: candidate circles of the sheet, as ellipses from their moments."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.ellipse_pixels import inverse_square_root
from trinoc.calib.tuning.every_group import CalibTuning

# numerical: shorter outlines are skipped to save time: such circles cannot be measured.
_SHORTEST_OUTLINE_PX = 8


class Blobs(NamedTuple):
    """Dark blobs of an image that may be circles, described as ellipses.

    Attributes
    ----------
    centres_px : (n, 2) centres of the ellipses.
    shape_px2 : (n, 2, 2) shape matrices S of the ellipses, (x - c)^T S^-1 (x - c) = 1.
    """

    centres_px: Float[np.ndarray, "n 2"]
    shape_px2: Float[np.ndarray, "n 2 2"]

    def __len__(self) -> int:
        return len(self.centres_px)

    def rescale(self, factor: float) -> "Blobs":
        """Convert blobs of an image reduced by `factor` to pixels of the full image."""
        middle = 0.5 * (factor - 1)
        return Blobs(self.centres_px * factor + middle, self.shape_px2 * factor**2)


class BlobScale(NamedTuple):
    """Settings of one search for blobs.

    Attributes
    ----------
    smoothing_px : sigma of the initial Gaussian filter.
    reach_blocks : half the side of the square neighbourhood from which the threshold is computed,
        in blocks of `tuning.detection.block_px` pixels.
    opening_px : side of a morphological opening that removes thin dark lines from blobs; 0 for no
        opening.
    closing_px : side of a morphological closing that fills thin white lines in blobs; 0 for no
        closing.
    """

    smoothing_px: float
    reach_blocks: int
    opening_px: int = 0
    closing_px: int = 0


def find_blobs(
    grey: Float[np.ndarray, "h w"], noise_sigma: float, scale: BlobScale, tuning: CalibTuning
) -> Blobs:
    """Find connected dark regions of nearly elliptical shape.

    Parameters
    ----------
    grey : grey levels.
    noise_sigma : standard deviation of the image noise, grey levels.
    scale : settings of this search.
    tuning : tuned constants of calibration.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), scale.smoothing_px)
    dark = _mask_dark_pixels(
        smooth, noise_sigma / (2 * np.sqrt(np.pi) * scale.smoothing_px), scale, tuning
    )
    steps = (cv2.MORPH_OPEN, scale.opening_px), (cv2.MORPH_CLOSE, scale.closing_px)
    for step, side_px in steps:
        if side_px:
            kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side_px, side_px))
            dark = cv2.morphologyEx(dark, step, kernel)
    return _ellipses_of_outlines(dark, tuning)


def _mask_dark_pixels(
    smooth: Float[np.ndarray, "h w"], noise_sigma: float, scale: BlobScale, tuning: CalibTuning
) -> np.ndarray:
    """Mask of the dark pixels, (h, w).

    A pixel is dark if its level is below the mean of the smallest and the largest level around it.
    """
    block_px = tuning.detection.block_px
    height, width = smooth.shape
    # The smoothed image needs only every second pixel for its extremes.
    half = np.ascontiguousarray(smooth[::2, ::2])
    cell = np.ones((block_px // 2 + 1,) * 2, dtype=np.uint8)
    middles = slice(block_px // 4, None, block_px // 2)
    low = cv2.erode(half, cell)[middles, middles]
    high = cv2.dilate(half, cell)[middles, middles]
    side = 2 * scale.reach_blocks + 1
    around = np.ones((side, side), dtype=np.uint8)
    low, high = cv2.erode(low, around), cv2.dilate(high, around)
    # Extremes of pure noise differ by about seven sigmas: flat neighbourhoods contain no ink.
    middle = np.where(high - low > 9.0 * noise_sigma + 1e-6, 0.5 * (high + low), low - 1.0)
    middle = cv2.blur(middle.astype(np.float32), (3, 3))
    rows, columns = middle.shape
    full = cv2.resize(middle, (columns * block_px, rows * block_px))
    missing = [(0, max(0, height - rows * block_px)), (0, max(0, width - columns * block_px))]
    full = np.pad(full[:height, :width], missing, mode="edge")
    return cv2.compare(smooth, full, cv2.CMP_LT)


def _ellipses_of_outlines(dark: np.ndarray, tuning: CalibTuning) -> Blobs:
    """Ellipses with the same moments as the outer outlines of dark regions.

    Holes are filled. Regions at the border of the image and regions that are not elliptical are
    omitted.
    """
    height, width = dark.shape
    outlines, hierarchy = cv2.findContours(dark, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    rows = []
    parents = [] if hierarchy is None else hierarchy[0][:, 3]
    for outline, parent in zip(outlines, parents, strict=True):
        if parent >= 0 or len(outline) < _SHORTEST_OUTLINE_PX:
            continue
        m = cv2.moments(outline)
        box_x, box_y, box_width, box_height = cv2.boundingRect(outline)
        is_inside = box_x > 0 and box_y > 0
        is_inside &= box_x + box_width < width and box_y + box_height < height
        if m["m00"] > 0.5 and is_inside:
            rows.append([m[key] for key in ("m00", "m10", "m01", "mu20", "mu11", "mu02")])
    table = np.array(rows).reshape(-1, 6)
    area = table[:, 0]
    xx, xy, yy = (table[:, 3:] / area[:, None]).T
    root = np.sqrt(np.maximum(xx * yy - xy * xy, 1e-9))
    roundness = area / (4 * np.pi * root)
    smallest, largest = tuning.detection.roundness
    is_round = (roundness > smallest) & (roundness < largest)
    if np.sum(is_round) > tuning.detection.most_blobs:
        is_round &= area >= np.sort(area[is_round])[-tuning.detection.most_blobs]
    centres = table[:, 1:3] / area[:, None]
    shape = 4.0 * np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)[is_round]
    # Outlines run through pixel centres: enlarge by half a pixel on every side.
    shape = shape + shape @ inverse_square_root(shape) + 0.25 * np.eye(2)
    return Blobs(centres[is_round], shape)
