"""What picture to take next, as a value and a sentence."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class NextImage(NamedTuple):
    """The picture to take next.

    Fields
    ------
    words : how to hold the sheet.
    cam_from_world : (3, 4) the pose that these words mean, mm.
    parameter : what it would teach most about, the parameter known worst.
    sigma_now : its standard deviation; infinite where it is not determined.
    sigma_then : its standard deviation with this picture added.
    """

    words: str
    cam_from_world: Float[np.ndarray, "3 4"]
    parameter: str
    sigma_now: float
    sigma_then: float

    @property
    def sentence(self) -> str:
        """The advice for people."""
        if not np.isfinite(self.sigma_now):
            gain = f"determine {self.parameter} to {self.sigma_then:.2g}"
        else:
            gain = (
                f"lower the sigma of {self.parameter} from {self.sigma_now:.2g} to "
                f"{self.sigma_then:.2g}"
            )
        return f"Next picture: {self.words}; it would {gain}."
