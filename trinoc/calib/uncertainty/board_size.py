"""Error of the board's size: a scale that no image shows, separated from all other errors."""

import numpy as np
from jaxtyping import Float

# Suffixes of the parameters that are scales of a board along X and Y.
_SCALES = ("scale_x", "scale_y")


def covariance_of_size(
    parameters: tuple[str, ...], covariance: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, "p p"]:
    """Part of a joint covariance that the error of the board's size causes, (p, p).

    The size is the mean of all board scales among the parameters, such as "board.scale_x". The
    covariance minus this part is the covariance for a board of exact size. The result is zero if
    all scales are exact.

    Parameters
    ----------
    parameters : names of the parameters.
    covariance : (p, p) their joint covariance.
    """
    is_scale = np.array(
        [name.startswith("board.") and name.rpartition(".")[2] in _SCALES for name in parameters]
    )
    if not is_scale.any():
        return np.zeros_like(covariance)
    with_size = covariance[:, is_scale].mean(axis=1)
    variance = float(with_size[is_scale].mean())
    if not variance > 0.0:
        return np.zeros_like(covariance)
    return np.outer(with_size, with_size) / variance
