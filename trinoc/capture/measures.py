"""What is measured of a picture: exposure, sharpness, where the board stands and how it leans."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped

from trinoc.image.step_edge import blur_of_two_slopes

# In 255ths. What cameras and JPEG make of full light and of none lies a level or two off.
_SATURATED, _DARK = 253, 2
# The paper is the brightest of a board; dust and glints are brighter, but few.
_PAPER_PERCENTILE = 95.0
# In pixels. The first is wide enough against noise, the second twice as wide.
_FINE, _COARSE = 1.0, 2.0
# Edges looked at: slopes along a ridge, above this share of the steepest ones.
_LEAST_SHARE = 0.4
_STEEP_PERCENTILE = 99.9
_FEWEST_EDGES = 20
# The cosine of 30 degrees: nearer to a normal, a slope is that of an edge across it.
_ALONG = 0.866
_FEWEST_PLACES = 6
# Rows and columns of the field that coverage is counted in.
GRID = (6, 8)


class Exposure(NamedTuple):
    """Shares of the pixels looked at, from 0 to 1.

    Fields
    ------
    saturated, dark : share of pixels at full white, and at black.
    paper : the level of the bright parts, as a share of full white.
    """

    saturated: float
    dark: float
    paper: float


def measure_exposure(levels: Float[np.ndarray, "h w"]) -> Exposure:
    """The exposure of grey levels in 255ths of full white."""
    return Exposure(
        float(np.mean(levels >= _SATURATED)),
        float(np.mean(levels <= _DARK)),
        float(np.percentile(levels, _PAPER_PERCENTILE)) / 255,
    )


def edge_blur_px(
    grey: Float[np.ndarray, "h w"], normals: Float[np.ndarray, "k 2"] | None = None
) -> float:
    """Median Gaussian sigma of the steep edges, in pixels; NaN where there are hardly any.

    normals : (right, down) across the edges of a board. Motion smears those across it alone, and
        the others stay steep: each kind is measured by itself, and the widest counts.

    A sensor's square pixels count for 0.29 px of it, motion for its part across each edge.
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
    among: Bool[np.ndarray, "h w"] | None = None,
) -> float:
    """The width of the steep edges among the pixels of one kind, or of all."""
    slopes = fine if among is None else fine[among]
    if not len(slopes):
        return float("nan")
    # Of flat paper nothing is left but noise, of which no ratio is taken.
    steep = _LEAST_SHARE * float(np.percentile(slopes, _STEEP_PERCENTILE))
    kept = ridge & (fine > max(steep, 1e-6))
    kept = kept if among is None else kept & among
    if np.count_nonzero(kept) < _FEWEST_EDGES:
        return float("nan")
    squared_ratio = np.median((fine[kept] / np.maximum(coarse[kept], 1e-9)) ** 2)
    return blur_of_two_slopes(float(squared_ratio), _FINE, _COARSE)


def edge_normals(
    places_mm: Float[np.ndarray, "m 2"], places_px: Float[np.ndarray, "m 2"], *, round_ink: bool
) -> Float[np.ndarray, "k 2"] | None:
    """Across the edges of a board that run along its Y and along its X, in the picture; None
    where too few places are seen.

    round_ink : whether it has edges in all directions, so that those between count, too.
    """
    if len(places_px) < _FEWEST_PLACES:
        return None
    # Of the board's X, and of its Y, in pixels per millimetre.
    axes = np.linalg.lstsq(places_mm - places_mm.mean(axis=0), places_px, rcond=None)[0]
    along = np.concatenate([axes[::-1], axes[:1] + axes[1:], axes[:1] - axes[1:]])
    normals = along[: 4 if round_ink else 2] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    return normals if np.linalg.norm(normals, axis=1).min() > 0 else None


def fine_contrast(image: Shaped[np.ndarray, "..."]) -> float:
    """How much a picture changes from pixel to pixel: of several of one scene, the sharpest has
    most of it, and a board that moves takes of it.

    image : (h, w) or (h, w, channels), of which the second counts. Costs no more than to decode.
    """
    plane = np.ascontiguousarray(image if image.ndim == 2 else image[..., 1])
    smooth = cv2.GaussianBlur(plane, (0, 0), _FINE)
    return float(np.mean(np.square(cv2.Laplacian(smooth, cv2.CV_32F))))


def _slope(
    level: Float[np.ndarray, "h w"], scale: float
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Size of the gradient after a Gaussian, of which central differences are 1/3 px^2, and its
    parts to the right and down."""
    smooth = cv2.GaussianBlur(level, (0, 0), np.sqrt(scale**2 - 1.0 / 3.0))
    rows = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1)
    columns = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1)
    return cv2.magnitude(columns, rows), columns, rows


def cover_cells(
    places_px: Float[np.ndarray, "m 2"], size_px: tuple[int, int]
) -> Bool[np.ndarray, "r c"]:
    """Which cells of the picture hold a place of the board, or have their middle among places."""
    rows, columns = GRID
    cells = np.zeros(GRID, dtype=bool)
    if not len(places_px):
        return cells
    scaled = (places_px + 0.5) / np.array(size_px) * (columns, rows)
    column, row = np.clip(np.floor(scaled), 0, (columns - 1, rows - 1)).astype(int).T
    cells[row, column] = True
    hull = cv2.convexHull(scaled.astype(np.float32))
    for row in range(rows):
        for column in range(columns):
            inside = cv2.pointPolygonTest(hull, (column + 0.5, row + 0.5), False) >= 0
            cells[row, column] |= inside
    return cells


def measure_lean(
    places_mm: Float[np.ndarray, "m 2"], places_px: Float[np.ndarray, "m 2"]
) -> tuple[float, float]:
    """How much farther the board's right side is than its left, and its lower than its upper.

    As shares of the distance, along the picture's axes, from one end of the places to the other. It
    needs no lens, because the last row of a plane's homography is the depth up to a factor. (0, 0)
    where too few places are seen. This is what tells a lens's focal length.
    """
    if len(places_px) < _FEWEST_PLACES:
        return 0.0, 0.0
    homography, _ = cv2.findHomography(places_mm, places_px, 0)
    if homography is None:
        return 0.0, 0.0
    depth = places_mm @ homography[2, :2] + homography[2, 2]
    if np.ptp(np.sign(depth)) > 0:
        return 0.0, 0.0
    extent = np.ptp(places_px, axis=0)
    relative = (places_px - places_px.mean(axis=0)) / np.maximum(extent, 1e-9)
    design = np.column_stack([relative, np.ones(len(relative))])
    slope = np.linalg.lstsq(design, depth / depth.mean(), rcond=None)[0]
    return float(slope[0]), float(slope[1])
