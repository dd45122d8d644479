"""Grey levels on one scale for all pictures, so that a contrast means the same in each."""

import numpy as np
from jaxtyping import Shaped

from trinoc.numerics import GreyImage, grey_image


def grey_in_255ths(image: Shaped[np.ndarray, "..."]) -> GreyImage:
    """`numerics.grey_image` with 16-bit levels on the scale of 8-bit ones.

    Pictures of real numbers keep their scale. Raises InputError for what is no picture.
    """
    found = grey_image(image)
    if np.asarray(image).dtype != np.uint16:
        return found
    return GreyImage(found.grey * np.float32(1 / 257), found.quantum / 257, found.white / 257)
