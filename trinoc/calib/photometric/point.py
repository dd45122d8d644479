"""Where a fit of a picture stands."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.equations import Equations
from trinoc.calib.photometric.noise import clipped, is_clear
from trinoc.calib.photometric.scene import Scene
from trinoc.calib.photometric.unknowns import PictureState


class Point(NamedTuple):
    """A state with what it says of the pixels, and the noise that weighs them.

    Fields
    ------
    state : of all unknowns.
    free : (p + k,) which of (pose, values) are fitted.
    equations : at the state, as NumPy arrays.
    length : of the step that would come next, of the pose in its own standard deviations.
    level : (n,) predicted before saturation.
    sigma : (n,) noise of each pixel before saturation.
    kept : (n,) pixels that show the sheet.
    """

    state: PictureState
    free: Bool[np.ndarray, "k"]
    equations: Equations
    length: float
    level: Float[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n"]
    kept: Bool[np.ndarray, "n"]

    def residual(self, scene: Scene) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Predicted minus observed after saturation, and its standard deviation."""
        cut = clipped(self.level, self.sigma, scene.top)
        return np.asarray(cut.mean) - scene.grey, np.asarray(cut.sigma)

    def clear(self, scene: Scene) -> Bool[np.ndarray, "n"]:
        """Pixels that stayed and whose noise saturation leaves as it is."""
        return self.kept & is_clear(self.level, self.sigma, scene.top)
