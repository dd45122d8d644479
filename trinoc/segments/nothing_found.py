"""Why a picture has no segments, in a sentence for its user."""

import cv2
import numpy as np
from jaxtyping import Shaped

from trinoc.image.light import Light
from trinoc.numerics.tails import MAD_TO_SIGMA

# Sides of an edge, this far apart, differ by its whole step also where it is blurred.
_APART_PX = 4  # numerical: for a message only


def why_nothing(image: Shaped[np.ndarray, "..."], *, least_contrast: float = 7.0) -> str:
    """What keeps `find_segments` from finding a segment here, and what to do about it.

    For pictures in which it found none. Raises InputError for what is no picture.
    """
    grey = Light.from_picture(image).levels
    low, high = float(grey.min()), float(grey.max())
    if low == high:
        return (
            f"All pixels have one grey level ({low:.4g} of 255): check that this is the picture, "
            "and its exposure."
        )
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    steps = [
        np.abs(smooth[:, _APART_PX:] - smooth[:, :-_APART_PX]),
        np.abs(smooth[_APART_PX:] - smooth[:-_APART_PX]),
    ]
    strongest = max(float(np.percentile(step, 99.9)) for step in steps)
    noise = float(MAD_TO_SIGMA * np.median(np.abs(grey - smooth)))
    if strongest < least_contrast:
        return (
            f"Its grey levels go from {low:.4g} to {high:.4g} of 255 and change by at most "
            f"{strongest:.2g} across an edge, where {least_contrast:g} are asked for: expose "
            "longer, or take a smaller least_contrast."
        )
    if strongest < 6 * noise:
        return (
            f"Its grey levels change by {strongest:.2g} of 255 across the strongest edges, hardly "
            f"more than its noise of {noise:.2g}: expose longer or light the scene."
        )
    return (
        f"It has edges of {strongest:.2g} grey levels of 255, but none that is straight, sharp and "
        "long enough: check the focus and what it shows, or take a larger tolerance_px, or arcs."
    )
