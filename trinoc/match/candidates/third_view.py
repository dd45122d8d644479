"""Predict the image of a pair of segments in a third view: epipolar transfer of their common
part.
"""

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
    build_pencil,
    cut_pair,
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
    """Predicted segments in a third view, each from one pair of segments of two other views.

    Attributes
    ----------
    possible : (p,)
        False for pairs that cannot be one line. False also for pairs that are not used, because
        another pair of the same three segments gives a better prediction.
    u0, v0, u1, v1 : (p,)
        Ends of the predicted segment, undistorted pixels.
    c00, c01, c11 : (p,)
        Variances and covariance of the two ends across the predicted segment, px^2.
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
    """Projection from the frame of a pencil of epipolar planes into a third view.

    The pencil is that of the other two views.

    In a stack of frames, all attributes have a leading axis of frames.

    Attributes
    ----------
    direction_matrix : (3, 3)
        Matrix from a direction in the pencil's frame to homogeneous pixels.
    origin : (3,)
        Homogeneous pixel of the pencil's origin, the centre of its first view.
    baseline_mm : ()
        Distance of the camera centres of the pencil.
    size_px : (2,)
        Width and height of the third view's image.
    """

    direction_matrix: Float[ArrayLike, "*f 3 3"]
    origin: Float[ArrayLike, "*f 3"]
    baseline_mm: Float[ArrayLike, "*f"]
    size_px: Float[ArrayLike, "*f 2"]


def third_view(lines: SegmentTable, pencil: Pencil, third: Int[ArrayLike, ""] | int) -> ThirdView:
    """Build the projection from the frame of an epipolar pencil into the view with index `third`.

    `pencil` contains the epipolar planes of the two other views.
    """
    xp = array_namespace(lines, pencil, third)
    matrix, size_px = xp.asarray(lines.matrix_px), xp.asarray(lines.size_px)
    left_block = matrix[..., third, :, :3]
    origin = (left_block @ pencil.origin_mm[..., None])[..., 0] + matrix[..., third, :, 3]
    return ThirdView(
        left_block @ pencil.frame.mT, origin, pencil.baseline_mm, size_px[..., third, :]
    )


def predict(
    view: ThirdView,
    a: PencilSegments,
    b: PencilSegments,
    tuning: CandidateTuning = DEFAULT.candidates,
    any_order: Bool[ArrayLike, ""] | bool = False,
) -> Prediction:
    """Predict the segment of the third view that corresponds to one segment in each of two views.

    A prediction is possible only if the interpretation planes of `a` and `b` cross at nearly the
    widest angle of the three planes. With `any_order`, other pairs predict too if their prediction
    is precise.
    """
    part = cut_pair(view.baseline_mm, a, b, tuning)
    direction_matrix, origin = view.direction_matrix, vector3(view.origin)
    image_low, image_high = (
        add3(times_matrix(direction_matrix, bounding_plane[:3]), origin, bounding_plane[3])
        for bounding_plane in (part.at_low, part.at_high)
    )
    (u0, v0), (u1, v1) = (
        (image[0] / image[2], image[1] / image[2]) for image in (image_low, image_high)
    )
    length = jnp.sqrt((u1 - u0) ** 2 + (v1 - v0) ** 2)
    nu, nv = -(v1 - v0) / length, (u1 - u0) / length

    # Displacement of the image across itself per unit of slope in either view.
    by_b = scaled3(origin, -1 / view.baseline_mm)
    by_a = add3(vector3(direction_matrix[:, 0]), by_b, -1.0)

    def effect(slope_effect: Vector3, image: Vector3, u: Scalar, v: Scalar) -> Scalar:
        du, dv = pixel_change((u, v), image[2], slope_effect)
        return nu * du + nv * dv

    def covariance(s: PencilSegments, slope_effect: Vector3) -> tuple[Scalar, Scalar, Scalar]:
        at_low = (part.low - s.low) / (s.high - s.low)
        at_high = (part.high - s.low) / (s.high - s.low)
        low = effect(slope_effect, image_low, u0, v0)
        high = effect(slope_effect, image_high, u1, v1)
        return (
            low * low * interpolated_covariance(s.slope_variance, at_low, at_low),
            low * high * interpolated_covariance(s.slope_variance, at_low, at_high),
            high * high * interpolated_covariance(s.slope_variance, at_high, at_high),
        )

    c00, c01, c11 = add3(covariance(a, by_a), covariance(b, by_b))
    possible = part.possible & (image_low[2] > 0) & (image_high[2] > 0)
    width, height = view.size_px[0], view.size_px[1]
    margin_share = tuning.outside_share
    middle_u, middle_v = (u0 + u1) / 2, (v0 + v1) / 2
    possible &= (middle_u > -margin_share * width) & (middle_u < (1 + margin_share) * width)
    possible &= (middle_v > -margin_share * height) & (middle_v < (1 + margin_share) * height)
    # A limit on the crossing angle of the planes would exclude all pairs with a short baseline, so
    # the limit is on the uncertainty of the prediction.
    possible &= c00 + c11 < tuning.max_prediction_sigma_px**2
    direction_variance = c00 + c11 - 2 * c01
    is_precise = (c00 + c11 < tuning.precise_px**2) & (
        direction_variance < (tuning.precise_rad * length) ** 2
    )
    crosses_best = _crosses_best(direction_matrix, image_low, image_high, a, b, tuning)
    possible &= crosses_best | (any_order & is_precise)
    return Prediction(possible, u0, v0, u1, v1, c00, c01, c11)


def _crosses_best(
    direction_matrix: Float[ArrayLike, "3 3"],
    image_low: Vector3,
    image_high: Vector3,
    a: PencilSegments,
    b: PencilSegments,
    tuning: CandidateTuning,
) -> Bool[ArrayLike, ""]:
    """True if the planes of `a` and `b` cross at nearly the widest angle of the three planes.

    The third interpretation plane is that of the predicted segment in the third view.
    """
    normal_c = unit3(times_matrix(direction_matrix.T, cross3(image_low, image_high)))
    crossings = [cross3(*both) for both in combinations((a.normal, b.normal, normal_c), 2)]
    sine_ab, sine_ac, sine_bc = (dot3(normal, normal) for normal in crossings)
    best_sine = jnp.maximum(sine_ac, sine_bc)
    return sine_ab > tuning.min_crossing_share**2 * best_sine


# numerical: relative rounding error of a few operations.
ROUNDING = 4 * float(np.finfo(np.float64).eps)


class PredictionInput(NamedTuple):
    """Data for predictions from two views in a third view.

    Attributes
    ----------
    first, second : PencilSegments
        Segments of the first two views in their pencil of epipolar planes.
    view : ThirdView
        Projection from the frame of the pencil into the third view.
    segments : (n, 11)
        Segments of the third view. A row contains ends_px (4), line (3) and across_px2 (4).
    frame : (n,) or None
        Frame of each segment of the first view in a stack.
    """

    first: PencilSegments
    second: PencilSegments
    view: ThirdView
    segments: Float[ArrayLike, "n 11"]
    frame: Int[ArrayLike, "n"] | None


def prepare_order(
    lines: SegmentTable, order: Int[np.ndarray, "3"]
) -> tuple[Pencil, PredictionInput]:
    """Build the pencil of the first two views of an ordering, and the data of its predictions."""
    first, second, third = order.tolist()
    pencil_of_pair = build_pencil(lines, first, second)
    rounding_variance = rounding_px(np.asarray(lines.matrix_px), third) ** 2
    count = lines.ends_px.shape[1]
    frame = None if lines.frame is None else np.asarray(lines.frame)
    if frame is not None:
        rounding_variance = rounding_variance[frame[third]]
    rounding_px2 = np.broadcast_to(rounding_variance, count)[:, None, None] * np.eye(2)
    ends, line, across = (
        np.asarray(column)[third] for column in (lines.ends_px, lines.line, lines.across_px2)
    )
    columns = (ends, line, across + rounding_px2)
    segments = np.concatenate([column.reshape(count, -1) for column in columns], axis=1)
    return pencil_of_pair, PredictionInput(
        _with_rounding(pencil_of_pair.first),
        _with_rounding(pencil_of_pair.second),
        third_view(lines, pencil_of_pair, third),
        segments,
        None if frame is None else frame[first],
    )


def _with_rounding(segments: PencilSegments) -> PencilSegments:
    return segments.with_slope_error((ROUNDING * (abs(segments.p) + abs(segments.q))) ** 2)


def rounding_px(
    matrix_px: Float[ArrayLike, "*f v 3 4"], view: Int[ArrayLike, ""] | int
) -> Float[ArrayLike, "*f"]:
    """Return the error of pixel coordinates in a view due to floating-point rounding, px.

    In a stack of frames, the result has one value for each frame.
    """
    return ROUNDING * abs(matrix_px[..., view, :2, :3]).sum(axis=(-2, -1))
