"""Clutter model: density and length of segments that belong to no line."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import ClutterTuning
from trinoc.numerics.joins import group_medians, group_sums
from trinoc.numerics.precision import ArrayLike

# numerical: up to this number of segments, computing all distances is faster than a k-d tree.
_FEW = 512


class ClutterModel(NamedTuple):
    """Statistical model of clutter, the segments that belong to no line.

    Attributes
    ----------
    log_density : (v, n)
        Log of the number of segments per px^2 and radian near each segment.
    typical_px : ()
        Typical length t. The density of a length is t / (length + t)^2. One value for each frame of
        a stack.
    """

    log_density: Float[ArrayLike, "v n"]
    typical_px: Float[ArrayLike, "*f"]


def fit_clutter(
    lines: SegmentTable, counts: list[int], tuning: ClutterTuning = DEFAULT.clutter
) -> ClutterModel:
    """Fit the clutter model to all segments of a frame.

    All segments are used, because nearly all are clutter for any one line. `counts` is the number
    of segments in each view.
    """
    sizes = np.asarray(lines.size_px)
    sizes = sizes[None] if lines.frame is None else sizes
    density, lengths, labels = [], [], []
    for view, count in enumerate(counts):
        middle = np.asarray(lines.ends_px)[view, :count].mean(axis=1)
        length, label = np.asarray(lines.length_px)[view], np.zeros(lines.ends_px.shape[1], int)
        label = label if lines.frame is None else np.asarray(lines.frame)[view]
        lengths.append(length[:count])
        labels.append(label[:count])
        view_density = _mean_density(middle, label[:count], sizes[:, view].prod(axis=1))[label]
        segments_of_frame = np.bincount(label[:count], minlength=len(sizes))
        if (segments_of_frame > tuning.neighbours).any():
            # Texture and shadow borders cause locally dense clutter.
            distance = _distance_to_neighbour(
                middle, label[:count], segments_of_frame, tuning.neighbours
            )
            local = tuning.neighbours / (np.pi * np.maximum(distance, 1.0) ** 2)
            view_density[:count] = np.maximum(view_density[:count], local)
        density.append(np.log(view_density / np.pi))
    label = None if lines.frame is None else np.concatenate(labels)
    median_length = group_medians(np.concatenate(lengths), label, len(sizes))
    return ClutterModel(np.array(density), np.where(np.isfinite(median_length), median_length, 1.0))


def _distance_to_neighbour(
    middle_px: Float[np.ndarray, "n 2"],
    frame: Int[np.ndarray, "n"],
    segments_of_frame: Int[np.ndarray, "f"],
    neighbour: int,
) -> Float[np.ndarray, "n"]:
    """Distance of each segment midpoint to its k-th nearest midpoint of the same frame, (n,) px.

    k is `neighbour`. The distance is inf if the frame has too few segments. The segments are sorted
    by frame, with `segments_of_frame` in each frame.
    """
    largest_count = int(segments_of_frame.max())
    if largest_count > _FEW:  # a frame alone
        return np.asarray(KDTree(middle_px).query(middle_px, neighbour + 1)[0][:, -1])
    slot = np.arange(len(frame)) - (np.cumsum(segments_of_frame) - segments_of_frame)[frame]
    # Empty slots are NaN and sort last. Single precision is accurate to 0.001 px and halves the
    # size of the table, which dominates the time.
    u, v = table = np.full((2, len(segments_of_frame), largest_count), np.nan, np.float32)
    table[:, frame, slot] = middle_px.T
    squared, dv2 = u[:, :, None] - u[:, None], v[:, :, None] - v[:, None]
    squared *= squared
    dv2 *= dv2
    squared += dv2
    squared.partition(neighbour, axis=2)
    ranked = np.sqrt(squared[frame, slot, neighbour], dtype=np.float64)
    return np.where(np.isnan(ranked), np.inf, ranked)


def _mean_density(
    middle_px: Float[np.ndarray, "n 2"], frame: Int[np.ndarray, "n"], area_px2: np.ndarray
) -> Float[np.ndarray, "f"]:
    """Number of segments per px^2, mean over the occupied part of the image, for each frame."""
    frames = len(area_px2)
    count = np.bincount(frame, minlength=frames)[:, None]
    mean = group_sums(middle_px, frame, frames) / np.maximum(count, 1)
    u, v = (middle_px - mean[frame]).T
    square = group_sums(np.column_stack([u * u, u * v, v * v]), frame, frames)
    uu, uv, vv = (square / np.maximum(count - 1, 1)).T
    # Segments often occupy only a part of the image: a box with the spread of their middles.
    box = 12 * np.sqrt(np.maximum(uu * vv - uv**2, 0.0))
    occupied_px2 = np.minimum(area_px2, np.maximum(box, 1e-3 * area_px2))
    return np.maximum(count[:, 0], 1) / np.where(count[:, 0] > 2, occupied_px2, area_px2)
