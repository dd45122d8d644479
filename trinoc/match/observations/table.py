"""What the matcher needs of every segment, prepared once, in padded tables over all views."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.observations.side_intensity import SIDE_COLUMNS
from trinoc.numerics.buckets import bucket, pad_rows
from trinoc.numerics.precision import ArrayLike


class BlockSize(NamedTuple):
    """Rows handed to a kernel at a time: so many for each segment of a view, up to a limit."""

    per_segment: int
    most: int


# numerical: of pairs as many as make the handing over cheap, of triples few enough for a
# processor's cache.
PAIRS_IN_BLOCK, TRIPLES_IN_BLOCK = BlockSize(16, 1 << 16), BlockSize(4, 1 << 11)


class SegmentTable(NamedTuple):
    """Segments of all views on undistorted pixels; rows beyond a view's count are padding.

    Of one frame, or of a stack of frames of as many views each: then their segments follow one
    another, and what belongs to cameras has an axis of frames in front.

    matrix_px : projection matrices, scaled so that the third row gives the depth.
    centre_mm : centres of projection. inverse : of the left 3x3 part of each matrix.
    size_px : width and height of each picture.
    ends_px : ends of each segment. line : through them, with unit normal.
    across_px2 : covariance of the two ends' errors across the segment.
    length_px : distance between the ends.
    polarity : +1, -1, or 0 where not known. sides : see `side_intensity.side_table`.
    rays : viewing rays of both ends, world frame, of any length.
    frame : of a stack, the frame of each segment.
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
    """Tables for all views, padded to one bucket; `frames` are those of a stack's segments."""
    size = bucket(max(len(ends) for ends in ends_px))
    # Rows of padding are a segment like any other, so that nothing divides by zero.
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
    # Kernels take the tables many times: they are handed over once.
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
    """The frame of each group of segments, -1 where it has none in a view; None without frames."""
    if lines.frame is None:
        return None
    view = np.argmax(index >= 0, axis=1)
    return np.asarray(lines.frame)[view, index[np.arange(len(index)), view]]


def segments_per_view(lines: SegmentTable, counts: list[int]) -> Float[np.ndarray, "*f"] | float:
    """Mean number of segments of a view, of each frame."""
    if lines.frame is None:
        return float(np.mean(counts))
    frame, frames = np.asarray(lines.frame), len(lines.matrix_px)
    each = [np.bincount(own[:n], minlength=frames) for own, n in zip(frame, counts, strict=True)]
    return np.mean(each, axis=0)


def take_matrices(
    lines: SegmentTable, frame: Int[np.ndarray, "m"] | None
) -> Float[np.ndarray, "_ v 3 4"]:
    """Projection matrices of each group's frame; one row for all without frames."""
    matrix = np.asarray(lines.matrix_px)
    return matrix[None] if frame is None else matrix[frame]


def project_covariance_across(
    normal: Float[np.ndarray, "*n 2"], covariance_px2: Float[np.ndarray, "*n 4 4"]
) -> Float[np.ndarray, "*n 2 2"]:
    """Covariance of the two ends' displacements along the normal of their line."""
    blocks = covariance_px2.reshape(*normal.shape[:-1], 2, 2, 2, 2)
    across = (blocks * normal[..., None, None, None, :]).sum(-1)
    return (across * normal[..., None, :, None]).sum(-2)


def block_size(lines: SegmentTable, block: BlockSize) -> int:
    """Rows to hand over at a time: fewer where pictures hold little."""
    return min(block.most, block.per_segment * lines.ends_px.shape[1])
