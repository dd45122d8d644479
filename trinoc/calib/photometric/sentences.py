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
    """The fit moved a circle by more than its position can be wrong."""
    return (
        f"the grey levels contradict the circles by {distance_px:.2f} px: check that nothing "
        "covers the sheet."
    )


def response_of(bend: float, sigma: float) -> str:
    """The camera has a nonlinear response.  sigma : standard deviation of `bend`."""
    return (
        f"response {PowerResponse(bend).description} ({bend:.2f} +- {sigma:.2f}, 0 linear, 1 sRGB)"
    )


def sharpened(amplitude: float) -> str:
    """Software has sharpened the image by an amplitude."""
    return f"sharpened ({amplitude:.2f})"


def moved(length_px: float, angle_deg: float) -> str:
    """Camera or sheet moved during the exposure."""
    return f"motion blur of {length_px:.1f} px at {angle_deg:.0f} degrees"


def correlated_noise(inflation: float) -> str:
    """Neighbouring pixels have correlated noise.  inflation : variance of a mean over white's."""
    return f"correlated noise of neighbouring pixels ({inflation:.1f} times the variance)"
