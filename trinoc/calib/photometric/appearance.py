"""The grey level of one pixel, and its derivative with respect to every unknown.

I = L (1 + q c): a light L that changes over the picture as a quadratic polynomial, and ink
that reflects 1 + q of what paper does. One light for both, because two fields of their own
would bend to swallow whatever covers the sheet.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.photometric.ink_coverage import (
    Circle,
    Cross,
    Drawing,
    View,
    ink_near,
)
from trinoc.calib.photometric.sheet_point import Ray, sheet_point
from trinoc.calib.photometric.square_coverage import Squares
from trinoc.numerics import ArrayLike

LIGHT_TERMS = 6
# Unknowns beside the pose, in their order after it: sigma, spread, ratio, light.
NUISANCE = 3 + LIGHT_TERMS


class Appearance(NamedTuple):
    """The unknowns beside the pose.

    Fields
    ------
    sigma_px : of the blur with the pixel's box, sqrt(blur^2 + 1/12).
    spread_mm : by which ink reaches beyond the drawing.
    ratio : q, ink over paper less one; negative for dark ink.
    light : (6,) coefficients of 1, x, y, x^2, xy, y^2 of the paper's grey level.
    """

    sigma_px: Float[ArrayLike, ""]
    spread_mm: Float[ArrayLike, ""]
    ratio: Float[ArrayLike, ""]
    light: Float[ArrayLike, "6"]

    @property
    def vector(self) -> Float[ArrayLike, "9"]:
        """(sigma, spread, ratio, light) as one array."""
        first = [jnp.asarray(value) for value in (self.sigma_px, self.spread_mm, self.ratio)]
        return jnp.concatenate([jnp.stack(first), self.light])

    @classmethod
    def from_vector(cls, vector: Float[ArrayLike, "9"]) -> "Appearance":
        """Inverse of `vector`."""
        return cls(vector[0], vector[1], vector[2], vector[3:])


class Pixels(NamedTuple):
    """Pixels of one picture that take part, each with what the model needs of it.

    Fields
    ------
    ray : where it looks.
    place : (2,) (u, v) about the picture's middle in units of half its width.
    grey : observed.
    weight : 1, or 0 for padding and for pixels that were cut.
    unit : 1 (see `SheetPoint`).
    figure : the nearest circle, or the ink about it on a board of squares.
    """

    ray: Ray
    place: Float[ArrayLike, "2"]
    grey: Float[ArrayLike, ""]
    weight: Float[ArrayLike, ""]
    unit: Float[ArrayLike, ""]
    figure: Circle | Squares


class Prediction(NamedTuple):
    """Residual (predicted minus observed) of a pixel and its derivatives.

    Derivatives are tuples of scalars, not arrays: over many pixels each becomes one long
    array, which the compiler computes once and in vector instructions.

    Fields
    ------
    residual : grey levels.
    by_homography : nine, with respect to the rows of the sheet-from-camera homography.
    by_appearance : nine, with respect to `Appearance.vector`.
    """

    residual: Float[ArrayLike, "*n"]
    by_homography: tuple[Float[ArrayLike, "..."], ...]
    by_appearance: tuple[Float[ArrayLike, "..."], ...]


def predict(
    sheet_from_camera: Float[ArrayLike, "3 3"],
    appearance: Appearance,
    pixel: Pixels,
    cross: Cross,
    drawing: Drawing,
    near_line: bool,
) -> Prediction:
    """Residual and derivatives of one pixel; one that is near no line has a simpler model."""
    point = sheet_point(sheet_from_camera, pixel.ray, pixel.unit)
    view = View(sheet_from_camera, pixel.ray, point)
    ink = ink_near(view, pixel.figure, cross, drawing, near_line)
    zero = jnp.zeros_like(appearance.sigma_px)
    at = (zero, zero, appearance.spread_mm, appearance.sigma_px)
    share, partials = jax.value_and_grad(ink, argnums=(0, 1, 2, 3))(*at)
    share, by_x, by_y, by_spread, by_sigma = (value / pixel.unit for value in (share, *partials))
    x, y = pixel.place[0], pixel.place[1]
    basis = (jnp.ones_like(x), x, y, x * x, x * y, y * y)
    light = sum((basis[k] * appearance.light[k] for k in range(LIGHT_TERMS)), start=zero)
    reflected = 1 + appearance.ratio * share
    slope = light * appearance.ratio
    column = point.by_matrix
    by_x, by_y = slope * by_x, slope * by_y
    by_w = -(by_x * point.point_mm[0] + by_y * point.point_mm[1])
    return Prediction(
        light * reflected - pixel.grey,
        tuple(row * column[k] for row in (by_x, by_y, by_w) for k in range(3)),
        (
            slope * by_sigma,
            slope * by_spread,
            light * share,
            *(reflected * basis[k] for k in range(LIGHT_TERMS)),
        ),
    )
