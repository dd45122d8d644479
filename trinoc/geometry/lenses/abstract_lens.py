"""A lens: where in the picture a ray of the camera frame is imaged, and the way back."""

import abc
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from trinoc.geometry.lenses.newton import NEWTON_STEPS, inverse_in_plane
from trinoc.numerics.precision import ArrayLike, array_namespace, is_traced
from trinoc.numerics.values import Value

# Type checkers know this one by the name that it has in a class that is not abstract.
if TYPE_CHECKING:
    from typing import ClassVar as AbstractClassVar
else:
    from equinox import AbstractClassVar

# The parameters of K that are fitted, which every lens has; its coefficients come after them.
AFFINE_PARAMETERS = ("fx_px", "fy_px", "cx_px", "cy_px")
# Share of the fold's distance from the axis up to which a lens is used: at 0.98, Newton's method
# fails for one in a hundred random lenses, and the radius in the image grows by 0.3 % only.
_SHARE_OF_FOLD = 0.95
# numerical: radii at which Newton's method is tried, and by what share of the fold it may miss.
_RADII, _RETURNS = 257, 1e-9
# numerical: rounding of a pixel on the way there and back.
_SLACK_PX = 1e-6


class RadialPart(NamedTuple):
    """A ray at r from the optical axis is imaged at the radius r N(r^2) / D(r^2).

    Fields
    ------
    numerator, denominator : coefficients of N and D, the highest power of r^2 first, the last 1.
    by_angle : whether r is the angle from the axis, in rad, or its tangent.
    tangential : coefficients of a bound on the derivative of everything else that the lens does,
        the highest power of r first, the last 0.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...] = (1.0,)
    by_angle: bool = False
    tangential: tuple[float, ...] = (0.0,)

    @property
    def fold(self) -> float:
        """Smallest r at which some direction stops to grow, or D is 0; infinite without one."""
        # Coefficients near zero put the fold beyond what floats hold.
        with np.errstate(all="ignore"):
            slope, below = self._slope, np.array(self.denominator)
            if any(self.tangential):
                lost = np.polymul(self.tangential, _in_r(np.polymul(below, below)))
                growth = _smallest_root(np.polysub(_in_r(slope), lost))
            else:
                growth = np.sqrt(_smallest_root(slope))
            return float(min(growth, np.sqrt(_smallest_root(below))))

    def radius(self, r: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """r N(r^2) / D(r^2)."""
        with np.errstate(all="ignore"):
            return r * np.polyval(self.numerator, r * r) / np.polyval(self.denominator, r * r)

    def slope(self, r: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Derivative of `radius`."""
        with np.errstate(all="ignore"):
            return np.polyval(self._slope, r * r) / np.polyval(self.denominator, r * r) ** 2

    @property
    def _slope(self) -> Float[np.ndarray, "k"]:
        """Numerator of the derivative by r, in powers of r^2, over D^2."""
        above, below = np.array(self.numerator), np.array(self.denominator)
        change = np.polysub(
            np.polymul(np.polyder(above), below), np.polymul(above, np.polyder(below))
        )
        return np.polyadd(np.polymul(above, below), np.polymul([2.0, 0.0], change))


