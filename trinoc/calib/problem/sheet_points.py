"""Where a picture shows places of the sheet: what circles and grey levels have in common."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class SheetPoints(NamedTuple):
    """Places of the sheet and the pixels at which one picture shows them.

    Fields
    ------
    place_mm : (n, 2) on the drawing of the sheet.
    uv_px : (n, 2) where the picture shows them.
    whitening : (2n, 2n) R, of all their errors as one vector: R^T R is their information, which
        may be singular. Rows of zeros say nothing.
    """

    place_mm: Float[np.ndarray, "*v n 2"]
    uv_px: Float[np.ndarray, "*v n 2"]
    whitening: Float[np.ndarray, "*v k k"]
