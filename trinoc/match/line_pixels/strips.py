"""The pixels beside the images of lines, in blocks of a few rows along each.

A block is so short that the grey levels on either side hardly change along it: each block has its
own, and no shadow or second face farther along disturbs it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry import Intrinsics
from trinoc.match.line_pixels.images import LineImages
from trinoc.match.line_pixels.neighbours import NOBODY
from trinoc.match.line_pixels.tuning import PixelTuning
from trinoc.match.observations import distorted, undistorted

# Rows along the edge, and columns to either side of the one in the middle. Rows and columns are
# the picture's own, whichever crosses the edge more steeply.
ROWS, HALF = 6, 11
COLUMNS = 2 * HALF + 1
_LEAST_ROWS = 3
# A lens bends the image of a line by less than this many chords show.
_CHORDS = 16


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


def strips_of(
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
    column, row, valid, line = _rows_of(lens, images, inside)
    height, width = light.shape
    within = valid & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    at = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
    places = np.stack([column, row], axis=-1).astype(np.float64)
    flat = undistorted(lens, places.reshape(-1, 2, 2)).reshape(places.shape)
    off = flat - images.ends_px[line, 0][:, None, None]
    across, along = (
        np.einsum("brci,bi->brc", off, axis[line]) for axis in (images.right, images.way)
    )
    own = images.segment[line][:, None, None]
    first, last = (owner[at] for owner in owners)
    alone = (last == NOBODY) | ((first == own) & (last == own))
    usable = within & alone & (np.abs(across) <= tuning.reach_px) & ~clipped[at]
    usable = outward(usable)
    share = along / images.length_px[line][:, None, None]
    return Strips(across, share, light[at].astype(np.float64), usable, line)


def outward(good: Bool[np.ndarray, "*b c"]) -> Bool[np.ndarray, "*b c"]:
    """Whether all columns from the middle one to each are good."""
    left = np.logical_and.accumulate(good[..., HALF::-1], axis=-1)[..., ::-1]
    right = np.logical_and.accumulate(good[..., HALF:], axis=-1)
    return np.concatenate([left[..., :-1], right], axis=-1)


def _rows_of(
    lens: Intrinsics, images: LineImages, inside_px: Float[np.ndarray, "s 2"]
) -> tuple[
    Int[np.ndarray, "b r c"], Int[np.ndarray, "b r c"], Bool[np.ndarray, "b r 1"], np.ndarray
]:
    """(column, row, whether a block has this row, line) of the pixels across each line."""
    chord = np.linspace(0, 1, _CHORDS)
    along = inside_px[:, :1] + chord * (inside_px[:, 1:] - inside_px[:, :1])
    path = images.ends_px[:, None, 0] + along[..., None] * images.way[:, None]
    path = distorted(lens, path.reshape(-1, 2, 2)).reshape(path.shape)
    span = path[:, -1] - path[:, 0]
    upright = np.abs(span[:, 1]) > np.abs(span[:, 0])
    steps, middles, valid, line = [], [], [], []
    for number in np.flatnonzero(inside_px[:, 1] > inside_px[:, 0]):
        main = int(upright[number])
        walk = path[number] if span[number, main] > 0 else path[number, ::-1]
        places = np.arange(np.ceil(walk[0, main]), np.floor(walk[-1, main]) + 1)
        if len(places) < _LEAST_ROWS:
            continue
        # Rows beyond the last block are spare, unless they are enough for one of their own.
        spare = len(places) % ROWS
        count = len(places) // ROWS + int(spare >= _LEAST_ROWS or len(places) < ROWS)
        there = np.arange(count * ROWS) < len(places)
        places = places[0] + np.arange(count * ROWS)
        steps.append(places.reshape(count, ROWS))
        middles.append(np.interp(places, walk[:, main], walk[:, 1 - main]).reshape(count, ROWS))
        valid.append(there.reshape(count, ROWS))
        line.append(np.full(count, number))
    if not line:
        none = np.zeros((0, ROWS, COLUMNS), dtype=np.int64)
        return none, none, np.zeros((0, ROWS, 1), dtype=bool), np.zeros(0, dtype=np.int64)
    owner = np.concatenate(line)
    step = np.concatenate(steps)[..., None].astype(np.int64)
    middle = np.rint(np.concatenate(middles))[..., None].astype(np.int64)
    other = middle + np.arange(-HALF, HALF + 1)
    step = np.broadcast_to(step, other.shape)
    tall = upright[owner][:, None, None]
    return (
        np.where(tall, other, step),
        np.where(tall, step, other),
        np.concatenate(valid)[..., None],
        owner,
    )