@lru_cache(maxsize=1024)
def _valid_radius(radial: RadialPart, steps: int, least_slope: float) -> float:
    """Largest radius up to which rays and pixels are one to one in all directions and Newton's
    method takes pixels back to their rays; infinite without a fold.

    steps, least_slope : of the lens's own Newton's method.
    """
    fold, (low, limit) = radial.fold, (0.0, np.pi) if radial.by_angle else (-np.inf, np.inf)
    if not fold < limit:
        return float("inf")
    r = _SHARE_OF_FOLD * fold * np.linspace(0.0, 1.0, _RADII)
    # Along the radius, everything else adds as much, or takes as much away.
    sign = np.array([[-1.0], [0.0], [1.0]]) if any(radial.tangential) else np.zeros((1, 1))
    added = np.polyint(radial.tangential)

    def place(r: Float[np.ndarray, "s n"]) -> Float[np.ndarray, "s n"]:
        return radial.radius(r) + sign * np.polyval(added, r)

    with np.errstate(all="ignore"):
        radius = place(r)
        returned = np.clip(radius, low, limit)
        for _ in range(steps - 1):
            slope = radial.slope(returned) + sign * np.polyval(radial.tangential, returned)
            step = (place(returned) - radius) / np.maximum(slope, least_slope)
            returned = np.clip(returned - step, low, limit)
        # It begins at the radius itself, which must not lie beyond the fold.
        good = ((np.abs(returned - r) <= _RETURNS * fold) & (radius <= r[-1])).all(axis=0)
    count = len(r) if good.all() else int(np.argmin(good))
    return max(float(radius[0, max(count - 1, 0)]), 0.0)


def _in_r(polynomial: Float[np.ndarray, "k"]) -> Float[np.ndarray, "n"]:
    """A polynomial of r^2 as one of r."""
    of_r = np.zeros(2 * len(polynomial) - 1)
    of_r[::2] = polynomial
    return of_r


def _smallest_root(polynomial: Float[np.ndarray, "k"]) -> float:
    """The smallest positive real root; infinite without one."""
    polynomial = np.where(np.abs(polynomial) < 1e-30, 0.0, polynomial)
    roots = np.roots(polynomial)
    positive = (np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)
    return float(roots.real[positive].min(initial=np.inf))


