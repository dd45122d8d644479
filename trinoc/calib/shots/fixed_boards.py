"""How boards are fixed to each other, in words."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

_AXES = ("x", "y", "z")


def fixed_sentence(
    name: str,
    reference: str,
    reference_from_board: Float[np.ndarray, "3 4"],
    sigma_mm: Sequence[float],
    sigma_deg: Sequence[float],
) -> str:
    """Where a board's origin lies in the frame of another, and by how much it is turned.

    sigma_mm, sigma_deg : (3,) along and about the axes of that frame.
    """
    rotation, origin = reference_from_board[:, :3], reference_from_board[:, 3]
    cosine = np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0)
    places = ", ".join(
        f"{axis} {_told(value, sigma)}"
        for axis, value, sigma in zip(_AXES, origin, sigma_mm, strict=True)
    )
    turns = ", ".join(f"{sigma:.2g}" for sigma in sigma_deg)
    return (
        f'"{name}" lies at {places} mm in the frame of "{reference}", turned by '
        f"{np.degrees(np.arccos(cosine)):.2f} degrees (+- {turns} about x, y, z)"
    )


def _told(value: float, sigma: float) -> str:
    decimals = max(0, 1 - int(np.floor(np.log10(sigma)))) if sigma > 0 else 3
    return f"{value:.{decimals}f} +- {sigma:.{decimals}f}"
