"""Intrinsics as bare arrays, so that lenses of different pictures share one compiled program."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry import Intrinsics, distort, undistort
from trinoc.numerics import ArrayLike


class LensArrays(NamedTuple):
    """What the fit needs of `Intrinsics`: K (3, 3), and Brown-Conrady (5,) or None."""

    matrix_px: Float[ArrayLike, "3 3"]
    distortion: Float[ArrayLike, "5"] | None

    def pixel_from_normalised(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """(x/z, y/z) in the camera frame to the pixel where the lens images it."""
        if self.distortion is not None:
            normalised = distort(normalised, self.distortion)
        return self.affine(normalised)

    def affine(self, normalised: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """The calibration matrix alone, after any distortion."""
        x, y = normalised[0], normalised[1]
        (fu, skew, cu), (_, fv, cv), _ = self.matrix_px
        return jnp.stack([fu * x + skew * y + cu, fv * y + cv])

    def normalised_from_pixel(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Inverse of `pixel_from_normalised`."""
        (fu, skew, cu), (_, fv, cv), _ = self.matrix_px
        y = (uv_px[1] - cv) / fv
        normalised = jnp.stack([(uv_px[0] - cu - skew * y) / fu, y])
        return normalised if self.distortion is None else undistort(normalised, self.distortion)


def lens_arrays(lens: Intrinsics, with_distortion: bool) -> LensArrays:
    """The arrays of one lens; zeros for the distortion of an ideal lens where one is asked for."""
    (fu, fv), (cu, cv) = np.asarray(lens.focal_length_px), np.asarray(lens.principal_point_px)
    matrix = np.array([[fu, float(lens.skew_px), cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])
    return LensArrays(matrix, np.asarray(lens.distortion) if with_distortion else None)


def moved_lens(lens: LensArrays, change: Float[ArrayLike, "9"]) -> LensArrays:
    """The lens after a change of fu, fv, cu, cv and, where it distorts, of its distortion."""
    zero = jnp.zeros_like(change[0])
    matrix = jnp.stack(
        [
            jnp.stack([change[0], zero, change[2]]),
            jnp.stack([zero, change[1], change[3]]),
            jnp.stack([zero, zero, zero]),
        ]
    )
    distortion = None if lens.distortion is None else lens.distortion + change[4:]
    return LensArrays(lens.matrix_px + matrix, distortion)
