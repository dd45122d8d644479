"""What the noise of the picture makes of a line's position."""

import numpy as np
from jaxtyping import Float

from trinoc.match.nevatia_babu.line_fit import FittedLines
from trinoc.match.nevatia_babu.masks import GradientKernel

# What the model leaves out even on a perfect edge: sampling, kernel shape, rounding.
MODEL_SIGMA_PX = 0.01


def variance_across(
    lines: FittedLines, length_px: Float[np.ndarray, "r"], sigma_grey: float, kernel: GradientKernel
) -> Float[np.ndarray, "r"]:
    """(r,) variance of a line's distance at its middle, from white noise of `sigma_grey`.

    The gradient's peak is displaced by (slope of the noise) / (curvature of the profile).
    Along the edge neighbouring points share noise; integrated over a length L much longer
    than the kernel s, the slope's variance is sigma^2 3 / (8 sqrt(pi) s^5 L), and a Gaussian
    profile of height m and variance S^2 has curvature m / S^2.
    """
    smoothing = np.sqrt(kernel.variance_px2)
    slope = sigma_grey**2 * 3 / (8 * np.sqrt(np.pi) * smoothing**5 * np.maximum(length_px, 1.0))
    return slope * lines.variance_px2**2 / lines.strength**2 + MODEL_SIGMA_PX**2


def end_covariances(
    direction: Float[np.ndarray, "r 2"],
    variance_middle: Float[np.ndarray, "r"],
    sigma_along_px: Float[np.ndarray, "r 2"],
) -> Float[np.ndarray, "r 4 4"]:
    """(r, 4, 4) covariance of the ends (u1, v1, u2, v2).

    A line fitted to points spread evenly over its length L has an angle of variance
    12 / L^2 times that of its middle: each end has four times the variance across, and
    the two are correlated by -1/2. Along the line the two ends are independent.
    """
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    across = normal[:, :, None] * normal[:, None, :]
    along = direction[:, :, None] * direction[:, None, :]
    covariance = np.zeros((len(direction), 4, 4))
    for end, block in ((0, slice(0, 2)), (1, slice(2, 4))):
        covariance[:, block, block] = (
            4 * variance_middle[:, None, None] * across
            + np.square(sigma_along_px[:, end])[:, None, None] * along
        )
    covariance[:, :2, 2:] = covariance[:, 2:, :2] = -2 * variance_middle[:, None, None] * across
    return covariance
