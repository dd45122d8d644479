"""The lens without distortion."""

from typing import ClassVar

from jaxtyping import Float

from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens, ray_of_normalised
from trinoc.numerics.precision import ArrayLike


class Pinhole(AbstractLens):
    """An ideal lens, which has no coefficients: straight lines stay straight."""

    model: ClassVar[str] = "none"
    coefficient_names: ClassVar[tuple[str, ...]] = ()
    parameter_names: ClassVar[tuple[str, ...]] = AFFINE_PARAMETERS
    coefficient_powers: ClassVar[tuple[int, ...]] = ()
    coefficient_counts: ClassVar[tuple[int, ...]] = (0,)
    dispensable: ClassVar[tuple[str, ...]] = ()

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """(x/z, y/z)."""
        return ray_cam[:2] / ray_cam[2]

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """(x, y, 1)."""
        return ray_of_normalised(distorted)
