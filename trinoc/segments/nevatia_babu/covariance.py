"""What the noise of the picture makes of a line's position."""

import numpy as np
from jaxtyping import Float

# Noise also enters through the choice of points; the share was measured on single edges.
NOISE_EXCESS = 1.2
# What the model leaves out even on a perfect edge (sampling, kernel shape, rounding): a part that
# is common to the whole edge, and a part per pixel of length that averages out.
MODEL_SIGMA_PX, MODEL_SIGMA_PER_PIXEL = 0.01, 0.11


def noise_variance(
    variance_middle_px2: Float[np.ndarray, "r"], length_px: Float[np.ndarray, "r"]
) -> Float[np.ndarray, "r"]:
    """(r,) variance of a line's middle across it, where nothing but noise disturbs it."""
    model = MODEL_SIGMA_PX**2 + MODEL_SIGMA_PER_PIXEL**2 / np.maximum(length_px, 1.0)
    return NOISE_EXCESS * variance_middle_px2 + model


def end_covariances(
    direction: Float[np.ndarray, "r 2"],
    variance_middle: Float[np.ndarray, "r"],
    common_px2: Float[np.ndarray, "r"],
    off_px2: Float[np.ndarray, "r 2"],
    sigma_along_px: Float[np.ndarray, "r 2"],
) -> Float[np.ndarray, "r 4 4"]:
    """(r, 4, 4) covariance of the ends (u1, v1, u2, v2).

    A line fitted to points spread evenly over its length L has an angle of variance
    12 / L^2 times that of its middle: each end has four times the variance across, and
    the two are correlated by -1/2. What moves the line as a whole, of variance `common_px2`,
    moves both ends alike; `off_px2` is what each end may be off by itself. Along the line the two
    ends are independent.
    """
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    across = normal[:, :, None] * normal[:, None, :]
    along = direction[:, :, None] * direction[:, None, :]
    covariance = np.zeros((len(direction), 4, 4))
    for end, block in ((0, slice(0, 2)), (1, slice(2, 4))):
        covariance[:, block, block] = (4 * variance_middle + common_px2 + off_px2[:, end])[
            :, None, None
        ] * across + np.square(sigma_along_px[:, end])[:, None, None] * along
    between = (common_px2 - 2 * variance_middle)[:, None, None] * across
    covariance[:, :2, 2:] = covariance[:, 2:, :2] = between
    return covariance
