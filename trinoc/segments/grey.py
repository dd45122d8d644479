"""Grey levels on one scale for all pictures, so that a contrast means the same in each."""

import numpy as np
from jaxtyping import Shaped

from trinoc.numerics import GreyImage, grey_image


def grey_in_255ths(image: Shaped[np.ndarray, "..."]) -> GreyImage:
    """`numerics.grey_image` with full white at 255, whatever the picture's own range.

    Raises InputError for what is no picture.
    """
    found = grey_image(image)
    if found.full == 255:
        return found
    per_255th = found.full / 255
    return GreyImage(
        found.grey * np.float32(1 / per_255th),
        found.quantum / per_255th,
        found.white / per_255th,
        255.0,
    )
