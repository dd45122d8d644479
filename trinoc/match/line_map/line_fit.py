"""The straight line in space that any number of segments show: maximum likelihood.

Each segment says where the line's image is at its two ends, across the segment, under its own
covariance; where it begins and ends says nothing about the line. What is unknown are the
distances of the line from a first estimate, at two places along it, in two directions: four.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Real segments err by more than they say: by one of these factors, in so many of cases. Smaller
# errors than stated are not assumed, so that no covariance is smaller than the segments' own says.
SCALES = np.array([1.0, 2.0, 4.0])
SHARES = np.array([0.85, 0.11, 0.04])
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


def fit_line(shown: LineFragments, near_mm: Float[np.ndarray, "2 3"]) -> LineFit:
    """The likeliest line near two points, of which it moves only across.

    Not finite where the segments do not determine a line.
    """
    ends, axes = near_mm, across_axes(near_mm[1] - near_mm[0])
    for _ in range(STEPS):
        error, by_offset, precision = _distances(shown, ends, axes)
        weight, _ = _weights(np.einsum("ni,nij,nj->n", error, precision, error))
        weighted = weight[:, None, None] * precision
        information = np.einsum("nia,nij,njb->ab", by_offset, weighted, by_offset)
        gradient = np.einsum("nia,nij,nj->a", by_offset, weighted, error)
        covariance = _inverse(information)
        ends = ends - (covariance @ gradient).reshape(2, 2) @ axes
    error, _, precision = _distances(shown, ends, axes)
    _, squares = _weights(np.einsum("ni,nij,nj->n", error, precision, error))
    spread = np.einsum("eafb,ai,bj->eifj", covariance.reshape(2, 2, 2, 2), axes, axes)
    return LineFit(ends, spread.reshape(6, 6), float(squares.sum()), 2 * len(error) - 4)


def across_axes(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Two unit vectors across a direction and each other."""
    unit = direction / np.linalg.norm(direction)
    first = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(unit, first)])


def _inverse(information: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    try:
        return np.linalg.inv(information)
    except np.linalg.LinAlgError:
        return np.full((4, 4), np.nan)


def _weights(squares: Float[np.ndarray, "n"]) -> tuple[np.ndarray, np.ndarray]:
    """(weight of each segment, minus twice the log of its likelihood against no error at all).

    The weight is the mean of one over the factors squared, given the error; `squares` are
    Mahalanobis distances of two numbers.
    """
    density = SHARES / SCALES**2
    terms = density * np.exp(-0.5 * squares[:, None] / SCALES**2)
    # Far out only the widest is left, and even that underflows.
    terms[:, -1] += np.finfo(float).tiny
    total = terms.sum(axis=1)
    return (terms / SCALES**2).sum(axis=1) / total, -2 * np.log(total / density.sum())


def _distances(
    shown: LineFragments, ends_mm: Float[np.ndarray, "2 3"], axes: Float[np.ndarray, "2 3"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 4"], Float[np.ndarray, "n 2 2"]]:
    """(distance of each segment's ends from the line's image, its derivative by the offsets of
    the line's two points along the two axes, inverse of its covariance)."""
    matrix = shown.matrix_px
    image = ends_mm @ matrix[:, :, :3].mT + matrix[:, None, :, 3]
    moved = axes @ matrix[:, :, :3].mT
    line = _cross(image[:, 0], image[:, 1])
    steepness = np.hypot(line[:, 0], line[:, 1])
    normal = line[:, :2] / steepness[:, None]
    homogeneous = np.concatenate([shown.ends_px, np.ones((len(matrix), 2, 1))], axis=2)
    error = np.einsum("nek,nk->ne", homogeneous, line) / steepness[:, None]
    by_first = _cross(moved, image[:, None, 1])
    by_second = _cross(image[:, None, 0], moved)
    by_offset = np.concatenate([by_first, by_second], axis=1)
    jacobian = np.einsum("nek,nok->neo", homogeneous, by_offset) / steepness[:, None, None]
    blocks = shown.covariance_px2.reshape(-1, 2, 2, 2, 2)
    spread = np.einsum("ni,neifj,nj->nef", normal, blocks, normal)
    return error, jacobian, np.linalg.inv(spread)


def _cross(first: Float[np.ndarray, "*n 3"], second: Float[np.ndarray, "*m 3"]) -> np.ndarray:
    # For a few rows, np.cross takes ten times as long.
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    d, e, f = second[..., 0], second[..., 1], second[..., 2]
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d], axis=-1)
