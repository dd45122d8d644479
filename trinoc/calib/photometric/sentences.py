"""Messages of the fit to grey levels: failures, and effects of the camera's processing."""

from trinoc.image.response import PowerResponse

TWO_LEVELS = (
    "the grey levels cannot be fitted, because the image has only two levels: deliver 8 bits or "
    "more."
)
TOO_FEW_EDGES = (
    "the grey levels cannot be fitted, because too few edges of the sheet are visible or their "
    "contrast is too low: show more of the sheet, or use more light."
)
NOT_CONVERGED = (
    "the fit to the grey levels did not converge: check focus and light, and that nothing covers "
    "the sheet."
)
S_CURVE = "response with an s-curve"
WIDE_TAILS = "blur with wide tails"
FLAT_TOP = "blur with a flat top"
SATURATED = "saturated paper"
UNEVEN_LIGHT = "uneven light"


def contradicts_circles(distance_px: float) -> str:
    """Return the message that the grey levels contradict the detected circle centres.

    Parameters
    ----------
    distance_px : largest distance between the images of a circle centre by the two estimates.
    """
    return (
        f"the grey levels contradict the circles by {distance_px:.2f} px: check that nothing "
        "covers the sheet."
    )


def response_of(bend: float, sigma: float) -> str:
    """Return the description of a nonlinear camera response.

    Parameters
    ----------
    bend, sigma : estimated curvature of the response (0 linear, 1 sRGB), and its standard
        deviation.
    """
    return (
        f"response {PowerResponse(bend).description} ({bend:.2f} +- {sigma:.2f}, 0 linear, 1 sRGB)"
    )


def sharpened(amplitude: float) -> str:
    """Return the description of an image that software has sharpened.

    Parameters
    ----------
    amplitude : weight of the sharpening filter.
    """
    return f"sharpened ({amplitude:.2f})"


def moved(length_px: float, angle_deg: float) -> str:
    """Return the description of motion blur: camera or sheet moved during the exposure.

    Parameters
    ----------
    length_px : length of the motion in the image.
    angle_deg : direction of the motion, from u toward v.
    """
    return f"motion blur of {length_px:.1f} px at {angle_deg:.0f} degrees"


def correlated_noise(inflation: float) -> str:
    """Return the description of noise that is correlated between neighbouring pixels.

    Parameters
    ----------
    inflation : variance of a mean over neighbouring pixels, divided by that for uncorrelated noise.
    """
    return f"correlated noise of neighbouring pixels ({inflation:.1f} times the variance)"
