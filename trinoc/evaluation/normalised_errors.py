"""Do the errors have the size that their covariance claims?"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.evaluation.lines_on_edges import OffsetsAcross
from trinoc.numerics.tails import chi_square_quantile

NUMBERS_PER_LINE = 4
WITHIN_SIGMAS = 1.96
_MEDIAN = float(chi_square_quantile(0.5, NUMBERS_PER_LINE))
_LARGEST_95 = float(chi_square_quantile(0.95, NUMBERS_PER_LINE))


class NormalisedErrors(NamedTuple):
    """Errors across in units of what the covariance claims; NaN where nothing is claimed.

    Each line has four: its offset across the edge in two directions at two ends, along the
    principal axes of their covariance. True claims make them numbers of a normal distribution.

    Fields
    ------
    lines : how many lines are in.
    variance : mean square; 1 where the claims are true. A few wrong matches raise it.
    spread : by how much the claims are too small, from the median line, which a few wrong ones do
        not move: 1 where the claims are true.
    share_within : of the four numbers of all lines within 1.96 sigma; 0.95 where they are true.
    share_of_lines : of lines whose chi-square is below its 95 % quantile.
    """

    lines: int
    variance: float
    spread: float
    share_within: float
    share_of_lines: float


def normalised_errors(
    offsets: OffsetsAcross, parameter_covariance: Float[np.ndarray, "k k"]
) -> NormalisedErrors:
    """Offsets against the covariance that is each line's own and the one that the cameras share."""
    errors = errors_in_sigmas(offsets, parameter_covariance)
    claimed = np.isfinite(errors).all(axis=1)
    if not claimed.any():
        return NormalisedErrors(0, *[float("nan")] * 4)
    errors = errors[claimed]
    chi_square = np.sum(errors**2, axis=1)
    return NormalisedErrors(
        lines=len(errors),
        variance=float(np.mean(errors**2)),
        spread=float(np.sqrt(np.median(chi_square) / _MEDIAN)),
        share_within=float(np.mean(np.abs(errors) < WITHIN_SIGMAS)),
        share_of_lines=float(np.mean(chi_square < _LARGEST_95)),
    )


def errors_in_sigmas(
    offsets: OffsetsAcross, parameter_covariance: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, "n 4"]:
    """The four numbers of each line, in sigmas along the principal axes of its covariance; NaN
    where none is claimed."""
    by = offsets.by_parameters
    variances, axes = np.linalg.eigh(offsets.own_mm2 + by @ parameter_covariance @ by.mT)
    claimed = variances[:, :1] > 0
    along_axes = np.einsum("nia,ni->na", axes, offsets.offset_mm)
    return np.where(claimed, along_axes / np.sqrt(np.where(claimed, variances, 1.0)), np.nan)
