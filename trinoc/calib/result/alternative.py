"""One thing that the model of a camera holds fixed, and what its residuals say of it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.tuning.every_group import TUNING


class Alternative(NamedTuple):
    """One thing that the model holds fixed, and what the residuals say of it.

    Fields
    ------
    name : "aim", "focal length", "aspect" or "radial distortion".
    chi_square_drop : likelihood ratio against the model as it is.
    p_value : probability of such a drop by noise alone.
    estimate : of the change, in mm of aim, share of the focal length, that along v against that
        along u, or k1.
    sigma : of the estimate.
    sentence : what it means.
    strain : by how many of its sigmas the change would move the camera (Mahalanobis distance).
    unseen : the largest change that the residuals may well not show.
    unseen_strain : by how many of its sigmas that would move the camera.
    """

    name: str
    chi_square_drop: float
    p_value: float
    estimate: Float[np.ndarray, "k"]
    sigma: Float[np.ndarray, "k"]
    sentence: str
    strain: float
    unseen: Float[np.ndarray, "k"]
    unseen_strain: float

    @property
    def found(self) -> bool:
        """Whether noise alone would hardly make it."""
        return self.p_value < TUNING.answer.chance
