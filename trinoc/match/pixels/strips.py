"""The pixels beside the images of lines, in blocks of a few rows along each.

A block is so short that the grey levels on either side hardly change along it: each block has its
own, and no shadow or second face farther along disturbs it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.intrinsics import Intrinsics, distort_pixels, undistort_pixels
from trinoc.image.strip import list_pixels_across, take_levels
from trinoc.match.pixels.images import LineImages
from trinoc.match.pixels.tuning import PixelTuning

# numerical: rows along the edge, and columns to either side of the one in the middle. Rows and
# columns are the picture's own, whichever crosses the edge more steeply.
ROWS, HALF = 6, 11
# numerical: both sides and the middle.
COLUMNS = 2 * HALF + 1
# numerical: fewer say nothing of a slope.
_LEAST_ROWS = 3
# numerical: a lens bends the image of a line by less than this many chords show.
_CHORDS = 16
# numerical: whose the surroundings of a pixel are, where no segment is near.
NOBODY = -1


class Strips(NamedTuple):
    """Blocks of pixels beside lines; those of a line follow one another.

    Fields
    ------
    across_px : (b, r, c) distance from the line's image, in undistorted pixels.
    share : (b, r, c) position along it, 0 and 1 at the ends.
    level : (b, r, c) grey level, or light. usable : (b, r, c) whether a pixel is near this line
        alone, with nothing between.
    line : (b,) whose each block is.
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
    """The blocks of all lines of a picture; lines without room for one have none."""
    inside = images.extent_px + np.array([1.0, -1.0]) * tuning.end_widths * blur_px
    pixels, valid, line = _strip_pixels(lens, images, inside)
    flat = undistort_pixels(lens, pixels.astype(np.float64))
    # Some pixels beside a line that ends at the fold of the lens have no ray.
    has_ray = np.isfinite(flat).all(axis=-1)
    off = np.nan_to_num(flat) - images.ends_px[line, 0][:, None, None]
    across, along = (
        np.einsum("brci,bi->brc", off, axis[line]) for axis in (images.right, images.way)
    )
    level, within = take_levels(light, pixels)
    is_clipped, first, last = (take_levels(each, pixels)[0] for each in (clipped, *owners))
    own = images.segment[line][:, None, None]
    alone = (last == NOBODY) | ((first == own) & (last == own))
    usable = valid & has_ray & within & alone & (np.abs(across) <= tuning.reach_px) & ~is_clipped
    share = along / images.length_px[line][:, None, None]
    return Strips(across, share, level.astype(np.float64), outward(usable), line)


def outward(good: Bool[np.ndarray, "*b c"]) -> Bool[np.ndarray, "*b c"]:
    """Whether all columns from the middle one to each are good."""
    left = np.logical_and.accumulate(good[..., HALF::-1], axis=-1)[..., ::-1]
    right = np.logical_and.accumulate(good[..., HALF:], axis=-1)
    return np.concatenate([left[..., :-1], right], axis=-1)


def _strip_pixels(
    lens: Intrinsics, images: LineImages, inside_px: Float[np.ndarray, "s 2"]
) -> tuple[Int[np.ndarray, "b r c 2"], Bool[np.ndarray, "b r 1"], Int[np.ndarray, "b"]]:
    """(pixels across each line, whether a block has this row, line)."""
    chord = np.linspace(0, 1, _CHORDS)
    along = inside_px[:, :1] + chord * (inside_px[:, 1:] - inside_px[:, :1])
    path = images.ends_px[:, None, 0] + along[..., None] * images.way[:, None]
    path = distort_pixels(lens, path)
    span = path[:, -1] - path[:, 0]
    upright = np.abs(span[:, 1]) > np.abs(span[:, 0])
    middles, valid, line = [], [], []
    is_imaged = np.isfinite(path).all(axis=(1, 2))
    for number in np.flatnonzero(is_imaged & (inside_px[:, 1] > inside_px[:, 0])):
        main = int(upright[number])
        walk = path[number] if span[number, main] > 0 else path[number, ::-1]
        first, last = np.ceil(walk[0, main]), np.floor(walk[-1, main])
        length = int(last - first) + 1
        if length < _LEAST_ROWS:
            continue
        # Rows beyond the last block are spare, unless they are enough for one of their own.
        count = length // ROWS + int(length % ROWS >= _LEAST_ROWS or length < ROWS)
        places = first + np.arange(count * ROWS)
        other = np.rint(np.interp(places, walk[:, main], walk[:, 1 - main]))
        middles.append(np.stack([other, places] if main else [places, other], axis=1))
        valid.append(np.arange(count * ROWS) < length)
        line.append(np.full(count, number))
    if not line:
        none = np.zeros((0, ROWS, COLUMNS, 2), dtype=np.int64)
        return none, np.zeros((0, ROWS, 1), dtype=bool), np.zeros(0, dtype=np.int64)
    owner = np.concatenate(line)
    middle = np.concatenate(middles).astype(np.int64).reshape(-1, ROWS, 2)
    along_u = np.broadcast_to(upright[owner][:, None], middle.shape[:2])
    have = np.concatenate(valid).reshape(-1, ROWS, 1)
    return list_pixels_across(middle, along_u, HALF), have, owner


def assign_pixels(
    ends_px: Float[np.ndarray, "n 2 2"], size_px: tuple[int, int], reach_px: float
) -> tuple[Int[np.ndarray, "h w"], Int[np.ndarray, "h w"]]:
    """The first and the last of the segments within reach of each pixel, NOBODY without any.

    Where they are the same, the pixel is near that segment alone.
    """
    width, height = size_px
    first = np.full((height, width), len(ends_px), dtype=np.int64)
    last = np.full((height, width), NOBODY, dtype=np.int64)
    for number, ends in enumerate(ends_px):
        low = np.clip(np.floor(ends.min(axis=0) - reach_px), 0, None).astype(np.int64)
        high = np.ceil(ends.max(axis=0) + reach_px).astype(np.int64) + 1
        rows, columns = slice(low[1], max(high[1], 0)), slice(low[0], max(high[0], 0))
        near = _is_near_ends(ends, first[rows, columns].shape, low, reach_px)
        first[rows, columns][near] = np.minimum(first[rows, columns][near], number)
        last[rows, columns][near] = number
    return np.where(last == NOBODY, NOBODY, first), last


def _is_near_ends(
    ends: Float[np.ndarray, "2 2"],
    shape: tuple[int, ...],
    origin: Int[np.ndarray, "2"],
    reach_px: float,
) -> Bool[np.ndarray, "_ _"]:
    way = ends[1] - ends[0]
    length = np.linalg.norm(way)
    way = way / max(length, 1e-9)
    v, u = np.ogrid[: shape[0], : shape[1]]
    off_u, off_v = u + origin[0] - ends[0, 0], v + origin[1] - ends[0, 1]
    along, across = off_u * way[0] + off_v * way[1], off_v * way[0] - off_u * way[1]
    beside = (along > -reach_px) & (along < length + reach_px)
    return np.asarray(beside & (np.abs(across) < reach_px))
