"""Splined lenses: a polynomial lens plus a correction by a bicubic B-spline surface.

The correction is a smooth function on the distorted image of the polynomial lens, its core. So its
inverse is a small step in the plane. All rays are those of the core, also beyond 90 degrees. The
idea is from mrcal's splined models, whose surface lies over a stereographic projection.
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


# Number of control points whose basis functions overlap a cell, along each side.
ORDER = 4


def surface(
    control: Float[ArrayLike, "rows columns"], position: Float[ArrayLike, "2"]
) -> Float[ArrayLike, ""]:
    """Height of a bicubic B-spline surface at a grid position.

    Parameters
    ----------
    control : (rows, columns)
        Heights of the control points.
    position : (2,)
        Position (along columns, along rows) in cells from the first corner of the grid. A position
        outside the grid is moved to the nearest grid position.

    Returns
    -------
    ()
        Height in the unit of `control`.
    """
    rows, columns = control.shape
    along, across = basis(position, rows, columns)
    return along @ control @ across


def basis(
    position: Float[ArrayLike, "2"], rows: int, columns: int
) -> tuple[Float[ArrayLike, "rows"], Float[ArrayLike, "columns"]]:
    """Weights of the control points' rows (r,) and columns (c,) at a grid position.

    The height of the surface is rows^T control columns. `position` is as in `surface`.
    """
    return _basis(position[1], rows), _basis(position[0], columns)


def _basis(position: Float[ArrayLike, ""], count: int) -> Float[ArrayLike, "n"]:
    """Values at one position of the B-spline basis functions along one side of the grid, (n,).

    They sum to one. At most four are not zero, but all n are computed: a derivative by many control
    points is then one matrix product, which is faster than gathering.
    """
    inside = jnp.clip(position, 0.0, float(count - ORDER + 1))
    separation = jnp.abs(inside - (np.arange(count) - 1.0).astype(inside.dtype))
    inner, outer = jnp.maximum(1.0 - separation, 0.0), jnp.maximum(2.0 - separation, 0.0)
    return (outer**3 - 4.0 * inner**3) / 6.0


def smoothness(rows: int, columns: int, correlation_cells: float) -> Float[np.ndarray, "n n"]:
    """Inverse covariance (n, n) of the control points of a smooth random surface of variance 1.

    Parameters
    ----------
    rows, columns : int
        Size of the grid; the n = rows * columns control points are in row-major order.
    correlation_cells : float
        Correlation length of the heights, in cells.

    Notes
    -----
    The surface has a Matern covariance of smoothness 1; its variance is 1 on average over the grid.

    References
    ----------
    F. Lindgren, H. Rue and J. Lindstrom, "An explicit link between Gaussian fields and Gaussian
    Markov random fields", J. R. Statist. Soc. B 73(4), 2011.
    """
    second_difference = np.kron(_second_difference(rows), np.eye(columns)) + np.kron(
        np.eye(rows), _second_difference(columns)
    )
    root = 8.0 / correlation_cells**2 * np.eye(rows * columns) + second_difference
    information = root @ root
    heights = np.kron(_heights(rows), _heights(columns))
    variance = np.einsum("hi,ij,hj->h", heights, np.linalg.inv(information), heights)
    return float(variance.mean()) * information


def _second_difference(count: int) -> Float[np.ndarray, "n n"]:
    """Negative second-difference matrix (n, n) of the control points along one side of the grid.

    The slope is zero at both ends.
    """
    step = np.diff(np.eye(count), axis=0)
    return step.T @ step


def _heights(count: int) -> Float[np.ndarray, "h n"]:
    """Matrix (h, n) from the control points of one side to surface heights at h cell corners."""
    previous, middle = (np.eye(count - ORDER + 2, count, k=k) for k in (0, 1))
    return (previous + 4.0 * middle + np.eye(count - ORDER + 2, count, k=2)) / 6.0


ROWS, COLUMNS = 10, 12
_CELLS = np.array([COLUMNS, ROWS]) - ORDER + 1
_EXTENT = ("log_half_u", "log_half_v")
_CONTROL = tuple(f"{d}_{r}_{c}" for d in ("du", "dv") for r in range(ROWS) for c in range(COLUMNS))
_ADDED = (*_EXTENT, *_CONTROL)
# Names of the coefficients of the correction, for messages that summarise them.
SPLINE_PARAMETERS = frozenset(_ADDED)
_POWERS = (0,) * len(_ADDED)
# The grid extends beyond the image edges by this share.
_MARGIN = 0.02
# For a correction of 5 px, four steps converge to rounding.
_NEWTON_STEPS = 5
# Prior correlation length of the correction, cells.
_CORRELATION_CELLS = 4.0


class AbstractSplinedLens(AbstractLens):
    """A core lens whose image points are displaced by a correction (du, dv), a bicubic B-spline.

    The coefficients are, in this order: those of the core; the logarithms of half the grid's extent
    along u and v; the control points, 10 rows of 12 for du, then for dv, in px. The extent is in
    focal lengths from the principal point and no fit estimates it. Outside the grid the correction
    is that of the nearest grid point.
    """

    core_model: AbstractClassVar[type[AbstractLens]]
    control_count: ClassVar[int] = len(_CONTROL)
    never_fitted: ClassVar[tuple[str, ...]] = _EXTENT

    def __init_subclass__(cls) -> None:
        """Set the class variables: those of the core model, plus grid extent and control points."""
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
        """The core lens, without the correction."""
        count = len(self.core_model.coefficient_names)
        return self.core_model(
            self.focal_length_px, self.principal_point_px, self.skew_px, self.coefficients[:count]
        )

    @property
    def control_px(self) -> Float[ArrayLike, "2 rows columns"]:
        """Control points of the correction, (2, rows, columns) px: first du, then dv."""
        return self.coefficients[-len(_CONTROL) :].reshape(2, ROWS, COLUMNS)

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """Distorted normalised coordinates (2,) of a ray: those of the core plus the correction."""
        return self._correct(self.core.distort(ray_cam))

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """Ray (3,) that `distort` maps to `distorted`; Newton's method inverts the correction."""
        of_core = inverse_in_plane(self._correct, distorted, _NEWTON_STEPS)
        return self.core.undistort(of_core)

    def radial_part(self) -> RadialPart | None:
        """Radial part of the core lens's distortion, without the spline correction."""
        return self.core.radial_part()

    def steepness(self) -> float:
        """Upper bound on the gradient of the correction: change of the correction in px per pixel.

        Below 1, the corrected image is one to one with that of the core. Not usable inside `jit`:
        the parameters must be numbers.
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
        """Valid radius of the core minus the largest correction, px; 0 if the correction folds.

        The correction folds if `steepness` is 1 or more.
        """
        if not self.steepness() < 1.0:
            return 0.0
        largest_px = np.linalg.norm(np.abs(np.asarray(self.control_px)).max(axis=(1, 2)))
        return max(self.core.valid_radius_px() - float(largest_px), 0.0)

    def parameter_scales(self, image_size_px: tuple[int, int]) -> Float[ArrayLike, "q"]:
        """Step size of each parameter that moves the image corners by similar amounts, (q,).

        First the parameters of the lens model without splines (`core`), then the half width and
        height of the spline grid (1), then the control points (half the image diagonal, px).
        """
        xp = array_namespace(self)
        fu = self.focal_length_px[0]
        corner_px = 0.5 * fu * xp.hypot(image_size_px[0] / fu, image_size_px[1] / fu)
        extent = xp.ones(len(_EXTENT), fu.dtype)
        of_control = xp.stack([corner_px] * len(_CONTROL))
        return xp.concatenate([self.core.parameter_scales(image_size_px), extent, of_control])

    def with_focal_factor(self, factor: Float[ArrayLike, "2"]) -> AbstractLens:
        """Copy of this lens with focal lengths and correction multiplied by `factor`.

        The first number of `factor` applies to u, the second to v.
        """
        xp = array_namespace(self, factor)
        scaled = super().with_focal_factor(factor)
        control = (self.control_px * factor[:, None, None]).ravel()
        values = xp.concatenate([self.parameters[: -len(_CONTROL)], control])
        return scaled.with_parameters(xp.concatenate([scaled.parameters[:2], values[2:]]))

    def _correct(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Add the correction to distorted normalised coordinates of the core, (2,)."""
        in_cells, (du, dv) = self._in_cells(normalised), self.control_px
        shift_px = jnp.stack([surface(du, in_cells), surface(dv, in_cells)])
        return normalised + shift_px / self.focal_length_px

    def by_control(self, uv_of_core_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2 k"]:
        """Derivative (2, k) of a pixel by the k control points, for a lens without skew.

        `uv_of_core_px` is the pixel at which the core images the same ray.
        """
        along, across = basis(self._in_cells(self.affine_inverse(uv_of_core_px)), ROWS, COLUMNS)
        counts = (along[:, None] * across[None]).ravel()
        none = jnp.zeros_like(counts)
        return jnp.stack([jnp.concatenate([counts, none]), jnp.concatenate([none, counts])])

    def _in_cells(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Convert distorted coordinates of the core to a grid position in cells, (2,)."""
        half = jnp.exp(self.coefficients[-len(_CONTROL) - 2 : -len(_CONTROL)])
        return 0.5 * (normalised / half + 1.0) * _CELLS.astype(normalised.dtype)

    @classmethod
    def of_core(cls, core: AbstractLens, image_size_px: tuple[int, int]) -> "AbstractSplinedLens":
        """Create a splined lens with a zero correction on a grid that covers the image."""
        centre, size = np.asarray(core.principal_point_px), np.asarray(image_size_px, float)
        extent_px = np.maximum(centre + 0.5, size - 0.5 - centre)
        half = (1.0 + _MARGIN) * extent_px / np.asarray(core.focal_length_px)
        coefficients = np.concatenate([core.coefficients, np.log(half), np.zeros(len(_CONTROL))])
        return cls(core.focal_length_px, core.principal_point_px, core.skew_px, coefficients)

    @classmethod
    def correction_information(cls) -> Float[np.ndarray, "q q"]:
        """Inverse prior covariance (q, q) of `parameters`: zero except for the control points.

        The prior of the correction has mean 0, a standard deviation of 1 px, and a correlation
        length of four cells. For another standard deviation s in px, divide by s^2.
        """
        return _information(cls)


@cache
def _information(model: type[AbstractSplinedLens]) -> Float[np.ndarray, "q q"]:
    information = np.zeros((len(model.parameter_names),) * 2)
    count = len(_CONTROL)
    information[-count:, -count:] = np.kron(
        np.eye(2), smoothness(ROWS, COLUMNS, _CORRELATION_CELLS)
    )
    return information


class SplinedBrownConrady(AbstractSplinedLens):
    """A `BrownConrady` lens with a spline correction."""

    core_model: ClassVar[type[AbstractLens]] = BrownConrady


class SplinedRational(AbstractSplinedLens):
    """A `Rational` lens with a spline correction."""

    core_model: ClassVar[type[AbstractLens]] = Rational


class SplinedKannalaBrandt(AbstractSplinedLens):
    """A `KannalaBrandt` lens with a spline correction."""

    core_model: ClassVar[type[AbstractLens]] = KannalaBrandt


# The splined lens of each core.
SPLINED: dict[type[AbstractLens], type[AbstractSplinedLens]] = {
    lens.core_model: lens for lens in (SplinedBrownConrady, SplinedRational, SplinedKannalaBrandt)
}
