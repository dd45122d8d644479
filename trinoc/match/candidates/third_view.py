"""What a pair of segments predicts in a third view: epipolar transfer of their common part."""

from itertools import combinations
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.projection import pixel_change
from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.candidates import CandidateTuning
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.two_view.epipolar_pencil import (
    Pencil,
    PencilSegments,
    cut_pair,
    pencil,
)
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.vectors import (
    Scalar,
    Vector3,
    add3,
    cross3,
    dot3,
    interpolated_covariance,
    scaled3,
    times_matrix,
    unit3,
    vector3,
)


class Prediction(NamedTuple):
    """The image, in a third view, of the part common to a pair of segments.

    possible : whether the pair can be one line in space, and is the one to predict from.
    u0, v0, u1, v1 : ends in undistorted pixels.
    c00, c01, c11 : covariance of the two ends across the image, px^2.
    """

    possible: Bool[ArrayLike, "*p"]
    u0: Float[ArrayLike, "*p"]
    v0: Float[ArrayLike, "*p"]
    u1: Float[ArrayLike, "*p"]
    v1: Float[ArrayLike, "*p"]
    c00: Float[ArrayLike, "*p"]
    c01: Float[ArrayLike, "*p"]
    c11: Float[ArrayLike, "*p"]


class ThirdView(NamedTuple):
    """How a third view sees the planes of a pencil; of each frame of a stack.

    turned : homogeneous pixels of a direction in the pencil's frame. origin : those of its origin.
    """

    turned: Float[ArrayLike, "*f 3 3"]
    origin: Float[ArrayLike, "*f 3"]
    baseline_mm: Float[ArrayLike, "*f"]
    size_px: Float[ArrayLike, "*f 2"]


def third_view(lines: SegmentTable, planes: Pencil, third: Int[ArrayLike, ""] | int) -> ThirdView:
    """The `third` view of a pencil."""
    xp = array_namespace(lines, planes, third)
    matrix, size_px = xp.asarray(lines.matrix_px), xp.asarray(lines.size_px)
    left = matrix[..., third, :, :3]
    origin = (left @ planes.origin_mm[..., None])[..., 0] + matrix[..., third, :, 3]
    return ThirdView(left @ planes.frame.mT, origin, planes.baseline_mm, size_px[..., third, :])


def predict(
    view: ThirdView,
    a: PencilSegments,
    b: PencilSegments,
    tuning: CandidateTuning = DEFAULT.candidates,
    any_order: Bool[ArrayLike, ""] | bool = False,
) -> Prediction:
    """What a segment of the first and one of the second view of a pencil predict in the third; in
    `any_order`, also where another pair of the three crosses better, if this one predicts well."""
    part = cut_pair(view.baseline_mm, a, b, tuning)
    turned, origin = view.turned, vector3(view.origin)
    image_low, image_high = (
        add3(times_matrix(turned, at[:3]), origin, at[3]) for at in (part.at_low, part.at_high)
    )
    (u0, v0), (u1, v1) = (
        (image[0] / image[2], image[1] / image[2]) for image in (image_low, image_high)
    )
    length = jnp.sqrt((u1 - u0) ** 2 + (v1 - v0) ** 2)
    nu, nv = -(v1 - v0) / length, (u1 - u0) / length

    # How far a unit of slope, in either view, moves the image across itself.
    by_b = scaled3(origin, -1 / view.baseline_mm)
    by_a = add3(vector3(turned[:, 0]), by_b, -1.0)

    def effect(by: Vector3, image: Vector3, u: Scalar, v: Scalar) -> Scalar:
        du, dv = pixel_change((u, v), image[2], by)
        return nu * du + nv * dv

    def covariance(s: PencilSegments, by: Vector3) -> tuple[Scalar, Scalar, Scalar]:
        at_low = (part.low - s.low) / (s.high - s.low)
        at_high = (part.high - s.low) / (s.high - s.low)
        low, high = effect(by, image_low, u0, v0), effect(by, image_high, u1, v1)
        return (
            low * low * interpolated_covariance(s.slope_variance, at_low, at_low),
            low * high * interpolated_covariance(s.slope_variance, at_low, at_high),
            high * high * interpolated_covariance(s.slope_variance, at_high, at_high),
        )

    c00, c01, c11 = add3(covariance(a, by_a), covariance(b, by_b))
    possible = part.possible & (image_low[2] > 0) & (image_high[2] > 0)
    width, height = view.size_px[0], view.size_px[1]
    outside = tuning.outside_share
    middle_u, middle_v = (u0 + u1) / 2, (v0 + v1) / 2
    possible &= (middle_u > -outside * width) & (middle_u < (1 + outside) * width)
    possible &= (middle_v > -outside * height) & (middle_v < (1 + outside) * height)
    # The angle at which the pair's planes cross would not do in place of the uncertainty: it is
    # small for any pair with a short baseline.
    possible &= c00 + c11 < tuning.vaguest_px**2
    turn = c00 + c11 - 2 * c01
    well = (c00 + c11 < tuning.well_known_px**2) & (turn < (tuning.well_known_rad * length) ** 2)
    best = _crosses_best(turned, image_low, image_high, a, b, tuning)
    possible &= best | (any_order & well)
    return Prediction(possible, u0, v0, u1, v1, c00, c01, c11)


def _crosses_best(
    turned: Float[ArrayLike, "3 3"],
    image_low: Vector3,
    image_high: Vector3,
    a: PencilSegments,
    b: PencilSegments,
    tuning: CandidateTuning,
) -> Bool[ArrayLike, ""]:
    """Whether the interpretation planes of the pair cross at the widest angle of the three."""
    normal_c = unit3(times_matrix(turned.T, cross3(image_low, image_high)))
    across = [cross3(*both) for both in combinations((a.normal, b.normal, normal_c), 2)]
    sine_ab, sine_ac, sine_bc = (dot3(normal, normal) for normal in across)
    best = jnp.maximum(sine_ac, sine_bc)
    return sine_ab > tuning.nearly_best**2 * best


# numerical: rounding errors of a few operations, relative to their largest term.
ROUNDING = 4 * float(np.finfo(np.float64).eps)


class PredictionInput(NamedTuple):
    """Two views that predict and a third.

    first, second : the segments in the pencil of the first two views. view : the third.
    ends_px, line, across_px2 : of the third view's segments, a row each, in this order.
    frame : of a stack, the frame of each segment of the first view.
    """

    first: PencilSegments
    second: PencilSegments
    view: ThirdView
    segments: Float[ArrayLike, "n 11"]
    frame: Int[ArrayLike, "n"] | None


def prepare_order(
    lines: SegmentTable, order: Int[np.ndarray, "3"]
) -> tuple[Pencil, PredictionInput]:
    """(the pencil of the first two views of an order, what predictions in the third need of it)."""
    first, second, third = order.tolist()
    planes = pencil(lines, first, second)
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
    return planes, PredictionInput(
        _with_rounding(planes.first),
        _with_rounding(planes.second),
        third_view(lines, planes, third),
        segments,
        None if frame is None else frame[first],
    )


def _with_rounding(segments: PencilSegments) -> PencilSegments:
    return segments.with_slope_error((ROUNDING * (abs(segments.p) + abs(segments.q))) ** 2)


def rounding_px(
    matrix_px: Float[ArrayLike, "*f v 3 4"], view: Int[ArrayLike, ""] | int
) -> Float[ArrayLike, "*f"]:
    """Rounding error of places in a view, in pixels; of each frame of a stack."""
    return ROUNDING * abs(matrix_px[..., view, :2, :3]).sum(axis=(-2, -1))
