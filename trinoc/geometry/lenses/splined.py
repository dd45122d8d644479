"""Lenses that no polynomial describes: one that does, and a correction by B-splines.

The correction is a smooth surface over the picture that the polynomial gives, so that its inverse
is a small step in the plane and all rays are those of the polynomial, beyond 90 degrees, too.
Source of the idea: mrcal's splined models, whose surface lies over a stereographic picture.
"""

from functools import cache
from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry.lenses.abstract_lens import AbstractLens, RadialPart
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.newton import inverse_in_plane
from trinoc.geometry.lenses.polynomial import BrownConrady, Rational
from trinoc.numerics.precision import ArrayLike, array_namespace

if TYPE_CHECKING:
    from typing import ClassVar as AbstractClassVar
else:
    from equinox import AbstractClassVar


# A cell is under the basis functions of so many control points along each side.
ORDER = 4


def surface(
    control: Float[ArrayLike, "rows columns"], place: Float[ArrayLike, "2"]
) -> Float[ArrayLike, ""]:
    """Height of the surface at a place, which counts cells from the grid's first corner.

    place : (along columns, along rows), from 0 to columns - 3 and rows - 3; beyond, the height is
        that of the nearest place of the grid.
    """
    rows, columns = control.shape
    along, across = basis(place, rows, columns)
    return along @ control @ across


def basis(
    place: Float[ArrayLike, "2"], rows: int, columns: int
) -> tuple[Float[ArrayLike, "rows"], Float[ArrayLike, "columns"]]:
    """What each row, and each column, of control points counts at a place."""
    return _basis(place[1], rows), _basis(place[0], columns)


def _basis(place: Float[ArrayLike, ""], count: int) -> Float[ArrayLike, "n"]:
    """The basis function of every control point along one side; they sum to one.

    All of them, though four at most are not zero: a derivative by many control points is then one
    product of matrices, which takes less time than picking four out of each.
    """
    inside = jnp.clip(place, 0.0, float(count - ORDER + 1))
    away = jnp.abs(inside - (np.arange(count) - 1.0).astype(inside.dtype))
    near, far = jnp.maximum(1.0 - away, 0.0), jnp.maximum(2.0 - away, 0.0)
    return (far**3 - 4.0 * near**3) / 6.0


def smoothness(rows: int, columns: int, reach: float) -> Float[np.ndarray, "n n"]:
    """Inverse covariance of the control points of a smooth random surface of variance 1.

    reach : cells over which its heights go together. The points stand row by row. Heights have
    the covariance of Matern, of smoothness 1, and variance 1 on average over the grid. Source:
    F. Lindgren, H. Rue and J. Lindstrom, "An explicit link between Gaussian fields and Gaussian
    Markov random fields", J. R. Statist. Soc. B 73(4), 2011.
    """
    bend = np.kron(_bend(rows), np.eye(columns)) + np.kron(np.eye(rows), _bend(columns))
    root = 8.0 / reach**2 * np.eye(rows * columns) + bend
    information = root @ root
    heights = np.kron(_heights(rows), _heights(columns))
    variance = np.einsum("hi,ij,hj->h", heights, np.linalg.inv(information), heights)
    return float(variance.mean()) * information


def _bend(count: int) -> Float[np.ndarray, "n n"]:
    """Minus the second difference along a row of points, which ends without a slope."""
    step = np.diff(np.eye(count), axis=0)
    return step.T @ step


def _heights(count: int) -> Float[np.ndarray, "h n"]:
    """Heights at the cells' corners by the control points of one side."""
    near, middle = (np.eye(count - ORDER + 2, count, k=k) for k in (0, 1))
    return (near + 4.0 * middle + np.eye(count - ORDER + 2, count, k=2)) / 6.0


