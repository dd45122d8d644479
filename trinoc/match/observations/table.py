"""Padded tables of all views with the derived quantities of every segment."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.observations.side_intensity import SIDE_COLUMNS
from trinoc.numerics.buckets import bucket, pad_rows
from trinoc.numerics.precision import ArrayLike


class BlockSize(NamedTuple):
    """Number of rows that a compiled program processes in one call.

    The number is `per_segment` times the number of segments of a view, at most `limit`.
    """

    per_segment: int
    limit: int


# numerical: blocks of pairs make the transfer cheap, blocks of triples fit into a cache.
PAIRS_IN_BLOCK, TRIPLES_IN_BLOCK = BlockSize(16, 1 << 16), BlockSize(4, 1 << 11)


class SegmentTable(NamedTuple):
    """Segments and cameras of all views as padded arrays; rows beyond a view's count are padding.

    The table belongs to one frame, or to a stack: several frames that are matched as one problem.
    In a stack, a view contains the segments of all frames, frame after frame. The first four
    attributes then have a leading axis of frames.

    Attributes
    ----------
    matrix_px : (v, 3, 4)
        Projection matrices, scaled so that the third row gives the depth.
    centre_mm : (v, 3)
        Centres of projection, world frame.
    inverse : (v, 3, 3)
        Inverse of the left 3x3 block of each matrix.
    size_px : (v, 2)
        Width and height of each image.
    ends_px : (v, n, 2, 2)
        Ends of each segment, undistorted pixels.
    line : (v, n, 3)
        Line through the ends, a u + b v + c = 0 with the unit normal (a, b).
    across_px2 : (v, n, 2, 2)
        Covariance of the errors of the two ends across the segment.
    length_px : (v, n)
        Distance between the ends.
    polarity : (v, n)
        Darker side: +1 if on the right, -1 if on the left, 0 if unknown.
    rays : (v, n, 2, 3)
        Viewing rays of both ends, world frame, not normalised.
    sides : (v, n, 7)
        Result of `side_table`.
    frame : (v, n) or None
        Frame of each segment in a stack.
    """

    matrix_px: Float[ArrayLike, "*f v 3 4"]
    centre_mm: Float[ArrayLike, "*f v 3"]
    inverse: Float[ArrayLike, "*f v 3 3"]
    size_px: Float[ArrayLike, "*f v 2"]
    ends_px: Float[ArrayLike, "v n 2 2"]
    line: Float[ArrayLike, "v n 3"]
    across_px2: Float[ArrayLike, "v n 2 2"]
    length_px: Float[ArrayLike, "v n"]
    polarity: Float[ArrayLike, "v n"]
    rays: Float[ArrayLike, "v n 2 3"]
    sides: Float[ArrayLike, "v n 7"]
    frame: Int[ArrayLike, "v n"] | None = None


def segment_table(
    matrices_px: Float[np.ndarray, "*f v 3 4"],
    sizes_px: Float[np.ndarray, "*f v 2"],
    ends_px: Sequence[Float[np.ndarray, "_ 2 2"]],
    covariances_px2: Sequence[Float[np.ndarray, "_ 4 4"]],
    polarities: Sequence[np.ndarray],
    sides: Sequence[Float[np.ndarray, "_ 7"]],
    frames: Sequence[Int[np.ndarray, "_"]] | None = None,
) -> SegmentTable:
    """Build the table of all views. Every view is padded to the same length.

    `frames` are the frames of the segments of each view, for a stack of frames.
    """
    size = bucket(max(len(ends) for ends in ends_px))
    # Rows of padding are a valid segment, which avoids division by zero.
    filler = np.array([[0.0, 0.0], [1.0, 0.0]])
    prepared = _build_table(
        np.asarray(matrices_px),
        np.asarray(sizes_px),
        np.stack([pad_rows(ends, size, filler) for ends in ends_px]),
        np.stack([pad_rows(covariance, size, np.eye(4)) for covariance in covariances_px2]),
        np.stack([pad_rows(np.asarray(p, dtype=np.float64), size, 0.0) for p in polarities]),
        np.stack([pad_rows(table, size, np.full(SIDE_COLUMNS, np.nan)) for table in sides]),
        None if frames is None else np.stack([pad_rows(f.astype(np.int32), size) for f in frames]),
    )
    # Kernels read the tables many times, so they are transferred once.
    return jax.device_put(prepared)


def _build_table(
    matrices_px: Float[np.ndarray, "*f v 3 4"],
    sizes_px: Float[np.ndarray, "*f v 2"],
    ends_px: Float[np.ndarray, "v n 2 2"],
    covariance_px2: Float[np.ndarray, "v n 4 4"],
    polarity: Float[np.ndarray, "v n"],
    sides: Float[np.ndarray, "v n 7"],
    frame: Int[np.ndarray, "v n"] | None,
) -> SegmentTable:
    third_row = matrices_px[..., 2, :3]
    matrices = matrices_px / np.sqrt((third_row**2).sum(-1))[..., None, None]
    inverse = np.linalg.inv(matrices[..., :3])
    step = ends_px[:, :, 1] - ends_px[:, :, 0]
    length = np.sqrt((step**2).sum(-1))
    normal = np.stack([-step[..., 1], step[..., 0]], axis=-1) / length[..., None]
    offset = -(normal * ends_px[:, :, 0]).sum(-1)
    homogeneous = np.concatenate([ends_px, np.ones_like(ends_px[..., :1])], axis=-1)
    if frame is None:
        rays = homogeneous @ inverse.mT[:, None]
    else:
        rays = homogeneous @ inverse[frame, np.arange(len(frame))[:, None]].mT
    return SegmentTable(
        matrices,
        -(inverse @ matrices[..., 3:])[..., 0],
        inverse,
        sizes_px,
        ends_px,
        np.concatenate([normal, offset[..., None]], axis=-1),
        project_covariance_across(normal, covariance_px2),
        length,
        polarity,
        rays,
        sides,
        frame,
    )


def look_up_frames(
    lines: SegmentTable, index: Int[np.ndarray, "m v"]
) -> Int[np.ndarray, "m"] | None:
    """Return the frame of each candidate of a stack, (m,), or None for a single frame.

    `index` (m, v) are the segments of each candidate, -1 in views without a segment.
    """
    if lines.frame is None:
        return None
    view = np.argmax(index >= 0, axis=1)
    return np.asarray(lines.frame)[view, index[np.arange(len(index)), view]]


def segments_per_view(lines: SegmentTable, counts: list[int]) -> Float[np.ndarray, "*f"] | float:
    """Return the number of segments per view, mean over the views, for each frame."""
    if lines.frame is None:
        return float(np.mean(counts))
    frame, frames = np.asarray(lines.frame), len(lines.matrix_px)
    view_counts = [
        np.bincount(view_frames[:n], minlength=frames)
        for view_frames, n in zip(frame, counts, strict=True)
    ]
    return np.mean(view_counts, axis=0)


def take_matrices(
    lines: SegmentTable, frame: Int[np.ndarray, "m"] | None
) -> Float[np.ndarray, "_ v 3 4"]:
    """Return the projection matrices for each of m frame indices; one row for a single frame."""
    matrix = np.asarray(lines.matrix_px)
    return matrix[None] if frame is None else matrix[frame]


def project_covariance_across(
    normal: Float[np.ndarray, "*n 2"], covariance_px2: Float[np.ndarray, "*n 4 4"]
) -> Float[np.ndarray, "*n 2 2"]:
    """Return the covariance of the displacements of the two ends along the segment's normal, (n, 2,
    2).
    """
    blocks = covariance_px2.reshape(*normal.shape[:-1], 2, 2, 2, 2)
    across = (blocks * normal[..., None, None, None, :]).sum(-1)
    return (across * normal[..., None, :, None]).sum(-2)


def block_size(lines: SegmentTable, block: BlockSize) -> int:
    """Return the number of rows to pass to a compiled program in one call."""
    return min(block.limit, block.per_segment * lines.ends_px.shape[1])
