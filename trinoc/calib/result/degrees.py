"""Poses as people read them: pan, tilt and swing in degrees, distance and aim in mm."""

import jax
import numpy as np
from jaxtyping import Float

from trinoc.geometry import Pose
from trinoc.numerics import in_float64

# From (rad, rad, rad, mm, mm, mm), in which fits run, to degrees, in which people read.
DEGREES = np.array([180 / np.pi, 180 / np.pi, 180 / np.pi, 1.0, 1.0, 1.0])


def values_of_parameters(parameters: Float[np.ndarray, "p"]) -> Float[np.ndarray, "6"]:
    """All six parameters in degrees and mm, an aim that is held at the origin."""
    values = np.zeros(len(DEGREES))
    values[: len(parameters)] = DEGREES[: len(parameters)] * parameters
    return values


@in_float64
def pose_of_values(values: Float[np.ndarray, "6"]) -> Pose:
    """The pose of pan, tilt, swing in degrees, distance and aim in mm."""
    return _pose(np.concatenate([np.radians(values[:3]), values[3:]]))


# Operation by operation it takes two milliseconds, which a batch of frames feels.
_pose = jax.jit(Pose.from_parameters)
