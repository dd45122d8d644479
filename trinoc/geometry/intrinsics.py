"""Intrinsics: the mapping from a ray in the camera frame to a pixel, and back."""

from collections.abc import Callable, Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.geometry.lenses.abstract_lens import AbstractLens, ray_of_normalised
from trinoc.geometry.lenses.polynomial import Pinhole
from trinoc.geometry.lenses.registry import DEFAULT_DISTORTION, lens_model
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.numerics.buckets import in_bucket
from trinoc.numerics.precision import (
    ArrayLike,
    FloatOrTraced,
    ScalarLike,
    array_namespace,
    as_float,
    in_float64,
    is_traced,
    real_array,
)
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.values import Value

# Remedy for an argument that must be a lens.
A_LENS = "trinoc.Intrinsics, such as load reads from a camera.json"
# Remedy for a user's lens that folds the image.
FOLD_REMEDY = (
    "check the order, signs and unit of the distortion coefficients, or fit fewer coefficients."
)
# A fold makes a lens unusable if more than this share of the image lies beyond it, or if its
# radius is less than half the shorter side. Wrong coefficients do that; coefficients that are
# undetermined in the corners do not. Published lenses lose up to 0.32.
_MOST_LOST = 1 / 3
# numerical: points along each side of an image, of which the share beyond a fold is counted.
_SHARE_POINTS = 257


