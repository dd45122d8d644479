"""Interface of a lens model: the mapping from rays of the camera frame to pixels, and back."""

import abc
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from trinoc.geometry.lenses.newton import NEWTON_STEPS, inverse_in_plane
from trinoc.numerics.precision import ArrayLike, array_namespace, is_traced
from trinoc.numerics.values import Value

# Type checkers do not know equinox's AbstractClassVar: they read it as ClassVar.
if TYPE_CHECKING:
    from typing import ClassVar as AbstractClassVar
else:
    from equinox import AbstractClassVar

# The parameters of K that are fitted, which every lens has; its coefficients come after them.
AFFINE_PARAMETERS = ("fx_px", "fy_px", "cx_px", "cy_px")
# Share of the fold's distance from the axis up to which a lens is used: at 0.98, Newton's method
# fails for one in a hundred random lenses, and the radius in the image grows by 0.3 % only.
_SHARE_OF_FOLD = 0.95
# numerical: number of radii at which Newton's method is tested, and its largest error as a share of
# the fold.
_RADII, _RETURNS = 257, 1e-9
# numerical: rounding of a round trip pixel - ray - pixel, px.
_SLACK_PX = 1e-6


class RadialPart(NamedTuple):
    """Radial part of a distortion: a ray at r has the image radius r N(r^2) / D(r^2).

    Attributes
    ----------
    numerator, denominator : tuple of float
        Coefficients of N and D, highest power of r^2 first; the last one is 1.
    by_angle : bool
        True: r is the angle from the optical axis, rad. False: its tangent.
    tangential : tuple of float
        Coefficients of a bound on the derivative of all other distortion, highest power of r first;
        the last one is 0.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...] = (1.0,)
    by_angle: bool = False
    tangential: tuple[float, ...] = (0.0,)

    @property
    def fold(self) -> float:
        """Smallest r at which the distortion folds in some direction, or at which D is 0.

        Infinite without a fold.
        """
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
        """Image radius r N(r^2) / D(r^2), in focal lengths."""
        with np.errstate(all="ignore"):
            return r * np.polyval(self.numerator, r * r) / np.polyval(self.denominator, r * r)

    def slope(self, r: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Derivative of `radius`."""
        with np.errstate(all="ignore"):
            return np.polyval(self._slope, r * r) / np.polyval(self.denominator, r * r) ** 2

    @property
    def _slope(self) -> Float[np.ndarray, "k"]:
        """Numerator of the derivative of the radius, in powers of r^2; the denominator is D^2."""
        above, below = np.array(self.numerator), np.array(self.denominator)
        change = np.polysub(
            np.polymul(np.polyder(above), below), np.polymul(above, np.polyder(below))
        )
        return np.polyadd(np.polymul(above, below), np.polymul([2.0, 0.0], change))


@lru_cache(maxsize=1024)
def _valid_radius(radial: RadialPart, steps: int, least_slope: float) -> float:
    """Largest image radius, in focal lengths, at which rays and pixels are one to one.

    Newton's method must also map each pixel back to its ray, in all directions. Infinite without a
    fold. `steps` and `least_slope` are the settings of the lens's Newton's method.
    """
    fold, (low, limit) = radial.fold, (0.0, np.pi) if radial.by_angle else (-np.inf, np.inf)
    if not fold < limit:
        return float("inf")
    r = _SHARE_OF_FOLD * fold * np.linspace(0.0, 1.0, _RADII)
    # All other distortion adds or subtracts at most this much along the radius.
    sign = np.array([[-1.0], [0.0], [1.0]]) if any(radial.tangential) else np.zeros((1, 1))
    added = np.polyint(radial.tangential)

    def image_radius(r: Float[np.ndarray, "s n"]) -> Float[np.ndarray, "s n"]:
        return radial.radius(r) + sign * np.polyval(added, r)

    with np.errstate(all="ignore"):
        radius = image_radius(r)
        returned = np.clip(radius, low, limit)
        for _ in range(steps - 1):
            slope = radial.slope(returned) + sign * np.polyval(radial.tangential, returned)
            step = (image_radius(returned) - radius) / np.maximum(slope, least_slope)
            returned = np.clip(returned - step, low, limit)
        # Newton's method starts at the image radius, which must not lie beyond the fold.
        converges = ((np.abs(returned - r) <= _RETURNS * fold) & (radius <= r[-1])).all(axis=0)
    count = len(r) if converges.all() else int(np.argmin(converges))
    return max(float(radius[0, max(count - 1, 0)]), 0.0)


def _in_r(polynomial: Float[np.ndarray, "k"]) -> Float[np.ndarray, "n"]:
    """Convert a polynomial in r^2 to one in r."""
    of_r = np.zeros(2 * len(polynomial) - 1)
    of_r[::2] = polynomial
    return of_r


