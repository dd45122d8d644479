"""The board's size: a scale that no image can show, apart from everything that images show."""

import numpy as np
from jaxtyping import Float

# Names of a board's scales along X and along Y, behind the name of the board.
_SCALES = ("scale_x", "scale_y")


def covariance_of_size(
    parameters: tuple[str, ...], covariance: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, "p p"]:
    """Part of a joint covariance that the error of the board's size makes, (p, p).

    The size is the mean of all scales of the boards among `parameters`, such as "board.scale_x".
    The part is that of a linear regression on it, so that the rest is the covariance for a board of
    known size. Zero if no scale is uncertain.
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
