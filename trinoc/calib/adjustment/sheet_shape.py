"""A sheet as it came out of the printer and lies on the table: stretched, and not quite flat.

The plane Z = 0 is the one that touches the sheet at the origin. Paper bends and hardly stretches:
its height is a polynomial of second degree (along X, along Y, twisted) with smaller parts of third
and fourth degree, as a cornet has them, and what rises comes nearer to the origin.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.numerics import ArrayLike

# Print: size, and lengths along X and along Y. Height: powers of x and y.
PRINT_TERMS = ("print size", "print along X", "print along Y")
HEIGHT_TERMS = (
    *("XX", "YY", "XY"),
    *("XXX", "XXY", "XYY", "YYY"),
    *("XXXX", "XXXY", "XXYY", "XYYY", "YYYY"),
)
# Heights of each degree against those of second, at the reach: paper that was rolled or has lain
# in a drawer changes its curvature by a part of it over a sheet.
_SHARE_OF_DEGREE = {2: 1.0, 3: 0.5, 4: 0.25}
# A place at arc length s on h = c s^2 lies nearer to the origin by 2 h^2 / (3 s).
_SHORTENING = 2 / 3


def shape_sigmas(
    print_size: float, print_lengths: tuple[float, float], flatness_mm: float
) -> Float[np.ndarray, "s"]:
    """Standard deviations of PRINT_TERMS, as shares of a length, and of HEIGHT_TERMS in mm."""
    heights = [_SHARE_OF_DEGREE[len(term)] * flatness_mm for term in HEIGHT_TERMS]
    return np.array([print_size, *print_lengths, *heights])


def point_of_place(
    place_mm: Float[ArrayLike, "2"], shape: Float[ArrayLike, "s"], reach_mm: Float[ArrayLike, ""]
) -> Float[ArrayLike, "3"]:
    """The point of the world, in mm, at which a place of the drawing lies.

    `reach_mm` is where a unit of each height counts.
    """
    x, y = place_mm[0] / reach_mm, place_mm[1] / reach_mm
    count = len(PRINT_TERMS)
    basis = [x ** term.count("X") * y ** term.count("Y") for term in HEIGHT_TERMS]
    height = jnp.stack(basis) @ shape[count:]
    squared = place_mm @ place_mm
    nearer = _SHORTENING * height * height / jnp.maximum(squared, 1e-6 * reach_mm * reach_mm)
    printed = place_mm * (1 + shape[0] + shape[1:count])
    return jnp.append(printed * (1 - nearer), height)
