"""How far something other than noise has moved whole lines."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Shifts(NamedTuple):
    """How far lines are to be moved.

    Fields
    ------
    shift_px : (r,) toward the brighter side.
    variance_px2 : (r,) of that shift, which both ends have in common.
    uneven_px2 : (r,) of the line's middle, as if points scattered: the shift changes along it.
    """

    shift_px: Float[np.ndarray, "r"]
    variance_px2: Float[np.ndarray, "r"]
    uneven_px2: Float[np.ndarray, "r"]
