"""A pair of segments cut to the part that both see, and what it predicts in a third view."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool

from trinoc.match.tuning import CandidateTuning
from trinoc.match.two_view.epipolar_pencil import Pencil
from trinoc.match.two_view.pencil_segments import PencilSegments
from trinoc.numerics import ArrayLike, Scalar, Vector3, add3, scaled3, times_matrix, vector3


class CommonPart(NamedTuple):
    """Where the planes of a pencil bound what both segments show.

    at_low, at_high : (slope in the first view, cos, sin, 1 / radius) on both bounding planes.
    possible : whether there is a common part, in front of both cameras.
    """

    low: Scalar
    high: Scalar
    at_low: tuple[Scalar, Scalar, Scalar, Scalar]
    at_high: tuple[Scalar, Scalar, Scalar, Scalar]
    possible: Bool[ArrayLike, "..."]


def cut_pair(
    baseline_mm: Scalar, a: PencilSegments, b: PencilSegments, tuning: CandidateTuning
) -> CommonPart:
    """Cut one segment of either view so that their ends correspond."""
    low, high = jnp.maximum(a.low, b.low), jnp.minimum(a.high, b.high)
    shorter = jnp.minimum(a.high - a.low, b.high - b.low)
    a_begins, a_ends = a.low > b.low, a.high < b.high

    def on_plane(cosine: Scalar, sine: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        slope = a.p * cosine + a.q * sine
        return slope, cosine, sine, (slope - b.p * cosine - b.q * sine) / baseline_mm

    at_low = on_plane(
        jnp.where(a_begins, a.cosine_low, b.cosine_low), jnp.where(a_begins, a.sine_low, b.sine_low)
    )
    at_high = on_plane(
        jnp.where(a_ends, a.cosine_high, b.cosine_high), jnp.where(a_ends, a.sine_high, b.sine_high)
    )
    possible = (high - low > tuning.smallest_overlap * shorter) & (at_low[3] > 0) & (at_high[3] > 0)
    return CommonPart(low, high, at_low, at_high, possible)


def points_of(planes: Pencil, part: CommonPart) -> tuple[Vector3, Vector3]:
    """Ends in space, world frame, of the common part of a pair."""

    def point(at: tuple[Scalar, Scalar, Scalar, Scalar]) -> Vector3:
        in_frame = scaled3(at[:3], 1 / at[3])
        return add3(vector3(planes.origin_mm), times_matrix(planes.frame.mT, in_frame))

    return point(part.at_low), point(part.at_high)
