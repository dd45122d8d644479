"""Length and standard deviations of 3-D segments, from the covariance of their ends."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike


class LineSigmas(NamedTuple):
    """Lengths of t 3-D segments, with standard deviations of lengths and positions, mm.

    Attributes
    ----------
    length_mm : (t,)
        Distance between the two ends.
    length_sigma_mm : (t,)
        Standard deviation of the length.
    across_sigma_mm : (t,)
        Standard deviation of the midpoint in the worst direction perpendicular to the segment.
    ends_sigma_mm : (t, 2, 3)
        Standard deviation of each end along X, Y and Z.
    """

    length_mm: Float[np.ndarray, "t"]
    length_sigma_mm: Float[np.ndarray, "t"]
    across_sigma_mm: Float[np.ndarray, "t"]
    ends_sigma_mm: Float[np.ndarray, "t 2 3"]


def line_sigmas(
    lines_mm: Float[ArrayLike, "t 2 3"], covariance_mm2: Float[ArrayLike, "t 6 6"]
) -> LineSigmas:
    """Compute lengths, and standard deviations of lengths, midpoints and ends, to first order.

    Parameters
    ----------
    lines_mm : (t, 2, 3)
        Ends of the segments in the world frame.
    covariance_mm2 : (t, 6, 6)
        Covariance of both ends of each segment; NaN if unknown.

    Returns
    -------
    LineSigmas
        Standard deviations are NaN where the covariance is NaN or the length is 0.
    """
    ends, covariance = np.asarray(lines_mm), np.asarray(covariance_mm2)
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        direction = along / length[:, None]
    jacobian = np.concatenate([-direction, direction], axis=1)
    length_variance = np.einsum("ti,tij,tj->t", jacobian, covariance, jacobian)
    blocks = covariance.reshape(-1, 2, 3, 2, 3)
    midpoint = blocks.sum(axis=(1, 3)) / 4
    project = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    across = project @ midpoint @ project
    finite = np.isfinite(across).all(axis=(1, 2))
    largest = np.full(len(ends), np.nan)
    largest[finite] = np.linalg.eigvalsh(across[finite])[:, -1]
    diagonal = np.diagonal(covariance, axis1=1, axis2=2).reshape(-1, 2, 3)
    with np.errstate(invalid="ignore"):
        return LineSigmas(length, np.sqrt(length_variance), np.sqrt(largest), np.sqrt(diagonal))
