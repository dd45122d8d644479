"""Pixels beside the images of lines, in blocks of a few rows along each line.

A block is so short that the grey levels hardly change along it. Each block has its own levels,
so a shadow or another face farther along does not disturb it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.intrinsics import Intrinsics, distort_pixels, undistort_pixels
from trinoc.image.strip import list_pixels_across, take_levels
from trinoc.match.pixels.images import LineImages
from trinoc.match.pixels.tuning import PixelTuning

# numerical: rows of a block along the edge, and columns on either side of the middle one. The rows
# are rows or columns of the image, whichever cross the edge more steeply.
ROWS, HALF = 6, 11
# numerical: columns of both sides and the middle.
COLUMNS = 2 * HALF + 1
# numerical: a slope needs at least this number of rows.
_MIN_ROWS = 3
# numerical: chords that approximate the curved image of a line.
_CHORDS = 16
# numerical: label of pixels without a near segment.
NO_SEGMENT = -1


class Strips(NamedTuple):
    """Blocks of pixels across the images of lines: r rows along the edge and c columns across it.

    The blocks of a line follow each other.

    Attributes
    ----------
    across_px : (b, r, c)
        Signed distance of each pixel from the line's image, undistorted pixels.
    share : (b, r, c)
        Position along the image, 0 at its first end and 1 at its second.
    level : (b, r, c)
        Grey level, or light for a nonlinear camera response.
    usable : (b, r, c)
        True for pixels to use: near no other segment, and with only usable pixels up to the edge.
    line : (b,)
        Line of each block.
    """

    across_px: Float[np.ndarray, "b r c"]
    share: Float[np.ndarray, "b r c"]
    level: Float[np.ndarray, "b r c"]
    usable: Bool[np.ndarray, "b r c"]
    line: Int[np.ndarray, "b"]


def sample_strips(
    light: Float[np.ndarray, "h w"],
    clipped: Bool[np.ndarray, "h w"],
    owners: tuple[Int[np.ndarray, "h w"], Int[np.ndarray, "h w"]],
    lens: Intrinsics,
    images: LineImages,
    blur_px: float,
    tuning: PixelTuning,
) -> Strips:
    """Sample the blocks of pixels of all lines in one view. Lines that are too short have no block.

    `light` is the image, `clipped` the mask of saturated pixels. `owners` is the result of
    `segments_near_pixels`.
    """
    interval_px = images.extent_px + np.array([1.0, -1.0]) * tuning.end_widths * blur_px
    pixels, valid, line = _strip_pixels(lens, images, interval_px)
    undistorted = undistort_pixels(lens, pixels.astype(np.float64))
    # Pixels beyond the fold of the lens have no ray.
    has_ray = np.isfinite(undistorted).all(axis=-1)
    offset = np.nan_to_num(undistorted) - images.ends_px[line, 0][:, None, None]
    across, along = (
        np.einsum("brci,bi->brc", offset, axis[line]) for axis in (images.normal, images.direction)
    )
    level, is_inside = take_levels(light, pixels)
    is_clipped, first, last = (take_levels(mask, pixels)[0] for mask in (clipped, *owners))
    segment = images.segment[line][:, None, None]
    is_near_one_segment = (last == NO_SEGMENT) | ((first == segment) & (last == segment))
    is_usable = (
        valid
        & has_ray
        & is_inside
        & is_near_one_segment
        & (np.abs(across) <= tuning.search_radius_px)
        & ~is_clipped
    )
    share = along / images.length_px[line][:, None, None]
    return Strips(across, share, level.astype(np.float64), connected_to_middle(is_usable), line)


def connected_to_middle(is_good: Bool[np.ndarray, "*b c"]) -> Bool[np.ndarray, "*b c"]:
    """Return the mask of the good columns that are connected to the middle column, (..., c).

    A column is connected if all columns between it and the middle are good.
    """
    left_half = np.logical_and.accumulate(is_good[..., HALF::-1], axis=-1)[..., ::-1]
    right_half = np.logical_and.accumulate(is_good[..., HALF:], axis=-1)
    return np.concatenate([left_half[..., :-1], right_half], axis=-1)


def _strip_pixels(
    lens: Intrinsics, images: LineImages, interval_px: Float[np.ndarray, "s 2"]
) -> tuple[Int[np.ndarray, "b r c 2"], Bool[np.ndarray, "b r 1"], Int[np.ndarray, "b"]]:
    """List the pixels across each line, in blocks of rows.

    Returns (pixels (u, v) of each block, mask of the rows that exist, line of each block).
    `interval_px` is the interval to sample along each image.
    """
    chord_share = np.linspace(0, 1, _CHORDS)
    along = interval_px[:, :1] + chord_share * (interval_px[:, 1:] - interval_px[:, :1])
    path = images.ends_px[:, None, 0] + along[..., None] * images.direction[:, None]
    path = distort_pixels(lens, path)
    span = path[:, -1] - path[:, 0]
    is_steep = np.abs(span[:, 1]) > np.abs(span[:, 0])
    middles, valid, line = [], [], []
    is_imaged = np.isfinite(path).all(axis=(1, 2))
    for number in np.flatnonzero(is_imaged & (interval_px[:, 1] > interval_px[:, 0])):
        axis = int(is_steep[number])
        ordered_path = path[number] if span[number, axis] > 0 else path[number, ::-1]
        first, last = np.ceil(ordered_path[0, axis]), np.floor(ordered_path[-1, axis])
        length = int(last - first) + 1
        if length < _MIN_ROWS:
            continue
        # Remaining rows form another block if there are enough of them.
        count = length // ROWS + int(length % ROWS >= _MIN_ROWS or length < ROWS)
        main_coordinate = first + np.arange(count * ROWS)
        other_coordinate = np.rint(
            np.interp(main_coordinate, ordered_path[:, axis], ordered_path[:, 1 - axis])
        )
        middles.append(
            np.stack(
                [other_coordinate, main_coordinate]
                if axis
                else [main_coordinate, other_coordinate],
                axis=1,
            )
        )
        valid.append(np.arange(count * ROWS) < length)
        line.append(np.full(count, number))
    if not line:
        empty = np.zeros((0, ROWS, COLUMNS, 2), dtype=np.int64)
        return empty, np.zeros((0, ROWS, 1), dtype=bool), np.zeros(0, dtype=np.int64)
    owner = np.concatenate(line)
    middle = np.concatenate(middles).astype(np.int64).reshape(-1, ROWS, 2)
    along_u = np.broadcast_to(is_steep[owner][:, None], middle.shape[:2])
    has_row = np.concatenate(valid).reshape(-1, ROWS, 1)
    return list_pixels_across(middle, along_u, HALF), has_row, owner


def segments_near_pixels(
    ends_px: Float[np.ndarray, "n 2 2"], size_px: tuple[int, int], radius_px: float
) -> tuple[Int[np.ndarray, "h w"], Int[np.ndarray, "h w"]]:
    """Return the smallest and the largest index of the segments near each pixel, (h, w) each.

    Segments within `radius_px` count. If both indices are equal, only one segment is near. If none
    is near, both are NO_SEGMENT.
    """
    width, height = size_px
    first = np.full((height, width), len(ends_px), dtype=np.int64)
    last = np.full((height, width), NO_SEGMENT, dtype=np.int64)
    for number, ends in enumerate(ends_px):
        lower = np.clip(np.floor(ends.min(axis=0) - radius_px), 0, None).astype(np.int64)
        upper = np.ceil(ends.max(axis=0) + radius_px).astype(np.int64) + 1
        rows, columns = slice(lower[1], max(upper[1], 0)), slice(lower[0], max(upper[0], 0))
        is_near = _is_near_ends(ends, first[rows, columns].shape, lower, radius_px)
        first[rows, columns][is_near] = np.minimum(first[rows, columns][is_near], number)
        last[rows, columns][is_near] = number
    return np.where(last == NO_SEGMENT, NO_SEGMENT, first), last


def _is_near_ends(
    ends: Float[np.ndarray, "2 2"],
    shape: tuple[int, ...],
    origin: Int[np.ndarray, "2"],
    radius_px: float,
) -> Bool[np.ndarray, "_ _"]:
    direction = ends[1] - ends[0]
    length = np.linalg.norm(direction)
    direction = direction / max(length, 1e-9)
    v, u = np.ogrid[: shape[0], : shape[1]]
    offset_u, offset_v = u + origin[0] - ends[0, 0], v + origin[1] - ends[0, 1]
    along = offset_u * direction[0] + offset_v * direction[1]
    across = offset_v * direction[0] - offset_u * direction[1]
    is_alongside = (along > -radius_px) & (along < length + radius_px)
    return np.asarray(is_alongside & (np.abs(across) < radius_px))
