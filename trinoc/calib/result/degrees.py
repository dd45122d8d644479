"""Poses in public units: pan, tilt and swing in degrees, distance and aim in mm."""

from functools import partial

import numpy as np
from jaxtyping import Float

from trinoc.geometry.pose import Pose, PoseModel
from trinoc.numerics.information import LARGEST_SIGMA
from trinoc.numerics.precision import ArrayLike, ScalarLike, in_float64
from trinoc.numerics.programs import kept_jit

# numerical: from (rad, rad, rad, mm, mm, mm), in which fits run, to degrees.
DEGREES = np.array([180 / np.pi, 180 / np.pi, 180 / np.pi, 1.0, 1.0, 1.0])


def values_of_parameters(parameters: Float[np.ndarray, "p"]) -> Float[np.ndarray, "6"]:
    """Convert pose parameters from rad and mm to degrees and mm. A missing aim becomes 0.

    parameters : pan, tilt, swing, distance and, optionally, aim x and y.
    """
    values = np.zeros(len(DEGREES))
    values[: len(parameters)] = DEGREES[: len(parameters)] * parameters
    return values


@in_float64
def pose_of_values(values: Float[np.ndarray, "6"]) -> Pose:
    """Pose from pan, tilt, swing in degrees, distance in mm, and aim x and y in mm."""
    return Pose.from_parameters(np.concatenate([np.radians(values[:3]), values[3:]]))


@in_float64
def degrees_by_step(pose: Pose, unit_mm: ScalarLike, model: PoseModel) -> Float[np.ndarray, "p p"]:
    """Jacobian, (p, p), of the public pose parameters with respect to the pose's local coordinates.

    pose : the pose at which it is evaluated.
    unit_mm : length of a unit change of the translation.
    model : the p public parameters, in degrees and mm.
    """
    return DEGREES[: model.size, None] * np.asarray(
        _by_step(pose, np.asarray(unit_mm, dtype=float), model=model)
    )


def largest_sigmas(model: PoseModel, distance_mm: float) -> Float[np.ndarray, "p"]:
    """Sigma of each pose parameter, degrees and mm, above which the parameter counts as
    undetermined.
    """
    lengths = [1.0, 1.0, 1.0, *np.full(3, distance_mm)]
    return (LARGEST_SIGMA * DEGREES * np.array(lengths))[: model.size]


@partial(kept_jit, static_argnames=("model",))
def _by_step(pose: Pose, unit_mm: ScalarLike, *, model: PoseModel) -> Float[ArrayLike, "p p"]:
    return pose.d_parameters_d_delta(model, unit_mm, pose)
