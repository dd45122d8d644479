"""Shape of a printed sheet: print scale, height over its plane, and shortening by the bend.

Two models map a position on the drawing to a point in the frame of the board. `WarpedBoard` is a
stiff board whose middle is higher than its edges. `BentPaper` is paper on a table that touches the
plane Z = 0 at the origin. Its height is a polynomial of second degree (along X, along Y, twisted)
with smaller terms of third and fourth degree.

Paper and plates bend without stretching: lengths along the surface stay those of the drawing. So a
bent sheet is shorter in the plane Z = 0. `bend_displacement_mm` is that shortening.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.tuning.every_group import TUNING
from trinoc.numerics.precision import ArrayLike, ScalarLike


def bend_displacement_mm(
    heights_mm: Sequence[ArrayLike], slopes: Sequence[Float[ArrayLike, "2"]], first_degree: int = 2
) -> Float[ArrayLike, "2"]:
    """Displacement in the plane of a position on a bent sheet that does not stretch.

    Parameters
    ----------
    heights_mm : the homogeneous parts z_m of the height at the position, by ascending degree m.
    slopes : the gradient of each part by the position.
    first_degree : m of the first part.

    Returns
    -------
    The displacement u = -sum_mn n (n - 1) / ((m + n - 1) (m + n - 2)) z_n grad z_m, mm.

    Notes
    -----
    A surface of height z keeps all lengths to second order in its slopes g = grad z where the
    symmetric part of grad u is -1/2 g g^T. For a developable surface, u is the path integral of
    E. Cesaro and V. Volterra of this strain from the origin, here along the straight line and term
    by term. Bent along X alone, it is u_x = -1/2 int (dz/dx)^2 dx and u_y = 0; a roll in any
    direction is equally exact. A sheet that bends in two directions must stretch; this form then
    keeps the lengths of the straight lines through the origin.

    References
    ----------
    V. Volterra, "Sur l'equilibre des corps elastiques multiplement connexes", Annales
    scientifiques de l'Ecole Normale Superieure 24, 1907.
    """
    degrees = range(first_degree, first_degree + len(heights_mm))
    total = jnp.zeros(2)
    for m, slope in zip(degrees, slopes, strict=True):
        for n, height in zip(degrees, heights_mm, strict=True):
            share = n * (n - 1) / ((m + n - 1) * (m + n - 2))
            total = total - share * height * slope
    return total


class AbstractSheet(eqx.Module):
    """Model of print and bend of a board.

    `names` : names of its parameters for one board, such as "scale_x".
    """

    names: eqx.AbstractClassVar[tuple[str, ...]]

    @abstractmethod
    def point(
        self,
        point_mm: Float[ArrayLike, "3"],
        shape: Float[ArrayLike, "w"],
        board: Int[ArrayLike, ""] | int = 0,
    ) -> Float[ArrayLike, "3"]:
        """Position of a point of the drawing on the printed and bent board, mm."""

    def size(self, shape: Float[ArrayLike, "w"]) -> ScalarLike:
        """Size of the board relative to its drawing.

        Displacements of single board points scale with it, so that their prior does not pull at the
        size.
        """
        return 1.0


class WarpedBoard(AbstractSheet):
    """Print scales along X and Y (relative, minus one), and the rise of the middle along both in
    mm.

    The rise is w_x (1 - x^2) + w_y (1 - y^2), with x and y relative to half the board. Source:
    mrcal, "Board deformation" in its formulation. Lengths along the board do not change
    (`bend_displacement_mm`), for glass and aluminium as for paper.

    Attributes
    ----------
    half_mm : (b, 2) half the extent of each board, where its warp is zero.
    """

    names: ClassVar[tuple[str, ...]] = ("scale_x", "scale_y", "warp_x_mm", "warp_y_mm")
    half_mm: Float[ArrayLike, "b 2"]

    def size(self, shape: Float[ArrayLike, "w"]) -> ScalarLike:
        """Mean of the scales along X and Y."""
        return 1.0 + 0.5 * (shape[0] + shape[1])

    def point(
        self,
        point_mm: Float[ArrayLike, "3"],
        shape: Float[ArrayLike, "w"],
        board: Int[ArrayLike, ""] | int = 0,
    ) -> Float[ArrayLike, "3"]:
        """Position with print scale, rise and displacement by the bend."""
        half_mm = jnp.asarray(self.half_mm)[board]
        share = point_mm[:2] / half_mm
        height = -shape[2:] @ (share * share)
        slope = -2 * shape[2:] * share / half_mm
        moved = point_mm[:2] * (1 + shape[:2]) + bend_displacement_mm([height], [slope])
        return jnp.append(moved, point_mm[2] + jnp.sum(shape[2:]) + height)


class BentPaper(AbstractSheet):
    """Relative print size, relative lengths along X and Y, and height coefficients in mm.

    Attributes
    ----------
    reference_radius_mm : distance from the origin at which each height term has the size of its
        coefficient.
    """

    print_terms: ClassVar[tuple[str, ...]] = ("print size", "print along X", "print along Y")
    height_terms: ClassVar[tuple[str, ...]] = (
        *("XX", "YY", "XY"),
        *("XXX", "XXY", "XYY", "YYY"),
        *("XXXX", "XXXY", "XXYY", "XYYY", "YYYY"),
    )
    names: ClassVar[tuple[str, ...]] = (*print_terms, *height_terms)
    reference_radius_mm: Float[ArrayLike, ""]

    def point(
        self,
        point_mm: Float[ArrayLike, "3"],
        shape: Float[ArrayLike, "w"],
        board: Int[ArrayLike, ""] | int = 0,
    ) -> Float[ArrayLike, "3"]:
        """Position of a point of the drawing on the bent paper, mm."""
        scaled = point_mm[:2] / self.reference_radius_mm
        power = {"": jnp.ones_like(scaled[0])}
        for term in ("X", "Y", *self.height_terms):
            power[term] = power[term[:-1]] * scaled[0 if term[-1] == "X" else 1]
        count = len(self.print_terms)
        heights, slopes = [], []
        for degree in range(len(self.height_terms[0]), len(self.height_terms[-1]) + 1):
            terms = [term for term in self.height_terms if len(term) == degree]
            rows = [count + self.height_terms.index(term) for term in terms]
            by_axis = [
                jnp.stack([term.count(axis) * power[term.replace(axis, "", 1)] for term in terms])
                for axis in "XY"
            ]
            weights = jnp.asarray(shape)[np.array(rows)]
            heights.append(jnp.stack([power[term] for term in terms]) @ weights)
            slopes.append(jnp.stack(by_axis) @ weights / self.reference_radius_mm)
        moved = point_mm[:2] * (1 + shape[0] + shape[1:count])
        moved = moved + bend_displacement_mm(heights, slopes)
        return jnp.append(moved, point_mm[2] + jnp.sum(jnp.stack(heights)))

    @classmethod
    def sigmas(
        cls,
        print_size: float,
        print_lengths: tuple[float, float],
        flatness_mm: float,
        height_shares: tuple[float, float, float] = TUNING.problem.height_shares,
    ) -> Float[np.ndarray, "w"]:
        """Standard deviations of `names`: relative lengths, then mm."""
        shares: dict[int, float] = dict(zip((2, 3, 4), height_shares, strict=True))
        heights = [shares[len(term)] * flatness_mm for term in cls.height_terms]
        return np.array([print_size, *print_lengths, *heights])
