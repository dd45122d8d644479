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

    r is the angle between the ray and the optical axis in rad, or the tangent of this angle. The
    image radius is in focal lengths.

    Attributes
    ----------
    numerator, denominator : tuple of float
        Coefficients of the polynomials N and D, highest power of r^2 first; the last one is 1.
    by_angle : bool
        True: r is the angle. False: r is the tangent of the angle.
    tangential : tuple of float
        Polynomial in r: an upper bound on the derivative, with respect to r, of the remaining
        distortion (tangential, prism). Coefficients, highest power of r first; the last one is 0.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...] = (1.0,)
    by_angle: bool = False
    tangential: tuple[float, ...] = (0.0,)

    @property
    def fold(self) -> float:
        """Smallest r at which the image radius stops growing in some direction, or D becomes 0.

        Infinite if the distortion does not fold. r is as in the class: an angle in rad, or a
        tangent.
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
        """Image radius r N(r^2) / D(r^2) of rays at r, in focal lengths."""
        with np.errstate(all="ignore"):
            return r * np.polyval(self.numerator, r * r) / np.polyval(self.denominator, r * r)

    def slope(self, r: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Derivative of `radius` by r."""
        with np.errstate(all="ignore"):
            return np.polyval(self._slope, r * r) / np.polyval(self.denominator, r * r) ** 2

    @property
    def _slope(self) -> Float[np.ndarray, "k"]:
        """Numerator of the derivative `slope`: coefficients (k,), highest power of r^2 first.

        The denominator is D^2.
        """
        above, below = np.array(self.numerator), np.array(self.denominator)
        change = np.polysub(
            np.polymul(np.polyder(above), below), np.polymul(above, np.polyder(below))
        )
        return np.polyadd(np.polymul(above, below), np.polymul([2.0, 0.0], change))