class Intrinsics(Value):
    """A lens in front of a sensor: pinhole with optional skew and distortion, and image size.

    Pixel (u, v) = (column, row), with (0, 0) the centre of the top-left pixel. Numbers are stored
    as NumPy float64. Only numbers that JAX traces (`jit`, `grad`, `vmap`) stay JAX values.

    Attributes
    ----------
    lens : AbstractLens
        Lens model with its parameters.
    image_size_px : (width, height)
        Size of the images.
    pixel_pitch_mm : (2,) or None
        Size of a pixel along u and v, mm; None if unknown.
    """

    lens: AbstractLens
    image_size_px: tuple[int, int] = eqx.field(static=True)
    pixel_pitch_mm: tuple[float, float] | None = eqx.field(static=True)

    def __init__(
        self,
        *,
        image_size_px: Sequence[int],
        focal_length_mm: ScalarLike | None = None,
        pixel_pitch_mm: Sequence[float] | float | None = None,
        focal_length_px: Sequence[ScalarLike] | ArrayLike | float | None = None,
        principal_point_px: Sequence[ScalarLike] | ArrayLike | None = None,
        skew_px: ScalarLike = 0.0,
        distortion: Sequence[ScalarLike] | ArrayLike | None = None,
        distortion_model: str | None = None,
    ) -> None:
        """Create intrinsics from a data sheet (mm) or from an earlier calibration (px).

        Parameters
        ----------
        image_size_px : (width, height)
            Size of the images.
        focal_length_mm : float, optional
            Focal length; needs `pixel_pitch_mm`.
        pixel_pitch_mm : float or (2,), optional
            Size of a pixel along u and v, mm.
        focal_length_px : float or (2,), optional
            Replaces `focal_length_mm`: one number, or one along u and one along v.
        principal_point_px : (2,), optional
            Default: the image centre, ((W-1)/2, (H-1)/2).
        skew_px : float
            Entry K[0, 1] of the calibration matrix.
        distortion : sequence, optional
            Coefficients of `distortion_model`; missing last ones are 0. p1 and p2 must be given
            together. None: no distortion.
        distortion_model : str, optional
            A name in `lenses.registry.LENS_MODELS`. Default: Brown-Conrady with up to five
            coefficients k1, k2, p1, p2, k3.

        Raises
        ------
        InputError
            If the numbers cannot describe a camera. Numbers that JAX traces are not checked.
        """
        pitch = None if pixel_pitch_mm is None else _positive_pair("pixel_pitch_mm", pixel_pitch_mm)
        if focal_length_px is not None and focal_length_mm is None:
            focal = _positive_pair("focal_length_px", focal_length_px)
        elif focal_length_mm is not None and focal_length_px is None and pitch is not None:
            focal = _positive_pair("focal_length_mm", focal_length_mm) / pitch
        else:
            raise InputError(
                "The focal length is not determined. Give focal_length_mm with pixel_pitch_mm, "
                "or focal_length_px alone."
            )
        width, height = whole_size_px(image_size_px)
        centre_px = ((width - 1) / 2, (height - 1) / 2)
        model, coefficients = _distortion(distortion, distortion_model)
        self.lens = model(
            focal,
            _array(centre_px if principal_point_px is None else principal_point_px),
            _array(skew_px),
            coefficients,
        )
        self.image_size_px = (width, height)
        self.pixel_pitch_mm = None if pitch is None else (float(pitch[0]), float(pitch[1]))

    def __repr__(self) -> str:
        if is_traced(self):
            return super().__repr__()
        values = zip(self.lens.parameter_names, np.asarray(self.lens.parameters), strict=True)
        numbers = ", ".join(f"{name}={value:.6g}" for name, value in values)
        width, height = self.image_size_px
        return f"<Intrinsics: {width} x {height} px, {self.distortion_model}, {numbers}>"

    @classmethod
    def of_lens(
        cls,
        lens: AbstractLens,
        image_size_px: Sequence[int],
        pixel_pitch_mm: Sequence[float] | None = None,
    ) -> "Intrinsics":
        """Create intrinsics from a lens model object, an image size and an optional pixel pitch."""
        return cls(
            image_size_px=image_size_px,
            focal_length_px=lens.focal_length_px,
            pixel_pitch_mm=pixel_pitch_mm,
            principal_point_px=lens.principal_point_px,
            skew_px=lens.skew_px,
            distortion=lens.coefficients if lens.has_distortion else None,
            distortion_model=lens.model,
        )

    @classmethod
    def from_matrix(
        cls, calibration_matrix: Float[ArrayLike, "3 3"], image_size_px: Sequence[int]
    ) -> "Intrinsics":
        """Create intrinsics without distortion from an upper-triangular K (3, 3) of any scale."""
        matrix = _array(calibration_matrix)
        matrix = matrix / matrix[2, 2]
        return cls(
            focal_length_px=(matrix[0, 0], matrix[1, 1]),
            image_size_px=image_size_px,
            principal_point_px=matrix[:2, 2],
            skew_px=matrix[0, 1],
        )

    @property
    def focal_length_px(self) -> Float[ArrayLike, "2"]:
        """Focal length divided by the pixel pitch, along u and along v, (2,) px."""
        return self.lens.focal_length_px

    @property
    def principal_point_px(self) -> Float[ArrayLike, "2"]:
        """Principal point (2,): the pixel of the optical axis."""
        return self.lens.principal_point_px

    @property
    def skew_px(self) -> Float[ArrayLike, ""]:
        """Entry K[0, 1] of the calibration matrix; 0 for every real sensor."""
        return self.lens.skew_px

    @property
    def distortion(self) -> Float[ArrayLike, "c"]:
        """Coefficients of `distortion_model`, (c,); five zeros for the model "none"."""
        if self.has_distortion:
            return self.lens.coefficients
        return np.zeros(len(DEFAULT_DISTORTION.coefficient_names))

    @property
    def distortion_model(self) -> str:
        """Name of the lens model, such as "none" or "brown_conrady"."""
        return self.lens.model

    @property
    def has_distortion(self) -> bool:
        """True if the lens model has coefficients of distortion."""
        return self.lens.has_distortion

    @property
    def valid_radius_px(self) -> float:
        """Distance from the principal point, px, up to which rays and pixels are one to one.

        Beyond this radius, projections and rays are NaN, unless JAX traces the lens. Infinite if
        the distortion never folds, that is, never maps two rays to one pixel.
        """
        return self.lens.valid_radius_px()

    @property
    def focal_length_mm(self) -> FloatOrTraced | None:
        """Focal length along u, mm; None if the pixel pitch is unknown."""
        if self.pixel_pitch_mm is None:
            return None
        return as_float(self.focal_length_px[0] * self.pixel_pitch_mm[0])

    @property
    @in_float64
    def matrix(self) -> Float[ArrayLike, "3 3"]:
        """Calibration matrix K (3, 3): normalised coordinates (x/z, y/z, 1) to ideal pixels.

        Ideal pixels are those of the lens without distortion.
        """
        return self.lens.matrix

    def pixel_from_normalised(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) that images the ray (x/z, y/z) of the camera frame; NaN beyond the fold."""
        uv_px = self.lens.pixel_from_normalised(normalised)
        return self.lens.mask_ray(ray_of_normalised(normalised), uv_px)

    def normalised_from_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates (x/z, y/z) of the ray of a pixel; NaN beyond the fold.

        This is the inverse of `pixel_from_normalised`.
        """
        return self.lens.mask_pixel(uv_px, self.lens.normalised_from_pixel(uv_px))

    def undistort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) that would image the same ray without distortion; NaN beyond the fold."""
        return self.lens.mask_pixel(uv_px, jnp.asarray(self.lens.undistort_pixel(uv_px)))

    def distort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Pixel (2,) of the real image for an undistorted pixel; inverse of `undistort_pixel`."""
        distorted_px = jnp.asarray(self.lens.distort_pixel(uv_px))
        return self.lens.mask_ray(ray_of_normalised(self.lens.affine_inverse(uv_px)), distorted_px)


