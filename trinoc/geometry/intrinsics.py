"""What a camera and its lens do to a ray, independent of where the camera stands."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.geometry.distortion import distort, undistort
from trinoc.numerics import ArrayLike

DISTORTION_MODELS = ("none", "brown_conrady")


class Intrinsics(eqx.Module):
    """Pinhole camera with optional skew and Brown-Conrady distortion.

    Pixel (u, v) = (column, row), with (0, 0) the centre of the top-left pixel.

    Fields
    ------
    focal_length_px : (2,) focal length over pixel pitch, along u and v.
    principal_point_px : (2,)
    skew_px : () entry K[0, 1] of the calibration matrix; 0 for every real sensor.
    distortion : (5,) Brown-Conrady k1, k2, p1, p2, k3; zeros for the model "none".
    image_size_px : (width, height).
    pixel_pitch_mm : size of a pixel along u and v, or None where it is not known.
    distortion_model : "none" or "brown_conrady".
    """

    focal_length_px: Float[ArrayLike, "2"]
    principal_point_px: Float[ArrayLike, "2"]
    skew_px: Float[ArrayLike, ""]
    distortion: Float[ArrayLike, "5"]
    image_size_px: tuple[int, int] = eqx.field(static=True)
    pixel_pitch_mm: tuple[float, float] | None = eqx.field(static=True)
    distortion_model: str = eqx.field(static=True)

    def __init__(
        self,
        *,
        image_size_px: Sequence[int],
        focal_length_mm: float | None = None,
        pixel_pitch_mm: Sequence[float] | float | None = None,
        focal_length_px: Sequence[float] | np.ndarray | float | None = None,
        principal_point_px: Sequence[float] | np.ndarray | None = None,
        skew_px: float = 0.0,
        distortion: Sequence[float] | np.ndarray | None = None,
    ) -> None:
        """Intrinsics from a data sheet (millimetres) or from an earlier calibration (pixels).

        Give `focal_length_mm` and `pixel_pitch_mm`, or `focal_length_px` (one number, or one
        along u and one along v). `principal_point_px` defaults to ((W-1)/2, (H-1)/2), the
        centre of the picture. `distortion` is up to five coefficients k1, k2, p1, p2, k3;
        None is a lens without distortion. Raises InputError for what cannot be a camera.
        """
        pitch = None if pixel_pitch_mm is None else _positive_pair("pixel_pitch_mm", pixel_pitch_mm)
        if focal_length_px is not None and focal_length_mm is None:
            focal = _positive_pair("focal_length_px", focal_length_px)
        elif focal_length_mm is not None and focal_length_px is None and pitch is not None:
            focal = _positive_pair("focal_length_mm", focal_length_mm) / pitch
        else:
            raise InputError(
                "The focal length is not determined: give focal_length_mm with pixel_pitch_mm, "
                "or focal_length_px alone."
            )
        width, height = (int(side) for side in image_size_px)
        if width < 1 or height < 1:
            raise InputError(
                f"image_size_px is {tuple(image_size_px)}, but must be (width, height) in whole "
                "positive pixels."
            )
        centre = ((width - 1) / 2, (height - 1) / 2)
        coefficients = np.zeros(5)
        if distortion is not None:
            given = np.asarray(distortion, dtype=np.float64).reshape(-1)
            if len(given) > 5:
                raise InputError(
                    f"distortion has {len(given)} coefficients, but Brown-Conrady takes at most "
                    "five: k1, k2, p1, p2, k3."
                )
            coefficients[: len(given)] = given
        self.focal_length_px = focal
        self.principal_point_px = np.array(
            centre if principal_point_px is None else principal_point_px, dtype=np.float64
        )
        self.skew_px = np.asarray(skew_px, dtype=np.float64)
        self.distortion = coefficients
        self.image_size_px = (width, height)
        self.pixel_pitch_mm = None if pitch is None else (float(pitch[0]), float(pitch[1]))
        self.distortion_model = "none" if distortion is None else "brown_conrady"

    @classmethod
    def from_matrix(
        cls, calibration_matrix: Float[ArrayLike, "3 3"], image_size_px: Sequence[int]
    ) -> "Intrinsics":
        """Intrinsics from an upper-triangular K, scaled to K[2, 2] = 1."""
        matrix = np.asarray(calibration_matrix, dtype=np.float64)
        matrix = matrix / matrix[2, 2]
        return cls(
            focal_length_px=(matrix[0, 0], matrix[1, 1]),
            image_size_px=image_size_px,
            principal_point_px=matrix[:2, 2],
            skew_px=float(matrix[0, 1]),
        )

    @property
    def focal_length_mm(self) -> float | None:
        """Focal length along u in millimetres, or None where the pixel pitch is not known."""
        if self.pixel_pitch_mm is None:
            return None
        return float(self.focal_length_px[0]) * self.pixel_pitch_mm[0]

    @property
    def matrix(self) -> Float[ArrayLike, "3 3"]:
        """Calibration matrix K: normalised coordinates to pixels, distortion apart."""
        return calibration_matrix(self.focal_length_px, self.principal_point_px, self.skew_px)

    def pixel_from_normalised(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """(x/z, y/z) in the camera frame to the pixel where the lens images it."""
        if self.distortion_model != "none":
            normalised = distort(normalised, self.distortion)
        return self._affine(normalised)

    def normalised_from_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Inverse of `pixel_from_normalised`: (x/z, y/z) of the viewing ray of a pixel."""
        normalised = self._affine_inverse(uv_px)
        if self.distortion_model != "none":
            normalised = undistort(normalised, self.distortion)
        return normalised

    def undistort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """The pixel at which the same ray would be imaged if the lens had no distortion."""
        if self.distortion_model == "none":
            return jnp.asarray(uv_px)
        return self._affine(self.normalised_from_pixel(uv_px))

    def distort_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Inverse of `undistort_pixel`."""
        if self.distortion_model == "none":
            return jnp.asarray(uv_px)
        return self._affine(distort(self._affine_inverse(uv_px), self.distortion))

    def _affine(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        skewed = jnp.stack([self.skew_px * normalised[1], jnp.zeros_like(normalised[1])])
        return self.focal_length_px * normalised + skewed + self.principal_point_px

    def _affine_inverse(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        centred = uv_px - self.principal_point_px
        y = centred[1] / self.focal_length_px[1]
        return jnp.stack([(centred[0] - self.skew_px * y) / self.focal_length_px[0], y])


def calibration_matrix(
    focal_length_px: Float[ArrayLike, "2"],
    principal_point_px: Float[ArrayLike, "2"],
    skew_px: Float[ArrayLike, ""],
) -> Float[ArrayLike, "3 3"]:
    """K of its entries."""
    (fu, fv), (cu, cv) = focal_length_px, principal_point_px
    zero, one = jnp.zeros_like(fu), jnp.ones_like(fu)
    rows = [[fu, jnp.asarray(skew_px), cu], [zero, fv, cv], [zero, zero, one]]
    return jnp.stack([jnp.stack(row) for row in rows])


def _positive_pair(name: str, value: Sequence[float] | np.ndarray | float) -> np.ndarray:
    pair = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (2,)))
    if not (pair > 0).all():
        raise InputError(f"{name} is {value}, but must be positive: check the number and its unit.")
    return pair
