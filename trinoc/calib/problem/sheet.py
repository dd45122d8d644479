"""A sheet as it is: stretched against its drawing, and not quite flat.

Two models say where a place of the drawing lies in the frame of the board. `WarpedBoard` is that of
a stiff board, whose middle rises over its edges. `BentPaper` is that of paper on a table: the plane
Z = 0 touches it at the origin. Paper bends and hardly stretches: its height is a polynomial of
second degree (along X, along Y, twisted) with smaller parts of third and fourth degree, as a cornet
has them, and what rises comes nearer to the origin.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.tuning.every_group import TUNING
from trinoc.numerics.precision import ArrayLike

# numerical: a place at arc length s on h = c s^2 lies nearer to the origin by 2 h^2 / (3 s).
_SHORTENING = 2 / 3


class AbstractSheet(eqx.Module):
    """How numbers bend and stretch a board.

    `names` : of the numbers of one board.
    """

    names: eqx.AbstractClassVar[tuple[str, ...]]

    @abstractmethod
    def point(
        self,
        place_mm: Float[ArrayLike, "3"],
        shape: Float[ArrayLike, "w"],
        board: Int[ArrayLike, ""] | int = 0,
    ) -> Float[ArrayLike, "3"]:
        """Where a place of the drawing of one of the boards lies, in mm."""


class WarpedBoard(AbstractSheet):
    """Scales along X and Y over nominal less one, and the rise of the middle along both in mm.

    The rise is w_x (1 - x^2) + w_y (1 - y^2), where x and y are shares of half the board.
    Source: mrcal, "Board deformation" in its formulation.

    Fields
    ------
    half_mm : (b, 2) half the extent of each board, where its warp is zero.
    """

    names: ClassVar[tuple[str, ...]] = ("scale_x", "scale_y", "warp_x_mm", "warp_y_mm")
    half_mm: Float[ArrayLike, "b 2"]

    def point(
        self,
        place_mm: Float[ArrayLike, "3"],
        shape: Float[ArrayLike, "w"],
        board: Int[ArrayLike, ""] | int = 0,
    ) -> Float[ArrayLike, "3"]:
        """The place, scaled, and risen as far from the edges as it is."""
        share = place_mm[:2] / jnp.asarray(self.half_mm)[board]
        rise = shape[2:] @ (1 - share * share)
        return jnp.append(place_mm[:2] * (1 + shape[:2]), place_mm[2] + rise)


class BentPaper(AbstractSheet):
    """Size of the print, its lengths along X and Y (shares), and coefficients of its height in mm.

    Fields
    ------
    reach_mm : distance from the origin at which a unit of each height counts.
    """

    print_terms: ClassVar[tuple[str, ...]] = ("print size", "print along X", "print along Y")
    height_terms: ClassVar[tuple[str, ...]] = (
        *("XX", "YY", "XY"),
        *("XXX", "XXY", "XYY", "YYY"),
        *("XXXX", "XXXY", "XXYY", "XYYY", "YYYY"),
    )
    names: ClassVar[tuple[str, ...]] = (*print_terms, *height_terms)
    reach_mm: Float[ArrayLike, ""]

    def point(
        self,
        place_mm: Float[ArrayLike, "3"],
        shape: Float[ArrayLike, "w"],
        board: Int[ArrayLike, ""] | int = 0,
    ) -> Float[ArrayLike, "3"]:
        """The place, stretched, risen, and drawn towards the origin by what it rose."""
        basis = {"X": place_mm[0] / self.reach_mm, "Y": place_mm[1] / self.reach_mm}
        for term in self.height_terms:
            basis[term] = basis[term[:-1]] * basis[term[-1]]
        count = len(self.print_terms)
        height = jnp.stack([basis[term] for term in self.height_terms]) @ shape[count:]
        squared = place_mm[:2] @ place_mm[:2]
        smallest = 1e-6 * self.reach_mm * self.reach_mm
        nearer = _SHORTENING * height * height / jnp.maximum(squared, smallest)
        printed = place_mm[:2] * (1 + shape[0] + shape[1:count])
        return jnp.append(printed * (1 - nearer), place_mm[2] + height)

    @classmethod
    def sigmas(
        cls, print_size: float, print_lengths: tuple[float, float], flatness_mm: float
    ) -> Float[np.ndarray, "w"]:
        """Standard deviations of `names`: shares of a length, then mm."""
        shares: dict[int, float] = dict(zip((2, 3, 4), TUNING.problem.height_shares, strict=True))
        heights = [shares[len(term)] * flatness_mm for term in cls.height_terms]
        return np.array([print_size, *print_lengths, *heights])
