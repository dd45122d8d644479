"""The circles found in one picture, as an array of fixed length with a mask in its weights."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection import Detection
from trinoc.calib.targets import Pattern
from trinoc.numerics import ArrayLike

SMALLEST_BUCKET = 32


class CircleObservations(NamedTuple):
    """Circles of the sheet and the centres of their images; unused rows have zero whitening.

    `whitening` (n, 2, 2) turns an error of a centre in pixels into unit variance: it is the
    transposed Cholesky factor of the inverse covariance.
    """

    centres_sheet_mm: Float[ArrayLike, "n 2"]
    radius_mm: Float[ArrayLike, "n"]
    centres_px: Float[ArrayLike, "n 2"]
    whitening: Float[ArrayLike, "n 2 2"]
    lines_px: Float[ArrayLike, "2 3"]


def bucket_size(count: int) -> int:
    """The smallest padded length for `count` rows: a power of two, so that few programs exist."""
    return max(SMALLEST_BUCKET, 1 << max(count - 1, 0).bit_length())


def circle_observations(
    detection: Detection, pattern: Pattern, size: int, used: Bool[np.ndarray, "m"] | None = None
) -> CircleObservations:
    """The circles of a detection, padded to `size` rows; those not `used` have no weight."""
    count, index = len(detection), detection.circle_index
    # A padded circle of radius 0 has no boundary for a lens to bend: give it one.
    centres, radius = np.zeros((size, 2)), np.ones(size)
    observed, whitening = np.zeros((size, 2)), np.zeros((size, 2, 2))
    centres[:count], radius[:count] = pattern.centres_mm[index], pattern.radius_mm[index]
    observed[:count] = detection.centres_px
    whitening[:count] = whitening_of_covariance(detection.covariance_px2)
    if used is not None:
        whitening[:count][~used] = 0.0
    return CircleObservations(centres, radius, observed, whitening, detection.lines_px)


def whitening_of_covariance(covariance: Float[np.ndarray, "m 2 2"]) -> Float[np.ndarray, "m 2 2"]:
    """W with W^T W the inverse of each covariance, in closed form."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    first = np.sqrt(a)
    slope = b / first
    second = np.sqrt(c - slope**2)
    whitening = np.zeros_like(covariance)
    whitening[:, 0, 0] = 1 / first
    whitening[:, 1, 0] = -slope / (first * second)
    whitening[:, 1, 1] = 1 / second
    return whitening


def stack_observations(items: Sequence[CircleObservations]) -> CircleObservations:
    """Many pictures along a new first axis."""
    return CircleObservations(*(np.stack(column) for column in zip(*items, strict=True)))
