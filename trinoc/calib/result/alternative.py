"""One thing that the model of a camera holds fixed, and what its residuals say of it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.tuning.every_group import TUNING


class Alternative(NamedTuple):
    """One thing that the model holds fixed, and what the residuals say of it.

    Fields
    ------
    name : "aim", "focal length" or "radial distortion".
    chi_square_drop : likelihood ratio against the model as it is.
    p_value : probability of such a drop by noise alone.
    estimate : of the change, in mm of aim, share of the focal length, or k1.
    sigma : of the estimate.
    sentence : what it means.
    """

    name: str
    chi_square_drop: float
    p_value: float
    estimate: Float[np.ndarray, "k"]
    sigma: Float[np.ndarray, "k"]
    sentence: str

    @property
    def found(self) -> bool:
        """Whether noise alone would hardly make it."""
        return self.p_value < TUNING.answer.chance
