"""What finds candidates, in single precision: half the memory, and twice as fast.

The gate in the third view only looks for what may fit; the evidence, in double precision, decides.
So the gate has to pass all that double precision would: rounding errors are added to the errors of
the segments, some ten thousandths of a pixel to some tenths.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates.transfer import ThirdView, third_view
from trinoc.match.observations import SegmentTable
from trinoc.match.two_view import Pencil, PencilSegments, pencil
from trinoc.numerics import ArrayLike

# Rounding errors of a few operations, relative to their largest term.
ROUNDING = 4 * float(np.finfo(np.float32).eps)


class SingleOrder(NamedTuple):
    """Two views that predict and a third, in single precision.

    first, second : the segments in the pencil of the first two views. view : the third.
    ends_px, line, across_px2 : of the third view's segments, a row each, in this order.
    frame : of a stack, the frame of each segment of the first view.
    """

    first: PencilSegments
    second: PencilSegments
    view: ThirdView
    segments: Float[ArrayLike, "n 11"]
    frame: Int[ArrayLike, "n"] | None


def prepared_order(lines: SegmentTable, order: Int[np.ndarray, "3"]) -> tuple[Pencil, SingleOrder]:
    """(the pencil of the first two views of an order, what single precision needs of it)."""
    first, second, third = order.tolist()
    planes = pencil(lines, first, second)
    return planes, _single_order(lines, planes, first, third)


def _single_order(lines: SegmentTable, planes: Pencil, first: int, third: int) -> SingleOrder:
    rounding, count = rounding_px(np.asarray(lines.matrix_px), third) ** 2, lines.ends_px.shape[1]
    frame = None if lines.frame is None else np.asarray(lines.frame)
    if frame is not None:
        rounding = rounding[frame[third]]
    own = np.broadcast_to(rounding, count)[:, None, None] * np.eye(2)
    ends, line, across = (
        np.asarray(column)[third] for column in (lines.ends_px, lines.line, lines.across_px2)
    )
    of_third = (ends, line, across + own)
    segments = np.concatenate([column.reshape(count, -1) for column in of_third], axis=1)
    single = SingleOrder(
        _with_rounding(planes.first),
        _with_rounding(planes.second),
        third_view(lines, planes, third),
        segments,
        None if frame is None else frame[first],
    )
    return jax.tree.map(in_single, single)


def in_single(column: ArrayLike) -> np.ndarray:
    """Numbers in single precision, and integers as they are."""
    column = np.asarray(column)
    return column.astype(np.float32) if np.issubdtype(column.dtype, np.floating) else column


def _with_rounding(segments: PencilSegments) -> PencilSegments:
    return segments.with_slope_error((ROUNDING * (abs(segments.p) + abs(segments.q))) ** 2)


def rounding_px(
    matrix_px: Float[ArrayLike, "*f v 3 4"], view: Int[ArrayLike, ""] | int
) -> Float[ArrayLike, "*f"]:
    """Rounding error of places in a view, in pixels; of each frame of a stack."""
    return ROUNDING * abs(matrix_px[..., view, :2, :3]).sum(axis=(-2, -1))
