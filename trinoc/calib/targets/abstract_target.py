"""What every board has in common: labelled places on the plane Z = 0 that a detector finds."""

import equinox as eqx
import numpy as np
from equinox import AbstractVar
from jaxtyping import Float


class AbstractTarget(eqx.Module):
    """A board whose places a detector labels: centres of circles, or corners.

    Seen from the printed side, X points right and Y up; Z points out of the board.

    Fields
    ------
    name : what the board is called.
    centres_mm : (n, 2) the places (X, Y).
    radius_mm : (n,) of the circle around each place; a corner is a circle of radius 0.
    """

    name: AbstractVar[str]
    centres_mm: AbstractVar[Float[np.ndarray, "n 2"]]
    radius_mm: AbstractVar[Float[np.ndarray, "n"]]

    def __len__(self) -> int:
        return len(self.centres_mm)
