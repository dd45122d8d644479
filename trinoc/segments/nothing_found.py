"""Why a picture has no segments, or short ones, in a sentence for its user."""

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.image.grey import grey_image, why_mixed
from trinoc.image.light import Light
from trinoc.numerics.tails import MAD_TO_SIGMA

# Sides of an edge, this far apart, differ by its whole step also where it is blurred.
_APART_PX = 4  # numerical: for a message only


# The same where it is blurred by many pixels, and the blur, px, from which lines come in pieces.
_FAR_APART_PX, _SOFT_PX = 16, 2.8  # numerical: for a message only


def why_short(image: Shaped[np.ndarray, "..."]) -> str | None:
    """That the edges of a picture are soft, or that its pixels are of two moments or of several
    colours, which breaks lines into short pieces, and what to do about it; None where they are not.

    Raises InputError for what is no picture.
    """
    mixed = why_mixed(grey_image(image))
    if mixed is not None:
        return mixed
    grey = Light.from_picture(image).levels
    if min(grey.shape) <= _FAR_APART_PX:
        return None
    steepest, whole = (_strongest_step(grey, apart) for apart in (1, _FAR_APART_PX))
    # A Gaussian's steepest slope.
    blur_px = whole / (np.sqrt(2 * np.pi) * steepest) if steepest else 0.0
    if blur_px < _SOFT_PX:
        return None
    return (
        f"Its sharpest edges are blurred by some {blur_px:.0f} px, so that lines come in pieces: "
        f"focus the camera, or where the picture was enlarged, shrink it by {blur_px:.0f}."
    )


def _strongest_step(grey: Float[np.ndarray, "h w"], apart: int) -> float:
    """The largest change of grey levels over so many pixels, but for one in a thousand."""
    steps = grey[:, apart:] - grey[:, :-apart], grey[apart:] - grey[:-apart]
    return max(float(np.percentile(np.abs(step), 99.9)) for step in steps)


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
    strongest = _strongest_step(smooth, _APART_PX)
    noise = float(MAD_TO_SIGMA * np.median(np.abs(grey - smooth)))
    if strongest < least_contrast:
        return (
            f"Its grey levels go from {low:.4g} to {high:.4g} of 255 and change by at most "
            f"{strongest:.3g} across an edge, where {least_contrast:g} are asked for: expose "
            "longer, or take a smaller least_contrast."
        )
    if strongest < 6 * noise:
        return (
            f"Its grey levels change by {strongest:.3g} of 255 across the strongest edges, hardly "
            f"more than its noise of {noise:.2g}: expose longer or light the scene."
        )
    return (
        f"It has edges of {strongest:.3g} grey levels of 255, but none that is straight, sharp and "
        "long enough: check the focus and what it shows, or take a larger tolerance_px, or arcs."
    )
