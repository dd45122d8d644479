"""Two cylinders, with every field of `Cylinders`."""

import numpy as np

from trinoc.match import Cylinders


def made_cylinders() -> Cylinders:
    """One of six outlines and one of four."""
    axis = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 30.0]], [[40.0, 0.0, 5.0], [60.0, 10.0, 5.0]]])
    spread = np.diag([0.01, 0.02, 1.0, 0.01, 0.02, 1.0, 0.04])
    return Cylinders(
        views=("upper", "left", "right"),
        axis_mm=axis,
        radius_mm=np.array([12.0, 6.5]),
        covariance_mm2=np.stack([spread, 4 * spread]),
        posterior=np.array([0.99, 0.7]),
        rival_posterior=np.array([0.0, 0.2]),
        chi_square=np.array([5.0, 2.0]),
        degrees=np.array([7, 3]),
        cylinder=np.array([0, 0, 0, 0, 0, 0, 1, 1, 1, 1]),
        view=np.array([0, 0, 1, 1, 2, 2, 0, 0, 1, 1]),
        segment=np.array([3, 4, 0, 9, 2, 7, 11, 12, 5, 6]),
        side=np.array([1, -1, 1, -1, 1, -1, -1, 1, 1, -1]),
        silhouette=np.array([0.99, 0.0, 0.7, 0.0]),
        counts={"possible outlines": 40, "cylinders": 2},
    )
