"""Would another rig do as well? Asked by starting elsewhere.

Segments that match by chance agree with almost any rig once its cameras have been fitted to
them, and no residual tells: the matcher has chosen those that fit. So the refinement is run again
from starts with one camera turned to each side. Those that end elsewhere tell what chance is
worth in this scene, and a right answer stands clear of them.
"""

from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.bundle.estimate import squared_with_rig
from trinoc.calib.bundle.problem import FreeParameters
from trinoc.calib.bundle.result import RefineResult
from trinoc.geometry import AFFINE_PARAMETERS, Camera, Pose, PoseModel, Rig, rotation_from_vector
from trinoc.numerics import as_numpy

# How far a camera is turned: the largest knock that the search is meant for.
TURN_DEG = 1.2
# How far one that aims at the origin is taken round it, where pictures of what lies near stay.
ROUND_DEG = 5.0
# A camera whose orientation the sheet knows to a quarter of that cannot stand elsewhere.
KNOWN_DEG = TURN_DEG / 4
# Two answers are one where the lines of one miss each other by less with the other.
SAME_SIGMAS = 3.5
# Where the best answer was wrong, one that ends elsewhere came within a factor of 1.35 in log
# posterior in five cases of six (1.8 in the other); where it was right, none came nearer than
# 1.52 in 45 (made tables, boxes and loose segments, seeds from 150,000 on, one camera knocked by
# 1 or 2 degrees, or all by 0.2 to 1). Both sides grow with the ceiling of the loss (`posterior`);
# the factor between them was measured under that of `joint_estimate`.
CLEAR_FACTOR = 1.45


def start_rigs(rig: Rig, moved: Collection[str], pose_model: PoseModel) -> list[Rig]:
    """The rig with one camera turned about its x and y axes, to either side.

    It is the last of those that moved, or of all where none is named; no start where the sheet
    knows its orientation. A camera that must aim at the origin is taken round it instead.
    """
    name = next(camera for camera in reversed(rig.names) if camera in moved or not moved)
    if not moved and (_sigma_of_angles_deg(rig, name) < KNOWN_DEG).all():
        return []
    axes = np.concatenate([np.eye(3)[:2], -np.eye(3)[:2]])
    if pose_model is PoseModel.AIMED:
        poses = [_round_the_origin(rig[name], np.radians(ROUND_DEG) * axis) for axis in axes]
    else:
        turns = [np.append(np.radians(TURN_DEG) * axis, np.zeros(3)) for axis in axes]
        pose = rig[name].pose
        poses = [as_numpy(pose.retract(turn, PoseModel.RIGID, 1.0)) for turn in turns]
    return [_with_pose(rig, name, pose) for pose in poses]


def _sigma_of_angles_deg(rig: Rig, name: str) -> Float[np.ndarray, "3"]:
    """Of pan, tilt and swing, were the camera's lens what the rig says; NaN where not known.

    A lens that is off takes the pose with it, which hides no line from the other cameras.
    """
    angles = [f"{name}.{angle}_deg" for angle in ("pan", "tilt", "swing")]
    if not set(angles) <= set(rig.parameters):
        return np.full(3, np.nan)
    of_lens = [f"{name}.{key}" for key in AFFINE_PARAMETERS if f"{name}.{key}" in rig.parameters]
    rows, given = ([rig.parameters.index(key) for key in keys] for keys in (angles, of_lens))
    covariance = np.asarray(rig.covariance)
    across, lens = covariance[np.ix_(rows, given)], covariance[np.ix_(given, given)]
    explained = across @ np.linalg.pinv(lens, hermitian=True) @ across.T
    return np.sqrt(np.maximum(np.diag(covariance[np.ix_(rows, rows)] - explained), 0.0))


def is_unambiguous(
    best: RefineResult, others: Sequence[RefineResult | None], choice: FreeParameters
) -> bool:
    """Whether the best answer is clear of all others that are not the same."""
    return all(
        other.log_posterior * CLEAR_FACTOR < best.log_posterior
        or _apart_sigmas(best, other, choice) < SAME_SIGMAS
        for other in others
        if other is not None
    )


def _apart_sigmas(best: RefineResult, other: RefineResult, choice: FreeParameters) -> float:
    """By how much the tracks that agree with one rig miss each other with the other rig."""
    agree = (best.inlier == best.tracks.seen).all(axis=1) & (best.tracks.seen.sum(axis=1) > 2)
    if not agree.any():
        return 0.0
    squared = squared_with_rig(other.rig, best.tracks, choice)[agree]
    redundancy = 2 * best.tracks.seen[agree].sum(axis=1) - 4
    return float(np.median(np.sqrt(squared.sum(axis=1) / redundancy)))


def _round_the_origin(camera: Camera, turn_rad: np.ndarray) -> Pose:
    rotation = np.asarray(rotation_from_vector(turn_rad)) @ np.asarray(camera.pose.rotation)
    translation = np.array([0.0, 0.0, np.linalg.norm(camera.centre_world_mm)])
    return Pose(np.column_stack([rotation, translation]))


def _with_pose(rig: Rig, name: str, pose: Pose) -> Rig:
    cameras = {
        each: Camera(camera.intrinsics, pose) if each == name else camera
        for each, camera in rig.items()
    }
    return Rig(cameras, parameters=rig.parameters, covariance=rig.covariance)
