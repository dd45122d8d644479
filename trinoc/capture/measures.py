"""Measurements of an image: exposure, sharpness, covered field and tilt of the board."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped

from trinoc.image.step_edge import blur_of_two_slopes

# In 255ths: cameras and JPEG change full white and black by a level or two.
_SATURATED, _DARK = 253, 2
# The paper is the brightest part of a board; dust and glints are brighter, but rare.
_PAPER_PERCENTILE = 95.0
# Scales of the two Gaussians, px: the first suppresses noise, the second is twice as wide.
_FINE, _COARSE = 1.0, 2.0
# Edges are ridges of the slope above this share of the steepest slopes.
_LEAST_SHARE = 0.4
_STEEP_PERCENTILE = 99.9
_FEWEST_EDGES = 20
# Cosine of 30 degrees: largest angle between a slope and the normal of its edge.
_ALONG = 0.866
_FEWEST_PLACES = 6
# Rows and columns of the cells that measure coverage of the field.
GRID = (6, 8)


class Exposure(NamedTuple):
    """Exposure of an image region.

    Attributes
    ----------
    saturated, dark : float
        Share of pixels at full white and at black.
    paper : float
        Level of the bright parts, as a share of full white.
    """

    saturated: float
    dark: float
    paper: float


def measure_exposure(levels: Float[np.ndarray, "h w"]) -> Exposure:
    """Exposure of grey levels in 255ths of full white."""
    return Exposure(
        float(np.mean(levels >= _SATURATED)),
        float(np.mean(levels <= _DARK)),
        float(np.percentile(levels, _PAPER_PERCENTILE)) / 255,
    )


def edge_blur_px(
    grey: Float[np.ndarray, "h w"], normals: Float[np.ndarray, "k 2"] | None = None
) -> float:
    """Median blur of the steep edges, as the sigma of a Gaussian, px; NaN with too few edges.

    Parameters
    ----------
    grey : (h, w)
        Grey levels.
    normals : (k, 2), optional
        Directions (right, down) across the edges of a board. Motion blurs only edges perpendicular
        to it. So the blur is measured separately for each direction, and the largest is returned.

    Notes
    -----
    The square pixels of a sensor alone give 0.29 px.
    """
    level = np.asarray(grey, dtype=np.float32)
    (fine, right, down), (coarse, _, _) = _slope(level, _FINE), _slope(level, _COARSE)
    ridge = fine >= cv2.dilate(fine, np.ones((3, 3), np.uint8)) * 0.98
    margin = int(np.ceil(3 * _COARSE))
    ridge[:margin] = ridge[-margin:] = False
    ridge[:, :margin] = ridge[:, -margin:] = False
    widths = []
    for normal in () if normals is None else normals / np.linalg.norm(normals, axis=1)[:, None]:
        across = np.abs(float(normal[0]) * right + float(normal[1]) * down)
        widths.append(_ridge_blur_px(fine, coarse, ridge, across > _ALONG * fine))
    kinds = [width for width in widths if not np.isnan(width)]
    return max(kinds) if kinds else _ridge_blur_px(fine, coarse, ridge)


def _ridge_blur_px(
    fine: Float[np.ndarray, "h w"],
    coarse: Float[np.ndarray, "h w"],
    ridge: Bool[np.ndarray, "h w"],
    mask: Bool[np.ndarray, "h w"] | None = None,
) -> float:
    """Median blur of the steep edges in an image, px; NaN with too few edges.

    The blur follows from the gradients at two scales.

    fine, coarse : lengths of the grey levels' gradient after a small and a large Gaussian blur.
    ridge : mask of the pixels where the gradient is a local maximum.
    mask : mask of the pixels to use; None for all.
    """
    slopes = fine if mask is None else fine[mask]
    if not len(slopes):
        return float("nan")
    # The floor excludes the noise of flat paper.
    smallest_slope = _LEAST_SHARE * float(np.percentile(slopes, _STEEP_PERCENTILE))
    selected = ridge & (fine > max(smallest_slope, 1e-6))
    selected = selected if mask is None else selected & mask
    if np.count_nonzero(selected) < _FEWEST_EDGES:
        return float("nan")
    squared_ratio = np.median((fine[selected] / np.maximum(coarse[selected], 1e-9)) ** 2)
    return blur_of_two_slopes(float(squared_ratio), _FINE, _COARSE)


def edge_normals(
    points_mm: Float[np.ndarray, "m 2"], points_px: Float[np.ndarray, "m 2"], *, round_ink: bool
) -> Float[np.ndarray, "k 2"] | None:
    """Directions in the image perpendicular to a board's edges, (k, 2).

    First the direction for edges along the board's Y, then for edges along X. `round_ink` adds
    the diagonal directions, for boards with edges in all directions. None with too few points.
    """
    if len(points_px) < _FEWEST_PLACES:
        return None
    # Images of the board's X and Y axes, px/mm.
    axes = np.linalg.lstsq(points_mm - points_mm.mean(axis=0), points_px, rcond=None)[0]
    directions = np.concatenate([axes[::-1], axes[:1] + axes[1:], axes[:1] - axes[1:]])
    normals = directions[: 4 if round_ink else 2] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    return normals if np.linalg.norm(normals, axis=1).min() > 0 else None


def fine_contrast(image: Shaped[np.ndarray, "..."]) -> float:
    """Mean square of the fine detail of an image, which motion of the board reduces.

    Of several images of a scene, the sharpest has the largest value. The computation takes about as
    long as decoding the image.

    image : (h, w) or (h, w, channels); of several channels, the second is used.
    """
    plane = np.ascontiguousarray(image if image.ndim == 2 else image[..., 1])
    smooth = cv2.GaussianBlur(plane, (0, 0), _FINE)
    return float(np.mean(np.square(cv2.Laplacian(smooth, cv2.CV_32F))))


def _slope(
    level: Float[np.ndarray, "h w"], scale: float
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Length, right component and down component of the grey levels' gradient.

    The gradient is taken after a Gaussian blur of `scale` px; the central differences contribute
    1/3 px^2 of the blur's variance.
    """
    smooth = cv2.GaussianBlur(level, (0, 0), np.sqrt(scale**2 - 1.0 / 3.0))
    rows = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1)
    columns = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1)
    return cv2.magnitude(columns, rows), columns, rows


