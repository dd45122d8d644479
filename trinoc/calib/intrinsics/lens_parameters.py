"""The nine numbers of a lens, their natural scales, and which of them a model frees."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.geometry import Intrinsics

# Focal lengths and principal point along u and v, then Brown-Conrady in OpenCV's order.
LENS_PARAMETERS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
_RADIAL = ("k1", "k2", "k3")
_TANGENTIAL = ("p1", "p2")


class LensModel(NamedTuple):
    """Which parameters of the lens are fitted; the others are held.

    Fields
    ------
    radial : number of radial coefficients, 0 to 3.
    tangential : whether p1 and p2 are free.
    principal_point : whether cx and cy are free.
    aspect : whether fx and fy are free one by one; their ratio is held otherwise.
    """

    radial: int
    tangential: bool
    principal_point: bool = True
    aspect: bool = True

    @property
    def distortion(self) -> tuple[str, ...]:
        """The free coefficients of distortion."""
        return _RADIAL[: self.radial] + (_TANGENTIAL if self.tangential else ())

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that are not held, in the order of LENS_PARAMETERS.

        Where the aspect is held, "fx_px" stands for both focal lengths.
        """
        held = set(_RADIAL + _TANGENTIAL) - set(self.distortion)
        held |= set() if self.principal_point else {"cx_px", "cy_px"}
        held |= set() if self.aspect else {"fy_px"}
        return tuple(name for name in LENS_PARAMETERS if name not in held)


def parameter_scale(
    values: Float[np.ndarray, "9"], image_size_px: tuple[int, int]
) -> Float[np.ndarray, "9"]:
    """Changes of the parameters that move the corners of the picture about equally.

    A step of s in units of this scale moves a corner by about s times its distance from the
    principal point, or by s focal lengths for the principal point itself.
    """
    focal_u, focal_v = values[:2]
    radius = 0.5 * np.hypot(image_size_px[0] / focal_u, image_size_px[1] / focal_v)
    powers = np.array([2, 4, 1, 1, 6])
    return np.concatenate([[focal_u, focal_v, focal_u, focal_v], radius ** -powers.astype(float)])


def free_directions(model: LensModel) -> Float[np.ndarray, "9 9"]:
    """Columns: the change of all nine scaled parameters with each one that is free.

    Columns of held parameters are zero, so that all models share one compiled program.
    """
    directions = np.zeros((9, 9))
    for name in model.free:
        column = LENS_PARAMETERS.index(name)
        directions[column, column] = 1.0
    if not model.aspect:
        directions[1, 0] = 1.0
    return directions


def lens_of_values(
    values: Float[np.ndarray, "9"],
    image_size_px: tuple[int, int],
    pixel_pitch_mm: tuple[float, float] | None = None,
) -> Intrinsics:
    """Intrinsics from the nine numbers; without distortion where all coefficients are zero."""
    distorted = bool(np.any(values[4:] != 0.0))
    return Intrinsics(
        image_size_px=image_size_px,
        focal_length_px=values[:2],
        principal_point_px=values[2:4],
        pixel_pitch_mm=pixel_pitch_mm,
        distortion=values[4:] if distorted else None,
    )