class AbstractLens(Value):
    """A lens of one model; all its fields are arrays, so that lenses of one model stack.

    A lens bends rays (`distort`) and then maps them to pixels by the calibration matrix K. A model
    is a subclass with these two and the class variables below, and a line in `lenses.registry`.
    Rays are (x, y, z) in the camera frame and of any length, so that a lens may see beyond
    90 degrees.

    Fields
    ------
    focal_length_px : (2,) along u and v.
    principal_point_px : (2,)
    skew_px : () entry K[0, 1]; 0 for every real sensor; fitted by `lenses.skewed` alone.
    coefficients : (c,) of the distortion.

    Class variables
    ---------------
    model : name of the model, in files.
    coefficient_names : of `coefficients`.
    parameter_names : AFFINE_PARAMETERS and `coefficient_names`, the order of `parameters`.
    coefficient_powers : for each coefficient the power of the distance from the optical axis, in
        focal lengths, with which the distortion that it describes grows, over that distance.
    coefficient_counts : numbers of coefficients that people fit; the first so many of their names.
    dispensable : coefficients to give up, one after the other, where pictures do not determine
        all.
    zero_is_ideal : whether the lens with all coefficients zero is `Pinhole`.
    never_fitted : coefficients that say where others apply: they are held as they are given.
    newton : steps of Newton's method in `undistort`, and the least slope that it takes.
    """

    focal_length_px: Float[ArrayLike, "2"]
    principal_point_px: Float[ArrayLike, "2"]
    skew_px: Float[ArrayLike, ""]
    coefficients: Float[ArrayLike, "c"]

    model: AbstractClassVar[str]
    coefficient_names: AbstractClassVar[tuple[str, ...]]
    parameter_names: AbstractClassVar[tuple[str, ...]]
    coefficient_powers: AbstractClassVar[tuple[int, ...]]
    coefficient_counts: AbstractClassVar[tuple[int, ...]]
    dispensable: AbstractClassVar[tuple[str, ...]]
    zero_is_ideal: ClassVar[bool] = True
    never_fitted: ClassVar[tuple[str, ...]] = ()
    newton: ClassVar[tuple[int, float]] = (NEWTON_STEPS, -np.inf)

    @abc.abstractmethod
    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """K^-1 (u, v, 1) of the pixel that images a ray."""

    @abc.abstractmethod
    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """A ray, of any length, that `distort` maps here."""

    @property
    def has_distortion(self) -> bool:
        """Whether the lens is of a model that bends rays."""
        return bool(self.coefficient_names)

    def radial_part(self) -> RadialPart | None:
        """The distortion along the direction from the axis, of numbers that are not traced; None
        where the lens has none or its model does not say."""
        return None

    def fold_angle_rad(self) -> float:
        """Angle from the optical axis up to which rays and places of the picture are one to one.

        Beyond, the radial part of the distortion folds back, or there is no ray.
        """
        radial = self.radial_part()
        if radial is None:
            return float(np.pi / 2)
        return min(radial.fold, np.pi) if radial.by_angle else float(np.arctan(radial.fold))

    def valid_radius_px(self) -> float:
        """Distance from the principal point, in pixels, up to which rays and pixels are one to one;
        infinite where the distortion never folds back.

        It ends where the ray is at 95 % of the fold's distance from the axis: nearer to the fold,
        Newton's method no longer finds the ray. The lens must not be traced.
        """
        radial = self.radial_part()
        radius = float("inf") if radial is None else _valid_radius(radial, *self.newton)
        if radius == np.inf:
            return radius
        # Of the ellipse that K makes of a circle, the smaller half axis.
        (fu, fv), skew = self.focal_length_px, self.skew_px
        focal_px = np.linalg.svd([[fu, skew], [0.0, fv]], compute_uv=False)[1]
        return float(focal_px * radius)

    def mask_pixel(
        self, uv_px: Float[ArrayLike, "*n 2"], values: Float[ArrayLike, "*n k"]
    ) -> Float[ArrayLike, "*n k"]:
        """What is computed of pixels, NaN for those beyond `valid_radius_px`.

        As it is for a lens that is traced, whose fold is not known.
        """
        if is_traced(self) or self.valid_radius_px() == np.inf:
            return values
        xp = array_namespace(uv_px, values)
        return xp.where(self.is_valid_pixel(uv_px)[..., None], values, np.nan)

    def mask_ray(
        self, ray_cam: Float[ArrayLike, "*n 3"], uv_px: Float[ArrayLike, "*n 2"]
    ) -> Float[ArrayLike, "*n 2"]:
        """Pixels that image rays, NaN for those beyond the fold.

        As they are for a lens that is traced, whose fold is not known.
        """
        if is_traced(self) or self.valid_radius_px() == np.inf:
            return uv_px
        xp = array_namespace(ray_cam, uv_px)
        cosine = np.cos(self.fold_angle_rad())
        before = ray_cam[..., 2] > cosine * xp.sqrt((ray_cam * ray_cam).sum(-1))
        return xp.where((before & self.is_valid_pixel(uv_px))[..., None], uv_px, np.nan)

    def is_valid_pixel(self, uv_px: Float[ArrayLike, "*n 2"]) -> Bool[ArrayLike, "*n"]:
        """Whether pixels lie within `valid_radius_px`."""
        offset = uv_px - self.principal_point_px
        return (offset * offset).sum(-1) <= (self.valid_radius_px() + _SLACK_PX) ** 2

    @property
    def matrix(self) -> Float[ArrayLike, "3 3"]:
        """K, which maps what `distort` gives to pixels."""
        (fu, fv), (cu, cv) = self.focal_length_px, self.principal_point_px
        xp = array_namespace(fu, fv, cu, cv, self.skew_px)
        zero, one = xp.zeros_like(fu), xp.ones_like(fu)
        rows = [[fu, xp.asarray(self.skew_px), cu], [zero, fv, cv], [zero, zero, one]]
        return xp.stack([xp.stack(row) for row in rows])

    def project_ray(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """The pixel that images a ray."""
        return self.affine(self.distort(ray_cam))

    def unproject(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """The unit ray, in the camera frame, that a pixel images."""
        ray = self.undistort(self.affine_inverse(uv_px))
        return ray / jnp.sqrt(ray @ ray)

    def pixel_from_normalised(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """The pixel that images the ray (x/z, y/z, 1)."""
        return self.project_ray(ray_of_normalised(normalised))

    def normalised_from_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """(x/z, y/z) of the ray of a pixel, which must look forward."""
        ray = self.undistort(self.affine_inverse(uv_px))
        return ray[:2] / ray[2]

    def undistort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """The pixel at which the same ray would be imaged without distortion."""
        if not self.has_distortion:
            return uv_px
        return self.affine(self.normalised_from_pixel(uv_px))

    def distort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Inverse of `undistort_pixel`."""
        if not self.has_distortion:
            return uv_px
        return self.pixel_from_normalised(self.affine_inverse(uv_px))

    def affine(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """The calibration matrix K alone: the pixel without distortion."""
        skewed = jnp.stack([self.skew_px * normalised[1], jnp.zeros_like(normalised[1])])
        return self.focal_length_px * normalised + skewed + self.principal_point_px

    def affine_inverse(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Inverse of `affine`."""
        (fu, fv), (cu, cv) = self.focal_length_px, self.principal_point_px
        y = (uv_px[1] - cv) / fv
        return jnp.stack([(uv_px[0] - cu - self.skew_px * y) / fu, y])

    @property
    def parameters(self) -> Float[ArrayLike, "q"]:
        """Values of `parameter_names`."""
        xp = array_namespace(self)
        return xp.concatenate([self.focal_length_px, self.principal_point_px, self.coefficients])

    @classmethod
    def from_parameters(cls, values: Float[ArrayLike, "q"]) -> "AbstractLens":
        """A lens without skew from the values of `parameter_names`."""
        affine = len(AFFINE_PARAMETERS)
        return cls(values[:2], values[2:affine], np.zeros((), values.dtype), values[affine:])

    def with_parameters(self, values: Float[ArrayLike, "q"]) -> "AbstractLens":
        """This lens with other values of `parameter_names`."""
        affine = len(AFFINE_PARAMETERS)
        return type(self)(values[:2], values[2:affine], self.skew_px, values[affine:])

    def parameter_scales(self, image_size_px: tuple[int, int]) -> Float[ArrayLike, "q"]:
        """Changes of `parameters` that move the corners of the picture about equally.

        A step of s in units of these moves a corner by about s times its distance from the
        principal point, or by s focal lengths for the principal point itself.
        """
        xp = array_namespace(self)
        fu, fv = self.focal_length_px[0], self.focal_length_px[1]
        radius = 0.5 * xp.hypot(image_size_px[0] / fu, image_size_px[1] / fv)
        powers = [radius ** -float(power) for power in self.coefficient_powers]
        return xp.stack([fu, fv, fu, fv, *powers])

    def retract(self, delta: Float[ArrayLike, "k"]) -> "AbstractLens":
        """This lens after a change of the first k of `parameters`; zero leaves it as it is."""
        xp = array_namespace(self, delta)
        missing = len(self.parameter_names) - delta.shape[0]
        change = xp.concatenate([delta, xp.zeros(missing, delta.dtype)])
        return self.with_parameters(self.parameters + change)

    def with_focal_factor(self, factor: Float[ArrayLike, "2"]) -> "AbstractLens":
        """This lens with focal lengths, and the skew with the first, multiplied."""
        return type(self)(
            self.focal_length_px * factor,
            self.principal_point_px,
            self.skew_px * factor[0],
            self.coefficients,
        )


class AbstractPlaneLens(AbstractLens):
    """A lens that moves the ideal place (x/z, y/z) of a ray in its plane."""

    @abc.abstractmethod
    def distort_ideal(self, ideal: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates (x/z, y/z) of an ideal pinhole to those that the lens produces."""

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates of the ray after the distortion."""
        return self.distort_ideal(ray_cam[:2] / ray_cam[2])

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """(x, y, 1), by Newton's method: see `inverse_in_plane` for where there is one."""
        return ray_of_normalised(inverse_in_plane(self.distort_ideal, distorted))


def ray_of_normalised(normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
    """(x, y, 1)."""
    return jnp.stack([normalised[0], normalised[1], jnp.ones_like(normalised[0])])