@lru_cache(maxsize=1024)
def _valid_radius(radial: RadialPart, steps: int, least_slope: float) -> float:
    """Largest image radius, in focal lengths, at which rays and pixels are one to one.

    Up to this radius, Newton's method also finds the ray of every pixel, in all directions.
    Infinite if the distortion does not fold. `steps` and `least_slope` are the settings
    `AbstractLens.newton`.
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
    """Coefficients (2 k - 1,) in powers of r of a polynomial (k,) in powers of r^2."""
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
    """A lens of one model: the mapping from rays of the camera frame to pixels.

    A lens distorts a ray (`distort`) and then maps the result to a pixel by the calibration matrix
    K. Rays are (x, y, z) in the camera frame, of any length, so that a lens may image rays beyond
    90 degrees from the axis. All fields are arrays, so that lenses of one model can be stacked. A
    new model is a subclass with `distort`, `undistort` and the class variables below, and a line in
    `lenses.registry`.

    Attributes
    ----------
    focal_length_px : (2,)
        Focal length along u and v.
    principal_point_px : (2,)
        Pixel of the optical axis.
    skew_px : ()
        Entry K[0, 1]; 0 for every real sensor. Only lenses of `lenses.skewed` estimate the skew.
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
        Numbers of coefficients that a fit may estimate: the first n of `coefficient_names`.
    dispensable : tuple of str
        Coefficients that a fit may fix at 0, in this order, if the images do not determine all.
    zero_is_ideal : bool
        True if the lens with all coefficients zero is a `Pinhole`.
    never_fitted : tuple of str
        Coefficients that define the domain of other coefficients. No fit estimates them.
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
        """Distorted normalised coordinates (2,) of a ray. K maps them to the pixel of the ray."""

    @abc.abstractmethod
    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """Return a ray (3,), of any length, that `distort` maps to the coordinates `distorted`."""

    @property
    def has_distortion(self) -> bool:
        """True if the model has coefficients of distortion."""
        return bool(self.coefficient_names)

    def radial_part(self) -> RadialPart | None:
        """Radial part of the distortion, from which the radius of the fold is computed.

        None for a pinhole, or for a model that does not define a radial part. Not usable
        inside `jit`: the parameters must be numbers.
        """
        return None

    def fold_angle_rad(self) -> float:
        """Angle from the optical axis up to which rays and image points are one to one.

        At larger angles the radial distortion folds, or no ray exists.
        """
        radial = self.radial_part()
        if radial is None:
            return float(np.pi / 2)
        return min(radial.fold, np.pi) if radial.by_angle else float(np.arctan(radial.fold))

    def valid_radius_px(self) -> float:
        """Distance from the principal point, px, up to which rays and pixels are one to one.

        Infinite if the distortion never folds. Otherwise the distance at which a ray at 95 % of
        `RadialPart.fold` is imaged. Nearer to the fold, Newton's method does not converge. Not
        usable inside `jit`: the parameters must be numbers.
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
        """Replace values that belong to pixels by NaN if the pixels lie beyond `valid_radius_px`.

        Inside `jit` the values are returned unchanged, because the fold is not computed there.
        """
        if is_traced(self) or self.valid_radius_px() == np.inf:
            return values
        xp = array_namespace(uv_px, values)
        return xp.where(self.is_valid_pixel(uv_px)[..., None], values, np.nan)

    def mask_ray(
        self, ray_cam: Float[ArrayLike, "*n 3"], uv_px: Float[ArrayLike, "*n 2"]
    ) -> Float[ArrayLike, "*n 2"]:
        """Replace pixels by NaN if the rays that they image lie beyond the fold.

        Inside `jit` the pixels are returned unchanged, because the fold is not computed there.
        """
        if is_traced(self) or self.valid_radius_px() == np.inf:
            return uv_px
        xp = array_namespace(ray_cam, uv_px)
        cosine = np.cos(self.fold_angle_rad())
        is_inside_fold = ray_cam[..., 2] > cosine * xp.sqrt((ray_cam * ray_cam).sum(-1))
        return xp.where((is_inside_fold & self.is_valid_pixel(uv_px))[..., None], uv_px, np.nan)

    def is_valid_pixel(self, uv_px: Float[ArrayLike, "*n 2"]) -> Bool[ArrayLike, "*n"]:
        """Return True for pixels within `valid_radius_px` of the principal point, (n,)."""
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
        """Pixel (2,) that images a ray of the camera frame, lens distortion included."""
        return self.affine(self.distort(ray_cam))

    def unproject(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """Return the unit ray (3,) of a pixel, in the camera frame."""
        ray = self.undistort(self.affine_inverse(uv_px))
        return ray / jnp.sqrt(ray @ ray)

    def pixel_from_normalised(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) that images the ray (x/z, y/z, 1), lens distortion included."""
        return self.project_ray(ray_of_normalised(normalised))

    def normalised_from_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates (x/z, y/z) of the ray of a pixel. The ray must have z > 0."""
        ray = self.undistort(self.affine_inverse(uv_px))
        return ray[:2] / ray[2]

    def undistort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) at which the same ray would be imaged without distortion."""
        if not self.has_distortion:
            return uv_px
        return self.affine(self.normalised_from_pixel(uv_px))

    def distort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) of the real image for an undistorted pixel; inverse of `undistort_pixel`."""
        if not self.has_distortion:
            return uv_px
        return self.pixel_from_normalised(self.affine_inverse(uv_px))

    def affine(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) to which the calibration matrix K alone maps normalised coordinates."""
        skewed = jnp.stack([self.skew_px * normalised[1], jnp.zeros_like(normalised[1])])
        return self.focal_length_px * normalised + skewed + self.principal_point_px

    def affine_inverse(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates (2,) that K maps to a pixel; inverse of `affine`."""
        (fu, fv), (cu, cv) = self.focal_length_px, self.principal_point_px
        y = (uv_px[1] - cv) / fv
        return jnp.stack([(uv_px[0] - cu - self.skew_px * y) / fu, y])

    @property
    def parameters(self) -> Float[ArrayLike, "q"]:
        """Focal lengths, principal point, coefficients, in the order of `parameter_names`, (q,)."""
        xp = array_namespace(self)
        return xp.concatenate([self.focal_length_px, self.principal_point_px, self.coefficients])

    @classmethod
    def from_parameters(cls, values: Float[ArrayLike, "q"]) -> "AbstractLens":
        """Create a lens with skew 0 from values (q,) in the order of `parameter_names`."""
        affine = len(AFFINE_PARAMETERS)
        return cls(values[:2], values[2:affine], np.zeros((), values.dtype), values[affine:])

    def with_parameters(self, values: Float[ArrayLike, "q"]) -> "AbstractLens":
        """Copy of this lens with other parameter values (q,), in the order of `parameter_names`."""
        affine = len(AFFINE_PARAMETERS)
        return type(self)(values[:2], values[2:affine], self.skew_px, values[affine:])

    def parameter_scales(self, image_size_px: tuple[int, int]) -> Float[ArrayLike, "q"]:
        """Step size of each parameter that moves the image corners by similar amounts, (q,).

        A step of s times the size moves an image corner by about s times the corner's distance
        from the principal point. The exception is a step of the principal point: it moves the
        corner by s focal lengths.
        """
        xp = array_namespace(self)
        fu, fv = self.focal_length_px[0], self.focal_length_px[1]
        radius = 0.5 * xp.hypot(image_size_px[0] / fu, image_size_px[1] / fv)
        powers = [radius ** -float(power) for power in self.coefficient_powers]
        return xp.stack([fu, fv, fu, fv, *powers])

    def retract(self, delta: Float[ArrayLike, "k"]) -> "AbstractLens":
        """Copy of this lens with the step `delta` (k,) added to the first k of `parameters`."""
        xp = array_namespace(self, delta)
        missing = len(self.parameter_names) - delta.shape[0]
        change = xp.concatenate([delta, xp.zeros(missing, delta.dtype)])
        return self.with_parameters(self.parameters + change)

    def with_focal_factor(self, factor: Float[ArrayLike, "2"]) -> "AbstractLens":
        """Copy of this lens with the two focal lengths multiplied by the two numbers of `factor`.

        The skew is multiplied by the first number.
        """
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
        """Distorted normalised coordinates (2,) of the undistorted ones, (x/z, y/z)."""

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """Distorted normalised coordinates (2,) of a ray."""
        return self.distort_ideal(ray_cam[:2] / ray_cam[2])

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """Ray (x, y, 1) that `distort` maps to `distorted`, by `inverse_in_plane`.

        The result is meaningless beyond the fold of the distortion.
        """
        return ray_of_normalised(inverse_in_plane(self.distort_ideal, distorted))


def ray_of_normalised(normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
    """Ray (x, y, 1) of normalised coordinates (x, y)."""
    return jnp.stack([normalised[0], normalised[1], jnp.ones_like(normalised[0])])