def whole_size_px(size: object) -> tuple[int, int]:
    """Return an image size (width, height) as two integers.

    Raise `InputError` if `size` is not two positive whole numbers.
    """
    try:
        sides = np.array(size if np.ndim(size) == 1 else ())  # pyright: ignore
    except ValueError:  # lists of several lengths
        sides = np.zeros(0)
    is_size = sides.shape == (2,) and sides.dtype.kind in "iuf" and np.isfinite(sides).all()
    if not (is_size and (sides >= 1).all() and (sides == np.round(sides)).all()):
        raise InputError(
            f"image_size_px is {size}, but must be (width, height) in whole positive pixels."
        )
    return int(sides[0]), int(sides[1])


def _distortion(
    values: Sequence[ScalarLike] | ArrayLike | None, model_name: str | None
) -> tuple[type[AbstractLens], Float[ArrayLike, "c"]]:
    """Return the lens class and all of its coefficients (c,), with 0 for the missing last ones.

    `values` are the coefficients that the user gave; `model_name` may be None. Raise `InputError`
    for too many coefficients or for p1 without p2.
    """
    if model_name is not None:
        model = lens_model(model_name)
    else:
        model = Pinhole if values is None else DEFAULT_DISTORTION
    names = model.coefficient_names
    coefficients = _array(()) if values is None else _array(values, "distortion").reshape(-1)
    if len(coefficients) > len(names):
        raise InputError(
            f"distortion has {len(coefficients)} coefficients, but {model.model} takes at most "
            f"{len(names)}: {', '.join(names) or 'none'}."
        )
    if names[len(coefficients) - 1 : len(coefficients) + 1] == ("p1", "p2"):
        raise InputError(
            f"distortion has {len(coefficients)} coefficients: the last is p1, and p2 is missing. "
            f"The order is {', '.join(names[:5])}; give 0 for unknown ones."
        )
    xp, missing = array_namespace(coefficients), len(names) - len(coefficients)
    return model, xp.concatenate([coefficients, xp.zeros(missing, coefficients.dtype)])


def _array(value: object, name: str = "A lens") -> Float[ArrayLike, "*n"]:
    """Convert a value to a NumPy array of float64, or to a JAX array if JAX traces the value.

    Raise `InputError` if a number is missing or not finite. `name` names the value in the message.
    """
    if is_traced(value):
        return jnp.asarray(value)
    array = real_array(value, name).copy()
    if not np.isfinite(array).all():
        raise InputError(f"{name} has {value!r}, but must be finite. Check its numbers.")
    return array


def _positive_pair(
    name: str, value: Sequence[ScalarLike] | ArrayLike | ScalarLike
) -> Float[ArrayLike, "2"]:
    pair = _array(value, name)
    if pair.shape not in ((), (1,), (2,)):
        raise InputError(f"{name} is {value}, but must be one number, or two for u and v.")
    pair = array_namespace(pair).broadcast_to(pair, (2,))
    if not is_traced(pair) and not (pair > 0).all():
        raise InputError(f"{name} is {value}, but must be positive. Check the number and its unit.")
    return pair


def describe_fold(lens: Intrinsics) -> str | None:
    """Return the end of the sentence "The distortion ..." if it folds the image, else None.

    The text has no full stop, and states the radius of the fold in px. Beyond the fold, two rays
    have one pixel, and pixels farther out have no ray. None also in two harmless cases. First, the
    fold is outside the image. Second, the fold is beyond 90 degrees: then the image of a fisheye is
    a circle with black corners. `FOLD_REMEDY` is the advice for a lens that the user gave.
    """
    if isinstance(lens.lens, AbstractSplinedLens) and not lens.lens.steepness() < 1.0:
        return (
            "folds the image: neighbouring control points of its spline correction differ by "
            f"{lens.lens.steepness():.2g} times their distance"
        )
    corner_px, radius_px = farthest_corner_px(lens), lens.valid_radius_px
    if lens.lens.fold_angle_rad() >= np.pi / 2 or not radius_px < corner_px:
        return None
    return (
        f"folds the image {radius_px:.0f} px from the principal point (two rays have one pixel "
        f"there, and the farthest corner is {corner_px:.0f} px away)"
    )


