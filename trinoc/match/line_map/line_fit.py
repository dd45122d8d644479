"""The straight line in space that any number of segments show: maximum likelihood.

Each segment says where the line's image is at its two ends, across the segment, under its own
covariance; where it begins and ends says nothing about the line. What is unknown are the
distances of the line from a first estimate, at two places along it, in two directions: four.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.match.tuning import DEFAULT, CollinearTuning
from trinoc.numerics import axes_across, cross_3d

# Gauss-Newton steps.
STEPS = 4


class LineFragments(NamedTuple):
    """Segments, or parts of them, that show one line, in undistorted pixels.

    matrix_px : projection matrix of the view of each. ends_px : its ends, of any order.
    covariance_px2 : of the ends.
    """

    matrix_px: Float[np.ndarray, "n 3 4"]
    ends_px: Float[np.ndarray, "n 2 2"]
    covariance_px2: Float[np.ndarray, "n 4 4"]


class LineFit(NamedTuple):
    """A line through two points abreast of those it was asked for.

    ends_mm : the points. covariance_mm2 : of the points across the line; along it they are
        as they were given. chi_square : of the segments, `degrees` its degrees of freedom;
        errors that the heavy tail explains count for less than their square.
    """

    ends_mm: Float[np.ndarray, "2 3"]
    covariance_mm2: Float[np.ndarray, "6 6"]
    chi_square: float
    degrees: int


def fit_line(
    shown: LineFragments,
    near_mm: Float[np.ndarray, "2 3"],
    tuning: CollinearTuning = DEFAULT.collinear,
) -> LineFit:
    """The likeliest line near two points, of which it moves only across.

    Not finite where the segments do not determine a line.
    """
    way = near_mm[1] - near_mm[0]
    ends, axes = near_mm, axes_across(way / np.linalg.norm(way))
    for _ in range(STEPS):
        error, by_offset, precision = distances_across(shown, ends, axes)
        weight, _ = _weights(np.einsum("ni,nij,nj->n", error, precision, error), tuning)
        weighted = weight[:, None, None] * precision
        information = np.einsum("nia,nij,njb->ab", by_offset, weighted, by_offset)
        gradient = np.einsum("nia,nij,nj->a", by_offset, weighted, error)
        covariance = _inverse(information)
        ends = ends - (covariance @ gradient).reshape(2, 2) @ axes
    error, _, precision = distances_across(shown, ends, axes)
    _, squares = _weights(np.einsum("ni,nij,nj->n", error, precision, error), tuning)
    spread = np.einsum("eafb,ai,bj->eifj", covariance.reshape(2, 2, 2, 2), axes, axes)
    return LineFit(ends, spread.reshape(6, 6), float(squares.sum()), 2 * len(error) - 4)


def _inverse(information: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    try:
        return np.linalg.inv(information)
    except np.linalg.LinAlgError:
        return np.full((4, 4), np.nan)


def _weights(
    squares: Float[np.ndarray, "n"], tuning: CollinearTuning
) -> tuple[np.ndarray, np.ndarray]:
    """(weight of each segment, minus twice the log of its likelihood against no error at all).

    The weight is the mean of one over the factors squared, given the error; `squares` are
    Mahalanobis distances of two numbers.
    """
    variance = np.array(tuning.error_scales) ** 2
    density = np.array(tuning.error_shares) / variance
    terms = density * np.exp(-0.5 * squares[:, None] / variance)
    # Far out only the widest is left, and even that underflows.
    terms[:, -1] += np.finfo(float).tiny
    total = terms.sum(axis=1)
    return (terms / variance).sum(axis=1) / total, -2 * np.log(total / density.sum())


def distances_across(
    shown: LineFragments, ends_mm: Float[np.ndarray, "2 3"], axes: Float[np.ndarray, "2 3"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 4"], Float[np.ndarray, "n 2 2"]]:
    """(distance of each segment's ends from the line's image, its derivative by the offsets of
    the line's two points along the two axes, inverse of its covariance)."""
    matrix = shown.matrix_px
    image = ends_mm @ matrix[:, :, :3].mT + matrix[:, None, :, 3]
    moved = axes @ matrix[:, :, :3].mT
    line = cross_3d(image[:, 0], image[:, 1])
    steepness = np.hypot(line[:, 0], line[:, 1])
    homogeneous = np.concatenate([shown.ends_px, np.ones((len(matrix), 2, 1))], axis=2)
    error = np.einsum("nek,nk->ne", homogeneous, line) / steepness[:, None]
    by_first = cross_3d(moved, image[:, None, 1])
    by_second = cross_3d(image[:, None, 0], moved)
    by_offset = np.concatenate([by_first, by_second], axis=1)
    jacobian = np.einsum("nek,nok->neo", homogeneous, by_offset) / steepness[:, None, None]
    blocks = shown.covariance_px2.reshape(-1, 2, 2, 2, 2)
    # Across the segment itself: along it an end that a plane cuts is not known at all, and of
    # that the line's own normal, a fraction of a degree away, would take in pixels.
    along = shown.ends_px[:, 1] - shown.ends_px[:, 0]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    spread = np.einsum("ni,neifj,nj->nef", normal, blocks, normal)
    return error, jacobian, np.linalg.inv(spread)
