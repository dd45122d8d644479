"""The unknowns of a picture as a camera delivers it: their order, bounds and weak priors.

(pose, look, light, veil): light and veil are polynomials over the picture. Those that tell a
camera from an ideal one have priors, so that what a picture does not show stays near nothing;
their widths are several times what cameras do.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.photometric.camera_look import LOOK_TERMS, CameraLook
from trinoc.calib.photometric.kernels import Kernel
from trinoc.geometry import Pose
from trinoc.image import PowerResponse

LIGHT_DEGREE, VEIL_DEGREE, SIMPLE_DEGREE = 4, 2, 2
# Grey levels that a term of a polynomial reaches at the picture's edge.
_POLYNOMIAL_WIDTH = 40.0
LOOK_NAMES = (*Kernel._fields, *CameraLook._fields[1:])
# Per unknown of the look: bounds, the middle of its prior and its width (infinite: none).
_LOOK = {
    "sigma_px": (0.25, 8.0, 0.0, np.inf),
    "kurtosis": (-1.5, 3.0, 0.0, 0.5),
    "sixth": (-6.0, 15.0, 0.0, 2.0),
    "along_u": (-20.0, 20.0, 0.0, 2.0),
    "diagonal": (-20.0, 20.0, 0.0, 2.0),
    "along_axes": (-2.0, 2.0, 0.0, 0.3),
    "line": (-0.5, 1.6, 0.0, 0.7),
    "lobe": (-0.9, 4.0, 0.0, 1.0),
    "lobe_px": (0.4, 3.0, 1.0, 0.5),
    "lobe_mm": (-0.5, 0.5, 0.0, 0.15),
    "spread_mm": (-2.0, 2.0, 0.0, np.inf),
    "ratio": (-0.999, -0.02, 0.0, np.inf),
    **PowerResponse.PARAMETERS,
    "lift": (-1.0, 1.0, 0.0, 0.15),
    "contrast": (-1.0, 1.0, 0.0, 0.3),
}


def powers(degree: int) -> Int[np.ndarray, "k 2"]:
    """Exponents of x and y of a polynomial's terms, lower degrees first."""
    return np.array([(d - j, j) for d in range(degree + 1) for j in range(d + 1)])


LIGHT_TERMS, VEIL_TERMS = len(powers(LIGHT_DEGREE)), len(powers(VEIL_DEGREE))
LOWER, UPPER, MIDDLE, WIDTH = np.array([_LOOK[name] for name in LOOK_NAMES]).T
START = np.array([_LOOK[name][2] for name in LOOK_NAMES])


class CameraState(NamedTuple):
    """A value of every unknown.

    Fields
    ------
    pose : of the camera.
    look : (15,) `CameraLook` as a vector.
    light : (15,) polynomial of the paper's grey level.
    veil : (6,) polynomial of the light that is added to paper and ink alike.
    levels : (6, blocks) of light and of veil about each block of the sheet, (1, x, y) each, as
        shares of the light and as grey levels; no blocks where light is a polynomial alone.
    """

    pose: Pose
    look: Float[np.ndarray, "15"]
    light: Float[np.ndarray, "15"]
    veil: Float[np.ndarray, "6"]
    levels: Float[np.ndarray, "6 blocks"]

    @property
    def flat(self) -> Float[np.ndarray, "k"]:
        """Look, light and veil as one vector."""
        return np.concatenate([self.look, self.light, self.veil])

    def look_of(self, name: str) -> float:
        """One number of the look."""
        return float(self.look[LOOK_NAMES.index(name)])

    def moved(self, pose: Pose, by: Float[np.ndarray, "k"], levels: np.ndarray) -> "CameraState":
        """With another pose and levels, the rest moved and kept within its bounds."""
        look, light, veil = np.split(self.flat + by, [LOOK_TERMS, LOOK_TERMS + LIGHT_TERMS])
        return CameraState(pose, np.clip(look, LOWER, UPPER), light, veil, levels)


class Layout(NamedTuple):
    """Places of the unknowns in (pose, look, light, veil), for a pose of given size."""

    pose_size: int

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.pose_size + LOOK_TERMS + LIGHT_TERMS + VEIL_TERMS

    @property
    def ends(self) -> list[int]:
        """Where pose, look and light end."""
        look = self.pose_size + LOOK_TERMS
        return [self.pose_size, look, look + LIGHT_TERMS]

    def look(self, *names: str) -> list[int]:
        """Of the look, by name."""
        return [self.pose_size + LOOK_NAMES.index(name) for name in names]

    @property
    def simple(self) -> list[int]:
        """Those that an ideal camera has too."""
        count = len(powers(SIMPLE_DEGREE))
        light = range(self.pose_size + LOOK_TERMS, self.pose_size + LOOK_TERMS + count)
        return [*range(self.pose_size), *self.look("sigma_px", "spread_mm", "ratio"), *light]

    @property
    def uneven_light(self) -> list[int]:
        """Light beyond a quadratic, and a veil whose constant part light and ratio hold."""
        first = self.pose_size + LOOK_TERMS
        higher = range(first + len(powers(SIMPLE_DEGREE)), first + LIGHT_TERMS)
        return [*higher, *range(first + LIGHT_TERMS + 1, self.size)]

    def prior(self, *, local: bool) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Middle and weight (1 / variance) of every unknown's prior.

        local : where blocks have light of their own, polynomials have a prior too, because
            little else tells the two apart.
        """
        rest = np.zeros(LIGHT_TERMS + VEIL_TERMS)
        if local:
            rest[1:] = _POLYNOMIAL_WIDTH**-2.0
        pose, none = np.zeros(self.pose_size), np.zeros(len(rest))
        return np.r_[pose, MIDDLE, none], np.r_[pose, WIDTH**-2.0, rest]
