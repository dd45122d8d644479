"""Pixels near the edges of a chessboard's squares, and a first guess of its light and ink."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.photometric.line_pixels import places_of_pixels
from trinoc.calib.photometric.outlines import project_to_image
from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens, Pose
from trinoc.numerics import point_tree

# Of the distance between corners: the box about them, and where squares are looked at.
_MARGIN, _INSIDE = 0.6, 0.3


class CornerPixels(NamedTuple):
    """Pixels of a chessboard.

    Fields
    ------
    column, row : (n,) of those near an edge.
    corner : (n,) the corner nearest to each.
    first : (row, column) of the corners' box.
    flat : (h, w) pixels of that box within dark squares and near no edge.
    """

    column: Int[np.ndarray, "n"]
    row: Int[np.ndarray, "n"]
    corner: Int[np.ndarray, "n"]
    first: tuple[int, int]
    flat: Bool[np.ndarray, "h w"]


def corner_pixels(
    pose: Pose,
    lens: AbstractLens,
    pattern: Pattern,
    image_size_px: tuple[int, int],
    reach_px: float,
) -> CornerPixels:
    """The pixels within reach of the edges that leave each corner, halfway to the next."""
    middle = np.asarray(project_to_image(pose, lens, pattern.centres_mm))
    step = float(np.max(point_tree(middle).query(middle, 2)[0][:, 1]))
    limit = np.array(image_size_px) - 1
    low = np.clip(np.floor(middle.min(axis=0) - _MARGIN * step), 0, limit).astype(int)
    high = np.clip(np.ceil(middle.max(axis=0) + _MARGIN * step), 0, limit).astype(int)
    rows, columns = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    place, mm_per_px = places_of_pixels(columns.ravel(), rows.ravel(), pose, lens)
    corner = np.asarray(point_tree(pattern.centres_mm).query(place)[1])
    offset = place - pattern.centres_mm[corner]
    within = np.abs(offset).max(axis=1) < pattern.radius_mm[corner]
    near = np.abs(offset).min(axis=1) < reach_px * mm_per_px
    is_upper_left = (offset[:, 0] < 0) == (offset[:, 1] > 0)
    is_dark = is_upper_left == (pattern.inner_radius_mm[corner] == 0)
    chosen = within & near
    return CornerPixels(
        columns.ravel()[chosen],
        rows.ravel()[chosen],
        corner[chosen],
        (int(low[1]), int(low[0])),
        (within & ~near & is_dark).reshape(rows.shape),
    )


def places_to_look_at(
    pattern: Pattern,
) -> tuple[Float[np.ndarray, "_i 2"], Float[np.ndarray, "_e 2"], Float[np.ndarray, "_p 2"]]:
    """Places in ink, on edges and on paper, two or four about each corner."""
    away = 2 * _INSIDE * pattern.radius_mm[:, None]
    falling = np.where(pattern.inner_radius_mm[:, None] > 0, [1.0, 1.0], [1.0, -1.0])
    ink = [pattern.centres_mm + sign * away * falling for sign in (1, -1)]
    paper = [pattern.centres_mm + sign * away * falling * [1.0, -1.0] for sign in (1, -1)]
    axes = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    edge = [pattern.centres_mm + away * axis for axis in axes]
    return np.concatenate(ink), np.concatenate(edge), np.concatenate(paper)
