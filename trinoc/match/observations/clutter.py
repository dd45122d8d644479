"""The clutter model: density and length of segments that belong to no line."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import ClutterTuning
from trinoc.numerics.joins import group_medians, group_sums
from trinoc.numerics.precision import ArrayLike

# numerical: of frames with so many segments at most, all distances are computed: sooner than by a
# tree.
_FEW = 512


class ClutterModel(NamedTuple):
    """How segments of no line are distributed.

    log_density : about each segment, log of segments per pixel of area and per radian, N / (pi A).
    typical_px : typical length; lengths are spread as t / (length + t)^2. Of each frame of a stack.
    """

    log_density: Float[ArrayLike, "v n"]
    typical_px: Float[ArrayLike, "*f"]


def fit_clutter(
    lines: SegmentTable, counts: list[int], tuning: ClutterTuning = DEFAULT.clutter
) -> ClutterModel:
    """The clutter model of all segments of a frame: most of them belong to other lines."""
    sizes = np.asarray(lines.size_px)
    sizes = sizes[None] if lines.frame is None else sizes
    density, lengths, labels = [], [], []
    for view, count in enumerate(counts):
        middle = np.asarray(lines.ends_px)[view, :count].mean(axis=1)
        length, label = np.asarray(lines.length_px)[view], np.zeros(lines.ends_px.shape[1], int)
        label = label if lines.frame is None else np.asarray(lines.frame)[view]
        lengths.append(length[:count])
        labels.append(label[:count])
        here = _everywhere(middle, label[:count], sizes[:, view].prod(axis=1))[label]
        number = np.bincount(label[:count], minlength=len(sizes))
        if (number > tuning.neighbours).any():
            # Texture and the rims of shadows put much clutter in one place.
            distance = _to_neighbour(middle, label[:count], number, tuning.neighbours)
            local = tuning.neighbours / (np.pi * np.maximum(distance, 1.0) ** 2)
            here[:count] = np.maximum(here[:count], local)
        density.append(np.log(here / np.pi))
    label = None if lines.frame is None else np.concatenate(labels)
    typical = group_medians(np.concatenate(lengths), label, len(sizes))
    return ClutterModel(np.array(density), np.where(np.isfinite(typical), typical, 1.0))


def _to_neighbour(
    middle_px: Float[np.ndarray, "n 2"],
    frame: Int[np.ndarray, "n"],
    number: Int[np.ndarray, "f"],
    neighbour: int,
) -> Float[np.ndarray, "n"]:
    """Distance to the neighbour of that rank in the same frame; infinite where there are fewer.

    Segments of a frame follow those of the one before, as many as `number` says.
    """
    most = int(number.max())
    if most > _FEW:  # a frame alone
        return np.asarray(KDTree(middle_px).query(middle_px, neighbour + 1)[0][:, -1])
    place = np.arange(len(frame)) - (np.cumsum(number) - number)[frame]
    # Places without a segment are not at any distance, and sort last. Single precision, which is
    # good to a thousandth of a pixel, in place: the table is the larger part of the work.
    u, v = table = np.full((2, len(number), most), np.nan, np.float32)
    table[:, frame, place] = middle_px.T
    square, other = u[:, :, None] - u[:, None], v[:, :, None] - v[:, None]
    square *= square
    other *= other
    square += other
    square.partition(neighbour, axis=2)
    ranked = np.sqrt(square[frame, place, neighbour], dtype=np.float64)
    return np.where(np.isnan(ranked), np.inf, ranked)


def _everywhere(
    middle_px: Float[np.ndarray, "n 2"], frame: Int[np.ndarray, "n"], area_px2: np.ndarray
) -> Float[np.ndarray, "f"]:
    """Segments per pixel of each frame."""
    frames = len(area_px2)
    count = np.bincount(frame, minlength=frames)[:, None]
    mean = group_sums(middle_px, frame, frames) / np.maximum(count, 1)
    u, v = (middle_px - mean[frame]).T
    square = group_sums(np.column_stack([u * u, u * v, v * v]), frame, frames)
    uu, uv, vv = (square / np.maximum(count - 1, 1)).T
    # Segments often fill only a part of the picture: that of a box with their spread.
    box = 12 * np.sqrt(np.maximum(uu * vv - uv**2, 0.0))
    filled = np.minimum(area_px2, np.maximum(box, 1e-3 * area_px2))
    return np.maximum(count[:, 0], 1) / np.where(count[:, 0] > 2, filled, area_px2)