def cover_cells(
    points_px: Float[np.ndarray, "m 2"], size_px: tuple[int, int]
) -> Bool[np.ndarray, "r c"]:
    """Mask of the image cells that the board covers, (r, c).

    A cell is covered if it contains a board point, or if its middle lies inside the hull of the
    points.
    """
    rows, columns = GRID
    cells = np.zeros(GRID, dtype=bool)
    if not len(points_px):
        return cells
    scaled = (points_px + 0.5) / np.array(size_px) * (columns, rows)
    column, row = np.clip(np.floor(scaled), 0, (columns - 1, rows - 1)).astype(int).T
    cells[row, column] = True
    hull = cv2.convexHull(scaled.astype(np.float32))
    for row in range(rows):
        for column in range(columns):
            inside = cv2.pointPolygonTest(hull, (column + 0.5, row + 0.5), False) >= 0
            cells[row, column] |= inside
    return cells


def measure_lean(
    points_mm: Float[np.ndarray, "m 2"], points_px: Float[np.ndarray, "m 2"]
) -> tuple[float, float]:
    """Tilt of a board: differences between the depths of its opposite sides, over the mean depth.

    Parameters
    ----------
    points_mm : (m, 2)
        Points on the board.
    points_px : (m, 2)
        Their pixels.

    Returns
    -------
    (right minus left, lower minus upper)
        Differences of depth between the two ends of the points along each image axis, as shares of
        the mean depth. (0, 0) with too few points.

    Notes
    -----
    No lens is needed, because the last row of a plane's homography is the depth up to a factor.
    Tilt makes the focal length observable.
    """
    if len(points_px) < _FEWEST_PLACES:
        return 0.0, 0.0
    homography, _ = cv2.findHomography(points_mm, points_px, 0)
    if homography is None:
        return 0.0, 0.0
    depth = points_mm @ homography[2, :2] + homography[2, 2]
    if np.ptp(np.sign(depth)) > 0:
        return 0.0, 0.0
    extent = np.ptp(points_px, axis=0)
    relative = (points_px - points_px.mean(axis=0)) / np.maximum(extent, 1e-9)
    design = np.column_stack([relative, np.ones(len(relative))])
    slope = np.linalg.lstsq(design, depth / depth.mean(), rcond=None)[0]
    return float(slope[0]), float(slope[1])
