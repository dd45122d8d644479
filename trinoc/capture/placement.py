"""Where in the picture a board stands, and which way it leans."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

# Rows and columns of the field that coverage is counted in.
GRID = (6, 8)
_FEWEST_PLACES = 6


def covered_cells(
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


def lean_of(
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
    if not (depth > 0).all() and not (depth < 0).all():
        return 0.0, 0.0
    extent = np.ptp(places_px, axis=0)
    relative = (places_px - places_px.mean(axis=0)) / np.maximum(extent, 1e-9)
    design = np.column_stack([relative, np.ones(len(relative))])
    slope = np.linalg.lstsq(design, depth / depth.mean(), rcond=None)[0]
    return float(slope[0]), float(slope[1])
