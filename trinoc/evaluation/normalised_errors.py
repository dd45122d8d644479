"""Normalised errors: errors across lines divided by their reported sigma."""

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
    """Statistics of normalised errors (errors divided by sigma) of lines; NaN without a covariance.

    Each line has four errors: the offset from its edge, in two directions at two ends, along the
    principal axes of the offsets' covariance. If the covariance is right, they are standard normal.

    Attributes
    ----------
    lines : int
        Number of lines with a covariance.
    variance : float
        Mean square of the errors; 1 if the covariance is right. A few wrong matches raise it.
    spread : float
        Robust ratio of true to reported sigma, from the median chi-square; 1 if the covariance is
        right.
    share_within : float
        Share of the errors within 1.96 sigma; 0.95 if the covariance is right.
    share_of_lines : float
        Share of lines whose chi-square is below the 95 % quantile of its distribution; 0.95 if the
        covariance is right.
    """

    lines: int
    variance: float
    spread: float
    share_within: float
    share_of_lines: float


def normalised_errors(
    offsets: OffsetsAcross, parameter_covariance: Float[np.ndarray, "k k"]
) -> NormalisedErrors:
    """Compute statistics of the offsets divided by their sigma.

    `parameter_covariance` is the covariance of the camera parameters. It contributes to the
    covariance of the offsets, together with the noise of the fragments.
    """
    errors = errors_in_sigmas(offsets, parameter_covariance)
    has_covariance = np.isfinite(errors).all(axis=1)
    if not has_covariance.any():
        return NormalisedErrors(0, *[float("nan")] * 4)
    errors = errors[has_covariance]
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
    """Errors of each line in sigmas, along the principal axes of its offsets' covariance, (n, 4).

    NaN for lines without a covariance.
    """
    by = offsets.by_parameters
    variances, axes = np.linalg.eigh(
        offsets.fragment_covariance_mm2 + by @ parameter_covariance @ by.mT
    )
    has_covariance = variances[:, :1] > 0
    along_axes = np.einsum("nia,ni->na", axes, offsets.offset_mm)
    return np.where(
        has_covariance, along_axes / np.sqrt(np.where(has_covariance, variances, 1.0)), np.nan
    )
