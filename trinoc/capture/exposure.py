"""How the light of a picture lies in the range of its numbers."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# In 255ths. What cameras and JPEG make of full light and of none lies a level or two off.
_SATURATED, _DARK = 253, 2
# The paper is the brightest of a board; dust and glints are brighter, but few.
_PAPER_PERCENTILE = 95.0


class Exposure(NamedTuple):
    """Shares of the pixels looked at, from 0 to 1.

    Fields
    ------
    saturated, dark : share of pixels at full white, and at black.
    paper : the level of the bright parts, as a share of full white.
    """

    saturated: float
    dark: float
    paper: float


def exposure_of(levels: Float[np.ndarray, "h w"]) -> Exposure:
    """The exposure of grey levels in 255ths of full white."""
    return Exposure(
        float(np.mean(levels >= _SATURATED)),
        float(np.mean(levels <= _DARK)),
        float(np.percentile(levels, _PAPER_PERCENTILE)) / 255,
    )
