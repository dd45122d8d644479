"""Where an end of a 3-D segment may be: its covariance as an ellipsoid."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Ellipsoids(NamedTuple):
    """Ellipsoids of one sigma, one for each end whose covariance is known.

    Fields
    ------
    track, end : which end, 0 or 1, of which track.
    centres_mm : (n, 3) the ends, in the world frame.
    axes : (n, 3, 3) rotations; column k is the direction of axis k in the world.
    sigmas_mm : (n, 3) semi-axes, from the shortest to the longest.
    """

    track: Int[np.ndarray, "n"]
    end: Int[np.ndarray, "n"]
    centres_mm: Float[np.ndarray, "n 3"]
    axes: Float[np.ndarray, "n 3 3"]
    sigmas_mm: Float[np.ndarray, "n 3"]


def error_ellipsoids(
    lines_mm: Float[np.ndarray, "t 2 3"], covariance_mm2: Float[np.ndarray, "t 6 6"]
) -> Ellipsoids:
    """The ellipsoids of all ends, those of one track after another."""
    blocks = np.stack([covariance_mm2[:, :3, :3], covariance_mm2[:, 3:, 3:]], axis=1)
    blocks, centres = blocks.reshape(-1, 3, 3), lines_mm.reshape(-1, 3)
    known = np.isfinite(blocks).all(axis=(1, 2)) & np.isfinite(centres).all(axis=1)
    variances, axes = np.linalg.eigh(blocks[known])
    # Eigenvectors of a left-handed frame are no rotation: the first is turned about.
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    index = np.flatnonzero(known)
    return Ellipsoids(
        index // 2, index % 2, centres[known], axes, np.sqrt(np.maximum(variances, 0.0))
    )


def visible_factor(sigmas_mm: Float[np.ndarray, "n 3"], size_mm: float) -> int:
    """The power of ten, 1 to 1000, that makes the longest sigmas about a hundredth of a scene."""
    longest = float(np.median(sigmas_mm[:, -1])) if len(sigmas_mm) else 0.0
    if not longest > 0 or not size_mm > 0:
        return 1
    return int(10 ** np.clip(np.floor(np.log10(0.02 * size_mm / longest)), 0, 3))