def _smallest_root(polynomial: Float[np.ndarray, "k"]) -> float:
    """Smallest positive real root of a polynomial; infinite if there is none."""
    polynomial = np.where(np.abs(polynomial) < 1e-30, 0.0, polynomial)
    roots = np.roots(polynomial)
    positive = (np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)
    return float(roots.real[positive].min(initial=np.inf))


class AbstractLens(Value):
    """A lens of one model. All fields are arrays, so that lenses of one model can be stacked.

    A lens bends rays (`distort`) and then maps them to pixels by the calibration matrix K. A new
    model is a subclass with `distort`, `undistort` and the class variables below, and a line in
    `lenses.registry`. Rays are (x, y, z) in the camera frame, of any length. So a lens may image
    rays beyond 90 degrees from the axis.

    Attributes
    ----------
    focal_length_px : (2,)
        Focal length along u and v.
    principal_point_px : (2,)
        Pixel of the optical axis.
    skew_px : ()
        Entry K[0, 1]; 0 for every real sensor. Only `lenses.skewed` estimates it.
    coefficients : (c,)
        Coefficients of the distortion.

    Notes
    -----
    Class variables:

    model : str
        Name of the model in files.
    coefficient_names : tuple of str
        Names of `coefficients`.
    parameter_names : tuple of str
        AFFINE_PARAMETERS and `coefficient_names`, the order of `parameters`.
    coefficient_powers : tuple of int
        For each coefficient the power p of its distortion, which grows as r^(1 + p). r is the
        distance from the optical axis in focal lengths.
    coefficient_counts : tuple of int
        Usual numbers of fitted coefficients; each number selects that many first names.
    dispensable : tuple of str
        Coefficients to fix at 0, in this order, if the images do not determine all.
    zero_is_ideal : bool
        True if the lens with all coefficients zero is a `Pinhole`.
    never_fitted : tuple of str
        Coefficients that define the domain of others. They stay fixed.
    newton : (int, float)
        Number of Newton steps in `undistort`, and the smallest slope that a step divides by.
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
        """Distorted normalised coordinates of a ray: K^-1 (u, v, 1) of its pixel, (2,)."""

    @abc.abstractmethod
    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """A ray (3,), of any length, that `distort` maps to these coordinates."""

    @property
    def has_distortion(self) -> bool:
        """True if the model has coefficients of distortion."""
        return bool(self.coefficient_names)

    def radial_part(self) -> RadialPart | None:
        """Radial part of the distortion; None for a pinhole or a model that does not provide it.

        The lens must not be traced.
        """
        return None

    def fold_angle_rad(self) -> float:
        """Angle from the optical axis up to which rays and image points are one to one.

        Beyond it the radial distortion folds, or no ray exists.
        """
        radial = self.radial_part()
        if radial is None:
            return float(np.pi / 2)
        return min(radial.fold, np.pi) if radial.by_angle else float(np.arctan(radial.fold))

    def valid_radius_px(self) -> float:
        """Distance from the principal point, px, up to which rays and pixels are one to one.

        Infinite if the distortion never folds. The limit is the radius of a ray at 95 % of the
        fold's distance from the axis. Nearer to the fold, Newton's method does not converge to the
        ray. The lens must not be traced.
        """
        radial = self.radial_part()
        radius = float("inf") if radial is None else _valid_radius(radial, *self.newton)
        if radius == np.inf:
            return radius
        # K maps a circle to an ellipse: its smaller half axis.
        (fu, fv), skew = self.focal_length_px, self.skew_px
        focal_px = np.linalg.svd([[fu, skew], [0.0, fv]], compute_uv=False)[1]
        return float(focal_px * radius)

    def mask_pixel(
        self, uv_px: Float[ArrayLike, "*n 2"], values: Float[ArrayLike, "*n k"]
    ) -> Float[ArrayLike, "*n k"]:
        """Replace values computed for pixels by NaN beyond `valid_radius_px`.

        Values of a traced lens are returned unchanged, because its fold is unknown.
        """
        if is_traced(self) or self.valid_radius_px() == np.inf:
            return values
        xp = array_namespace(uv_px, values)
        return xp.where(self.is_valid_pixel(uv_px)[..., None], values, np.nan)

    def mask_ray(
        self, ray_cam: Float[ArrayLike, "*n 3"], uv_px: Float[ArrayLike, "*n 2"]
    ) -> Float[ArrayLike, "*n 2"]:
        """Replace pixels by NaN if their rays lie beyond the fold.

        Pixels of a traced lens are returned unchanged, because its fold is unknown.
        """
        if is_traced(self) or self.valid_radius_px() == np.inf:
            return uv_px
        xp = array_namespace(ray_cam, uv_px)
        cosine = np.cos(self.fold_angle_rad())
        before = ray_cam[..., 2] > cosine * xp.sqrt((ray_cam * ray_cam).sum(-1))
        return xp.where((before & self.is_valid_pixel(uv_px))[..., None], uv_px, np.nan)

    def is_valid_pixel(self, uv_px: Float[ArrayLike, "*n 2"]) -> Bool[ArrayLike, "*n"]:
        """Test which pixels lie within `valid_radius_px`, (n,)."""
        offset = uv_px - self.principal_point_px
        return (offset * offset).sum(-1) <= (self.valid_radius_px() + _SLACK_PX) ** 2

    @property
    def matrix(self) -> Float[ArrayLike, "3 3"]:
        """Calibration matrix K (3, 3), from distorted normalised coordinates to pixels."""
        (fu, fv), (cu, cv) = self.focal_length_px, self.principal_point_px
        xp = array_namespace(fu, fv, cu, cv, self.skew_px)
        zero, one = xp.zeros_like(fu), xp.ones_like(fu)
        rows = [[fu, xp.asarray(self.skew_px), cu], [zero, fv, cv], [zero, zero, one]]
        return xp.stack([xp.stack(row) for row in rows])

    def project_ray(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) that images a ray of the camera frame."""
        return self.affine(self.distort(ray_cam))

    def unproject(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """Unit ray (3,), in the camera frame, of a pixel."""
        ray = self.undistort(self.affine_inverse(uv_px))
        return ray / jnp.sqrt(ray @ ray)

    def pixel_from_normalised(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) that images the ray (x/z, y/z, 1)."""
        return self.project_ray(ray_of_normalised(normalised))

    def normalised_from_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Coordinates (x/z, y/z) of the ray of a pixel. The ray must have z > 0."""
        ray = self.undistort(self.affine_inverse(uv_px))
        return ray[:2] / ray[2]

    def undistort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) that would image the same ray without distortion."""
        if not self.has_distortion:
            return uv_px
        return self.affine(self.normalised_from_pixel(uv_px))

    def distort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Inverse of `undistort_pixel`."""
        if not self.has_distortion:
            return uv_px
        return self.pixel_from_normalised(self.affine_inverse(uv_px))

    def affine(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel of normalised coordinates by the calibration matrix K alone, without distortion."""
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
        """Lens with skew 0 from the values of `parameter_names`."""
        affine = len(AFFINE_PARAMETERS)
        return cls(values[:2], values[2:affine], np.zeros((), values.dtype), values[affine:])

    def with_parameters(self, values: Float[ArrayLike, "q"]) -> "AbstractLens":
        """Copy of this lens with other values of `parameter_names`."""
        affine = len(AFFINE_PARAMETERS)
        return type(self)(values[:2], values[2:affine], self.skew_px, values[affine:])

    def parameter_scales(self, image_size_px: tuple[int, int]) -> Float[ArrayLike, "q"]:
        """Changes of `parameters` that displace the image corners by similar amounts, (q,).

        A step s in these units displaces a corner by about s times its distance from the principal
        point. For the principal point the displacement is s focal lengths.
        """
        xp = array_namespace(self)
        fu, fv = self.focal_length_px[0], self.focal_length_px[1]
        radius = 0.5 * xp.hypot(image_size_px[0] / fu, image_size_px[1] / fv)
        powers = [radius ** -float(power) for power in self.coefficient_powers]
        return xp.stack([fu, fv, fu, fv, *powers])

    def retract(self, delta: Float[ArrayLike, "k"]) -> "AbstractLens":
        """Copy of this lens with a change added to the first k of `parameters`."""
        xp = array_namespace(self, delta)
        missing = len(self.parameter_names) - delta.shape[0]
        change = xp.concatenate([delta, xp.zeros(missing, delta.dtype)])
        return self.with_parameters(self.parameters + change)

    def with_focal_factor(self, factor: Float[ArrayLike, "2"]) -> "AbstractLens":
        """Copy of this lens with both focal lengths multiplied; the skew scales with the first."""
        return type(self)(
            self.focal_length_px * factor,
            self.principal_point_px,
            self.skew_px * factor[0],
            self.coefficients,
        )


class AbstractPlaneLens(AbstractLens):
    """A lens whose distortion acts on the normalised coordinates (x/z, y/z)."""

    @abc.abstractmethod
    def distort_ideal(self, ideal: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Distorted normalised coordinates from ideal ones (x/z, y/z), (2,)."""

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates of the ray after the distortion, (2,)."""
        return self.distort_ideal(ray_cam[:2] / ray_cam[2])

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """Ray (x, y, 1), by Newton's method. `inverse_in_plane` describes its domain."""
        return ray_of_normalised(inverse_in_plane(self.distort_ideal, distorted))


def ray_of_normalised(normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
    """Ray (x, y, 1) of normalised coordinates (x, y)."""
    return jnp.stack([normalised[0], normalised[1], jnp.ones_like(normalised[0])])
