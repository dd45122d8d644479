"""The four parameters of a line in space from what all its views say of its images."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.geometry import distances_from_line
from trinoc.numerics import Residuals, gauss_newton, whitening

_STEPS = 4


class LineFit(NamedTuple):
    """Fields
    ------
    move_mm : (t, 4) of the first end, then of the last, along the two axes across the line.
    covariance_mm2 : (t, 4, 4) of these, NaN of lines that the views do not determine.
    misfit : (t,) chi-square by which the views disagree.
    """

    move_mm: Float[np.ndarray, "t 4"]
    covariance_mm2: Float[np.ndarray, "t 4 4"]
    misfit: Float[np.ndarray, "t"]


def fit_lines(
    matrices_px: Float[np.ndarray, "v 3 4"],
    ends_mm: Float[np.ndarray, "t 2 3"],
    axes: Float[np.ndarray, "t 2 3"],
    places_px: Float[np.ndarray, "t v 2 2"],
    covariance_px2: Float[np.ndarray, "t v 2 2"],
    seen: Float[np.ndarray, "t v"],
) -> LineFit:
    """Lines whose images go through places, known to this across; views that see none count 0."""
    count = len(ends_mm)
    matrices = np.broadcast_to(matrices_px, (count, *matrices_px.shape))
    white = whitening(covariance_px2)

    def lines_at(move: Float[np.ndarray, "t 4"]) -> Float[np.ndarray, "t 2 3"]:
        return ends_mm + move.reshape(count, 2, 2) @ axes

    def residuals(move: Float[np.ndarray, "t 4"]) -> Residuals:
        found = distances_from_line(matrices, lines_at(move)[:, None], places_px)
        by_move = np.einsum("tvpei,tai->tvpea", found.by_ends, axes).reshape(*white.shape[:3], 4)
        distance = (white @ found.distance_px[..., None])[..., 0]
        return Residuals(distance, white @ by_move, seen)

    move, equations = gauss_newton(residuals, np.add, np.zeros((count, 4)), steps=_STEPS)
    return LineFit(move, equations.covariance(), equations.chi_square)
