"""Corners: points in space where ends of lines meet."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int


class Corners(eqx.Module):
    """Where lines meet, and the lines carried there.

    `corner`, `line` and `end` are one table with a row for each end at each corner.

    Fields
    ------
    points_mm : (j, 3) the likeliest point common to the lines that meet.
    covariance_mm2 : (j, 3, 3) of it.
    chi_square, degrees : (j,) how well the lines pass through one point, and the degrees of
        freedom, 2 k - 3 for k lines.
    corner, line, end : (m,) number of the corner, of the line, and its end, 0 or 1.
    lines_mm : (e, 2, 3) all lines, those that meet with their ends at the corners.
    lines_covariance_mm2 : (e, 6, 6) of these ends, given that they meet.
    """

    points_mm: Float[np.ndarray, "j 3"]
    covariance_mm2: Float[np.ndarray, "j 3 3"]
    chi_square: Float[np.ndarray, "j"]
    degrees: Int[np.ndarray, "j"]
    corner: Int[np.ndarray, "m"]
    line: Int[np.ndarray, "m"]
    end: Int[np.ndarray, "m"]
    lines_mm: Float[np.ndarray, "e 2 3"]
    lines_covariance_mm2: Float[np.ndarray, "e 6 6"]

    def __len__(self) -> int:
        return len(self.points_mm)