def describe_unusable_fold(lens: Intrinsics) -> str | None:
    """Return the text of `describe_fold` if the fold makes the lens unusable, else None.

    The lens is unusable in two cases. The radius of the fold is less than half the shorter image
    side, or more than a third of the image lies beyond the fold.
    """
    fold = describe_fold(lens)
    is_near = lens.valid_radius_px < min(lens.image_size_px) / 2
    return fold if is_near or share_beyond_fold(lens) > _MOST_LOST else None


def describe_usable_fold(lens: Intrinsics) -> str | None:
    """Return the text of `describe_fold` with the unused share of the image, if the lens is usable.

    None if the lens does not fold, or if the fold makes the lens unusable.
    """
    fold = describe_fold(lens)
    if fold is None or describe_unusable_fold(lens) is not None:
        return None
    share = _lost_percent(lens)
    return f"{fold}; lines and points beyond this radius, in {share} of the image, are not used"


def share_beyond_fold(lens: Intrinsics) -> float:
    """Share of the image area, 0 to 1, beyond `Intrinsics.valid_radius_px`."""
    u, v = (np.linspace(0.0, side - 1.0, _SHARE_POINTS) for side in lens.image_size_px)
    cu, cv = np.asarray(lens.principal_point_px)
    return float(np.mean(np.hypot(u - cu, (v - cv)[:, None]) > lens.valid_radius_px))


def farthest_corner_px(lens: Intrinsics) -> float:
    """Largest distance of an image corner from the principal point, px."""
    corners = np.array([[0.0, 0.0], np.array(lens.image_size_px) - 1.0])
    return float(np.linalg.norm(np.abs(corners - np.asarray(lens.principal_point_px)).max(axis=0)))


def _lost_percent(lens: Intrinsics) -> str:
    share = 100.0 * share_beyond_fold(lens)
    return f"{share:.1f} %" if share >= 0.1 else "less than 0.1 %"


@in_float64
def undistort_pixels(
    lens: Intrinsics, uv_px: Float[ArrayLike, "*n 2"]
) -> Float[np.ndarray, "*n 2"]:
    """Map points of a real image to their positions in an image without distortion.

    Parameters
    ----------
    lens : Intrinsics
        The lens of the real image.
    uv_px : (..., 2)
        Points of the real image.

    Returns
    -------
    (..., 2)
        Undistorted points, px. NaN beyond `Intrinsics.valid_radius_px`.
    """
    points = np.asarray(uv_px, dtype=np.float64)
    return np.asarray(lens.lens.mask_pixel(points, _map_pixels(lens, points, _undistort)))


@in_float64
def distort_pixels(lens: Intrinsics, uv_px: Float[ArrayLike, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    """Map points of an image without distortion to the real image.

    Parameters
    ----------
    lens : Intrinsics
        The lens of the real image.
    uv_px : (..., 2)
        Undistorted points, px.

    Returns
    -------
    (..., 2)
        Points of the real image, px: the inverse of `undistort_pixels`. NaN for rays beyond the
        fold of the lens.
    """
    points = np.asarray(uv_px, dtype=np.float64)
    distorted_px = _map_pixels(lens, points, _distort)
    if lens.valid_radius_px == np.inf:
        return distorted_px
    ones = np.ones((*points.shape[:-1], 1))
    rays = np.concatenate([points, ones], axis=-1) @ np.linalg.inv(lens.matrix).T
    return np.asarray(lens.lens.mask_ray(rays, distorted_px))


def _map_pixels(lens: Intrinsics, uv_px: ArrayLike, mapping: Callable) -> np.ndarray:
    """Apply a compiled `mapping` of (lens, pixels) to pixels of any shape (..., 2).

    The pixels are padded to one of a few array lengths, because each length is compiled once.
    """
    points = np.asarray(uv_px, dtype=np.float64)
    if not lens.has_distortion or points.size == 0:
        return points
    return in_bucket(partial(mapping, lens), points.reshape(-1, 2)).reshape(points.shape)


@kept_jit
def _undistort(lens: Intrinsics, uv_px: Float[ArrayLike, "n 2"]) -> Float[ArrayLike, "n 2"]:
    return jax.vmap(lens.undistort_pixel)(uv_px)


@kept_jit
def _distort(lens: Intrinsics, uv_px: Float[ArrayLike, "n 2"]) -> Float[ArrayLike, "n 2"]:
    return jax.vmap(lens.distort_pixel)(uv_px)
