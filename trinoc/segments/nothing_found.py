"""Explanations for an image without segments, or with short ones."""

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.image.grey import describe_mixed_pixels, grey_image
from trinoc.image.light import Light
from trinoc.numerics.tails import MAD_TO_SIGMA

# Distance across an edge that contains its whole step.
_ACROSS_PX = 4  # numerical: for a message only
# The same for a blur of many pixels, and the blur, px, from which lines break into pieces.
_FAR_ACROSS_PX, _SOFT_PX = 16, 2.8  # numerical: for a message only


def why_short(image: Shaped[np.ndarray, "..."]) -> str | None:
    """Return the sentence that explains short segments and names the remedy, or None.

    Causes are blurred edges, interlaced rows and raw mosaics. The result is None for a sharp image
    with none of these.

    Parameters
    ----------
    image : (h, w) or (h, w, channels)
        As in `find_segments`.

    Returns
    -------
    str or None
        Cause and remedy.

    Raises
    ------
    InputError
        If the argument is not an image.
    """
    mixed = describe_mixed_pixels(grey_image(image))
    if mixed is not None:
        return mixed
    grey = Light.from_picture(image).levels
    if min(grey.shape) <= _FAR_ACROSS_PX:
        return None
    steepest, full_step = (
        _strongest_step(grey, separation_px) for separation_px in (1, _FAR_ACROSS_PX)
    )
    # Steepest slope of a step blurred by a Gaussian.
    blur_px = full_step / (np.sqrt(2 * np.pi) * steepest) if steepest else 0.0
    if blur_px < _SOFT_PX:
        return None
    return (
        f"Its sharpest edges have a blur of about {blur_px:.0f} px, which breaks lines into "
        f"pieces. Focus the camera, or shrink an enlarged picture by {blur_px:.0f}."
    )


def _strongest_step(grey: Float[np.ndarray, "h w"], separation_px: int) -> float:
    """Return the 99.9th percentile of the grey-level difference between pixels `separation_px`
    apart.

    Differences along rows and along columns are computed; the larger percentile is returned.
    """
    steps = (
        grey[:, separation_px:] - grey[:, :-separation_px],
        grey[separation_px:] - grey[:-separation_px],
    )
    return max(float(np.percentile(np.abs(step), 99.9)) for step in steps)


def why_nothing(image: Shaped[np.ndarray, "..."], *, least_contrast: float = 7.0) -> str:
    """Return the sentence that explains why no segment was detected, with the remedy.

    Parameters
    ----------
    image : (h, w) or (h, w, channels)
        Image in which `find_segments` detects no segment.
    least_contrast : float
        As in `find_segments`.

    Returns
    -------
    str
        Cause and remedy.

    Raises
    ------
    InputError
        If the argument is not an image.
    """
    grey = Light.from_picture(image).levels
    low, high = float(grey.min()), float(grey.max())
    if low == high:
        return (
            f"All pixels have the same grey level ({low:.4g} of 255). Check the file and the "
            "exposure."
        )
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    strongest = _strongest_step(smooth, _ACROSS_PX)
    noise = float(MAD_TO_SIGMA * np.median(np.abs(grey - smooth)))
    if strongest < least_contrast:
        return (
            f"Its grey levels range from {low:.4g} to {high:.4g} of 255 and change by at most "
            f"{strongest:.3g} across an edge, but least_contrast is {least_contrast:g}. Expose "
            "longer, or give a smaller least_contrast."
        )
    if strongest < 6 * noise:
        return (
            f"Its grey levels change by {strongest:.3g} of 255 across the strongest edges, little "
            f"more than the noise of {noise:.2g}. Expose longer or light the scene."
        )
    return (
        f"It has edges of {strongest:.3g} grey levels of 255, but none is straight, sharp and long "
        "enough. Check the focus and the scene, or give a larger tolerance_px, or arcs."
    )
