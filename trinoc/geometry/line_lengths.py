"""What the covariance of segments in space says about what people ask for."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike


class LineSigmas(NamedTuple):
    """Lengths of segments and standard deviations, in mm.

    `across_sigma_mm` is that of the segment's midpoint in the worst direction across it;
    `ends_sigma_mm` (t, 2, 3) that of each end along X, Y and Z.
    """

    length_mm: Float[np.ndarray, "t"]
    length_sigma_mm: Float[np.ndarray, "t"]
    across_sigma_mm: Float[np.ndarray, "t"]
    ends_sigma_mm: Float[np.ndarray, "t 2 3"]


def line_sigmas(
    lines_mm: Float[ArrayLike, "t 2 3"], covariance_mm2: Float[ArrayLike, "t 6 6"]
) -> LineSigmas:
    """First-order propagation of the covariance of both ends to length and midpoint."""
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