ROWS, COLUMNS = 10, 12
_CELLS = np.array([COLUMNS, ROWS]) - ORDER + 1
_EXTENT = ("log_half_u", "log_half_v")
_CONTROL = tuple(f"{d}_{r}_{c}" for d in ("du", "dv") for r in range(ROWS) for c in range(COLUMNS))
_ADDED = (*_EXTENT, *_CONTROL)
# Names of the coefficients of the correction, too many to be listed one by one.
SPLINE_PARAMETERS = frozenset(_ADDED)
_POWERS = (0,) * len(_ADDED)
# The grid goes beyond the edges of the picture by this share.
_MARGIN = 0.02
# The correction is small and smooth: of one of 5 px, four leave rounding.
_NEWTON_STEPS = 5
# Cells over which the correction goes together, as far as the prior has it.
_REACH = 4.0


class AbstractSplinedLens(AbstractLens):
    """A lens whose pixels are those of `core`, moved by (du, dv) of a bicubic B-spline.

    The control points, 10 rows of 12 for du and then for dv, in pixels, are coefficients, after
    those of the core and the logarithms of half the extent of the grid along u and v, in focal
    lengths from the principal point. The extent is never fitted. Beyond the grid the correction
    stays what it is at its edge.
    """

    core_model: AbstractClassVar[type[AbstractLens]]
    control_count: ClassVar[int] = len(_CONTROL)
    never_fitted: ClassVar[tuple[str, ...]] = _EXTENT

    def __init_subclass__(cls) -> None:
        """Says of the lens what its core says, and what the correction adds."""
        super().__init_subclass__()
        core = cls.core_model
        cls.model = f"splined_{core.model}"
        cls.coefficient_names = core.coefficient_names + _ADDED
        cls.parameter_names = core.parameter_names + _ADDED
        cls.coefficient_powers = core.coefficient_powers + _POWERS
        cls.coefficient_counts = (*core.coefficient_counts, len(cls.coefficient_names))
        cls.dispensable, cls.zero_is_ideal = core.dispensable, core.zero_is_ideal

    @property
    def core(self) -> AbstractLens:
        """The lens without the correction."""
        count = len(self.core_model.coefficient_names)
        return self.core_model(
            self.focal_length_px, self.principal_point_px, self.skew_px, self.coefficients[:count]
        )

    @property
    def control_px(self) -> Float[ArrayLike, "2 rows columns"]:
        """The control points of du and of dv."""
        return self.coefficients[-len(_CONTROL) :].reshape(2, ROWS, COLUMNS)

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """What the core has, corrected."""
        return self._correct(self.core.distort(ray_cam))

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """The ray of the core's picture, which is found by Newton's method."""
        of_core = inverse_in_plane(self._correct, distorted, _NEWTON_STEPS)
        return self.core.undistort(of_core)

    def radial_part(self) -> RadialPart | None:
        """That of the core."""
        return self.core.radial_part()

    def steepness(self) -> float:
        """A bound on how much the correction changes from one pixel to the next.

        Below 1 the correction is one to one, and its inverse exists everywhere. The lens must not
        be traced.
        """
        half = np.exp(np.asarray(self.coefficients[-len(_CONTROL) - 2 : -len(_CONTROL)]))
        cell_px = 2.0 * half * np.asarray(self.focal_length_px) / _CELLS
        control = np.asarray(self.control_px)
        steps = [
            np.abs(np.diff(control, axis=axis)).max(axis=(1, 2)) / cell_px[k]
            for k, axis in enumerate((2, 1))
        ]
        return float(np.linalg.norm(steps))

    def valid_radius_px(self) -> float:
        """That of the core less the longest correction; 0 for a correction that folds."""
        if not self.steepness() < 1.0:
            return 0.0
        longest_px = np.linalg.norm(np.abs(np.asarray(self.control_px)).max(axis=(1, 2)))
        return max(self.core.valid_radius_px() - float(longest_px), 0.0)

    def parameter_scales(self, image_size_px: tuple[int, int]) -> Float[ArrayLike, "q"]:
        """Those of the core; for control points, half the diagonal of the picture."""
        xp = array_namespace(self)
        fu = self.focal_length_px[0]
        corner_px = 0.5 * fu * xp.hypot(image_size_px[0] / fu, image_size_px[1] / fu)
        extent = xp.ones(len(_EXTENT), fu.dtype)
        of_control = xp.stack([corner_px] * len(_CONTROL))
        return xp.concatenate([self.core.parameter_scales(image_size_px), extent, of_control])

    def with_focal_factor(self, factor: Float[ArrayLike, "2"]) -> AbstractLens:
        """This lens with focal lengths multiplied, and the correction with them."""
        xp = array_namespace(self, factor)
        scaled = super().with_focal_factor(factor)
        control = (self.control_px * factor[:, None, None]).ravel()
        values = xp.concatenate([self.parameters[: -len(_CONTROL)], control])
        return scaled.with_parameters(xp.concatenate([scaled.parameters[:2], values[2:]]))

    def _correct(self, place: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """A place of the core's picture, in focal lengths, after the correction."""
        in_cells, (du, dv) = self._in_cells(place), self.control_px
        shift_px = jnp.stack([surface(du, in_cells), surface(dv, in_cells)])
        return place + shift_px / self.focal_length_px

    def by_control(self, uv_of_core_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2 k"]:
        """Derivative of a pixel, of a lens without skew, by the control points, the last of its
        parameters. Which count is told by the pixel that the core has.
        """
        along, across = basis(self._in_cells(self.affine_inverse(uv_of_core_px)), ROWS, COLUMNS)
        counts = (along[:, None] * across[None]).ravel()
        none = jnp.zeros_like(counts)
        return jnp.stack([jnp.concatenate([counts, none]), jnp.concatenate([none, counts])])

    def _in_cells(self, place: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """A place of the core's picture, in cells from the corner of the grid."""
        half = jnp.exp(self.coefficients[-len(_CONTROL) - 2 : -len(_CONTROL)])
        return 0.5 * (place / half + 1.0) * _CELLS.astype(place.dtype)

    @classmethod
    def of_core(cls, core: AbstractLens, image_size_px: tuple[int, int]) -> "AbstractSplinedLens":
        """A lens of `core_model`, its correction zero, on a grid that covers the picture."""
        centre, size = np.asarray(core.principal_point_px), np.asarray(image_size_px, float)
        reach_px = np.maximum(centre + 0.5, size - 0.5 - centre)
        half = (1.0 + _MARGIN) * reach_px / np.asarray(core.focal_length_px)
        coefficients = np.concatenate([core.coefficients, np.log(half), np.zeros(len(_CONTROL))])
        return cls(core.focal_length_px, core.principal_point_px, core.skew_px, coefficients)

    @classmethod
    def correction_information(cls) -> Float[np.ndarray, "q q"]:
        """Inverse covariance of `parameters` under a prior on the correction alone.

        The prior has the mean zero and a standard deviation of 1 px over the field, going
        together over four cells of the grid; divide by the square of another sigma for that.
        """
        return _information(cls)


@cache
def _information(model: type[AbstractSplinedLens]) -> Float[np.ndarray, "q q"]:
    information = np.zeros((len(model.parameter_names),) * 2)
    count = len(_CONTROL)
    information[-count:, -count:] = np.kron(np.eye(2), smoothness(ROWS, COLUMNS, _REACH))
    return information


class SplinedBrownConrady(AbstractSplinedLens):
    """`BrownConrady` with a correction."""

    core_model: ClassVar[type[AbstractLens]] = BrownConrady


class SplinedRational(AbstractSplinedLens):
    """`Rational` with a correction."""

    core_model: ClassVar[type[AbstractLens]] = Rational


class SplinedKannalaBrandt(AbstractSplinedLens):
    """`KannalaBrandt` with a correction."""

    core_model: ClassVar[type[AbstractLens]] = KannalaBrandt


# The splined lens of each core.
SPLINED: dict[type[AbstractLens], type[AbstractSplinedLens]] = {
    lens.core_model: lens for lens in (SplinedBrownConrady, SplinedRational, SplinedKannalaBrandt)
}
