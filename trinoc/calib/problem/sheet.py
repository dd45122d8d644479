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
    """Displacement within the plane of a point of a bent sheet that does not stretch.

    Parameters
    ----------
    heights_mm : homogeneous parts z_m of the sheet's height at the point, by ascending degree m.
    slopes : gradient of each part with respect to the position, (2,).
    first_degree : m of the first part.

    Returns
    -------
    The displacement, mm:

        u = -sum_mn n (n - 1) / ((m + n - 1) (m + n - 2)) z_n grad z_m

    Notes
    -----
    Let z be the height of the surface and g = grad z. Lengths are kept to second order in g if the
    symmetric part of grad u is -1/2 g g^T. For a developable surface, u is the path integral of E.
    Cesaro and V. Volterra of this strain from the origin. Here it is evaluated along the straight
    line, term by term. For a bend along X alone, u_x = -1/2 int (dz/dx)^2 dx and u_y = 0. A roll in
    any direction is equally exact. A sheet that bends in two directions must stretch. The formula
    then keeps the lengths of straight lines through the origin.

    References
    ----------
    V. Volterra, "Sur l'equilibre des corps elastiques multiplement connexes", Annales scientifiques
    de l'Ecole Normale Superieure 24, 1907.
    """
    degrees = range(first_degree, first_degree + len(heights_mm))
    total = jnp.zeros(2)
    for m, slope in zip(degrees, slopes, strict=True):
        for n, height in zip(degrees, heights_mm, strict=True):
            share = n * (n - 1) / ((m + n - 1) * (m + n - 2))
            total = total - share * height * slope
    return total


class AbstractSheet(eqx.Module):
    """Model of the print scale and the bend of a board.

    Attributes
    ----------
    names : names of the w parameters of one board, such as "scale_x".
    """

    names: eqx.AbstractClassVar[tuple[str, ...]]

    @abstractmethod
    def point(
        self,
        point_mm: Float[ArrayLike, "3"],
        shape: Float[ArrayLike, "w"],
        board: Int[ArrayLike, ""] | int = 0,
    ) -> Float[ArrayLike, "3"]:
        """Position of a point of the drawing on the printed and bent board, in the frame of the
        board, mm.

        point_mm : the point on the drawing.
        shape : (w,) parameters of the board.
        board : index of the board in a set.
        """

    def size(self, shape: Float[ArrayLike, "w"]) -> ScalarLike:
        """Size of the printed board relative to its drawing.

        Displacements of single board points are multiplied by this size. Their prior therefore has
        no effect on the size.
        """
        return 1.0


class WarpedBoard(AbstractSheet):
    """Model of a stiff board: print scales and a parabolic warp along X and Y.

    The four parameters are the relative errors of the print scale along X and Y, and the rise of
    the middle of the board above its edges, w_x and w_y, mm. The height at (x, y), relative to half
    the board, is w_x (1 - x^2) + w_y (1 - y^2). Lengths along the surface do not change
    (`bend_displacement_mm`).

    Attributes
    ----------
    half_mm : (b, 2) half the extent of each board along X and Y; the warp is zero there.

    References
    ----------
    mrcal, "Board deformation" in its formulation.
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
        """Position, mm, of a point of the drawing after print scale, rise, and displacement by the
        bend.
        """
        half_mm = jnp.asarray(self.half_mm)[board]
        share = point_mm[:2] / half_mm
        height = -shape[2:] @ (share * share)
        slope = -2 * shape[2:] * share / half_mm
        moved = point_mm[:2] * (1 + shape[:2]) + bend_displacement_mm([height], [slope])
        return jnp.append(moved, point_mm[2] + jnp.sum(shape[2:]) + height)


class BentPaper(AbstractSheet):
    """Model of paper on a table: print scales, and a height polynomial of degree 2 to 4.

    The parameters are the relative error of the print size, the relative errors along X and Y, and
    the coefficients of the height in mm.

    Attributes
    ----------
    reference_radius_mm : distance from the origin at which each term of the height equals its
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
        """Position, mm, of a point of the drawing after print scale, height, and displacement by
        the bend.
        """
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
        """Prior standard deviations, (w,), of the parameters in the order of `names`.

        Parameters
        ----------
        print_size : standard deviation of the relative print size.
        print_lengths : standard deviations of the relative errors along X and Y.
        flatness_mm : typical height of the sheet above its plane.
        height_shares : standard deviation of the height terms of degree 2, 3 and 4, divided by
            `flatness_mm`.
        """
        shares: dict[int, float] = dict(zip((2, 3, 4), height_shares, strict=True))
        heights = [shares[len(term)] * flatness_mm for term in cls.height_terms]
        return np.array([print_size, *print_lengths, *heights])
