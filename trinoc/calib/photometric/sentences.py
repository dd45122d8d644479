"""Messages of the fit to grey levels: failures, and effects of the camera's processing."""

from trinoc.image.response import PowerResponse

TWO_LEVELS = (
    "the grey levels cannot be fitted, because the image has only two levels. Give an image of 8 "
    "bits or more."
)
TOO_FEW_EDGES = (
    "the grey levels cannot be fitted, because too few circles and lines of the sheet are visible, "
    "or their contrast is too low. Show more of the sheet, or use more light."
)
NOT_CONVERGED = (
    "the fit to the grey levels did not converge. Check focus and light, and that nothing covers "
    "the sheet."
)
S_CURVE = "an s-shaped response of the camera"
WIDE_TAILS = "a blur with wide tails"
FLAT_TOP = "a blur with a flat top"
SATURATED = "saturated paper"
UNEVEN_LIGHT = "uneven light"


def contradicts_circles(distance_px: float) -> str:
    """Return the message that the grey levels contradict the detected circle centres.

    Parameters
    ----------
    distance_px : largest distance between the images of a circle centre by the two estimates.
    """
    return (
        f"the fit to the grey levels moves a circle by {distance_px:.2f} px, which contradicts its "
        "detected centre. Check that nothing covers the sheet."
    )


def response_of(bend: float, sigma: float) -> str:
    """Return the description of a nonlinear camera response.

    Parameters
    ----------
    bend, sigma : estimated curvature of the response (0 linear, 1 sRGB), and its standard
        deviation.
    """
    return (
        f"a camera response {PowerResponse(bend).description} ({bend:.2f} +- {sigma:.2f}, where 0 "
        "is linear and 1 is sRGB)"
    )


def sharpened(amplitude: float) -> str:
    """Return the description of an image that software has sharpened.

    Parameters
    ----------
    amplitude : weight of the sharpening filter.
    """
    return f"sharpening by software (amplitude {amplitude:.2f})"


def moved(length_px: float, angle_deg: float) -> str:
    """Return the description of motion blur: camera or sheet moved during the exposure.

    Parameters
    ----------
    length_px : length of the motion in the image.
    angle_deg : direction of the motion, from u toward v.
    """
    return f"a motion blur of {length_px:.1f} px at {angle_deg:.0f} degrees"


def correlated_noise(inflation: float) -> str:
    """Return the description of noise that is correlated between neighbouring pixels.

    Parameters
    ----------
    inflation : variance of a mean over neighbouring pixels, divided by that for uncorrelated noise.
    """
    return (
        f"correlated noise of neighbouring pixels (the variance of a mean is {inflation:.1f} times "
        "that of white noise)"
    )
