"""Baseline and relative rotation of each pair of cameras, with sigmas from their joint covariance.

Both are properties of the pair: they do not depend on the world frame.
"""

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
import scipy
from jaxtyping import Float

from trinoc.calib.uncertainty.board_size import covariance_of_size
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.geometry.rig import Rig

# numerical: steps of central differences, in degrees and as a share of the distance in mm.
_STEP = 1e-4
# numerical: below this angle in degrees a rotation has no axis.
_NO_AXIS_DEG = 1e-9


@dataclasses.dataclass(frozen=True)
class CameraPair:
    """Relative pose of two cameras, with sigmas.

    Attributes
    ----------
    first, second : names of the cameras.
    second_from_first : (3, 4) rigid motion x_second = [R | t] x_first, mm. OpenCV's
        `stereoCalibrate` returns R and T.
    baseline_mm : distance between the centres of projection.
    baseline_sigma_mm : standard deviation of the baseline.
    size_sigma_mm : part of `baseline_sigma_mm` that the unknown print size of the board causes,
        which no image shows; 0 for an exact size.
    rest_sigma_mm : remaining part: baseline_sigma^2 = size_sigma^2 + rest_sigma^2.
    angle_deg : angle of the rotation from the axes of the first camera to those of the second.
    angle_sigma_deg : standard deviation of the angle.
    turn_deg : (3,) rotation vector of this rotation, about the x, y and z axes of the first camera;
        its length is `angle_deg`.
    turn_sigma_deg : (3,) standard deviations of `turn_deg`.
    """

    first: str
    second: str
    second_from_first: Float[np.ndarray, "3 4"]
    baseline_mm: float
    baseline_sigma_mm: float
    size_sigma_mm: float
    rest_sigma_mm: float
    angle_deg: float
    angle_sigma_deg: float
    turn_deg: Float[np.ndarray, "3"]
    turn_sigma_deg: Float[np.ndarray, "3"]


def camera_pairs(
    rig: Rig, parameters: tuple[str, ...], covariance: Float[np.ndarray, "p p"]
) -> tuple[CameraPair, ...]:
    """Relative pose of each pair of cameras, in the order of the rig.

    Parameters
    ----------
    rig : the cameras.
    parameters : names of the p parameters that have errors: poses and, if uncertain, the print
        scales of the boards, as in `CalibrationResult`. All other poses are exact.
    covariance : (p, p) their covariance, in degrees and mm.
    """
    size = covariance_of_size(parameters, covariance)
    return tuple(
        _camera_pair(rig, first, second, parameters, covariance, size)
        for first, second in itertools.combinations(rig.names, 2)
    )


def _camera_pair(
    rig: Rig,
    first: str,
    second: str,
    parameters: tuple[str, ...],
    covariance: Float[np.ndarray, "p p"],
    size: Float[np.ndarray, "p p"],
) -> CameraPair:
    poses = [_PoseByParameters(rig[name].pose, name, parameters) for name in (first, second)]
    names = [name for pose in poses for name in pose.names]
    rows = np.array([parameters.index(name) if name in parameters else -1 for name in names])
    is_known = np.outer(rows >= 0, rows >= 0)
    pair_covariance, pair_size = (
        np.where(is_known, matrix[np.ix_(rows, rows)], 0.0) for matrix in (covariance, size)
    )

    def centre_and_turn(change: Float[np.ndarray, "12"]) -> Float[np.ndarray, "6"]:
        return _centre_and_turn(poses[0].move(change[:6]), poses[1].move(change[6:]))

    motion = centre_and_turn(np.zeros(len(names)))
    jacobian = _central_differences(centre_and_turn, np.concatenate([pose.steps for pose in poses]))
    direction, axis = _directions(motion)
    baseline_gradient, angle_gradient = direction @ jacobian[:3], axis @ jacobian[3:]
    variance = float(baseline_gradient @ pair_covariance @ baseline_gradient)
    size_variance = float(baseline_gradient @ pair_size @ baseline_gradient)
    turn_variance = np.einsum("ip,pq,iq->i", jacobian[3:], pair_covariance, jacobian[3:])
    return CameraPair(
        first=first,
        second=second,
        second_from_first=np.asarray((rig[second].pose @ rig[first].pose.inverse).cam_from_world),
        baseline_mm=float(np.linalg.norm(motion[:3])),
        baseline_sigma_mm=_root(variance),
        size_sigma_mm=_root(size_variance),
        rest_sigma_mm=_root(variance - size_variance),
        angle_deg=float(np.linalg.norm(motion[3:])),
        angle_sigma_deg=_root(float(angle_gradient @ pair_covariance @ angle_gradient)),
        turn_deg=motion[3:],
        turn_sigma_deg=np.sqrt(np.maximum(turn_variance, 0.0)),
    )


class _PoseByParameters:
    """Function from small changes of six public pose parameters, in degrees and mm, to the pose."""

    def __init__(self, pose: Pose, camera: str, parameters: tuple[str, ...]) -> None:
        rigid = PoseModel.RIGID.parameter_names
        self._is_rigid = f"{camera}.{rigid[0]}" in parameters
        model = PoseModel.RIGID if self._is_rigid else PoseModel.AIM_FREE
        self.names = tuple(f"{camera}.{name}" for name in model.parameter_names)
        self._pose = Pose(np.asarray(pose.cam_from_world))
        self._has_aim = bool(np.isfinite(np.asarray(self._pose.parameters)).all())
        length = max(float(np.linalg.norm(self._pose.translation_mm)), 1.0)
        self.steps = _STEP * np.array([1.0, 1.0, 1.0, *np.full(3, length / 100.0)])

    def move(self, change: Float[np.ndarray, "6"]) -> Pose:
        """Pose after a small change of its six parameters."""
        if not self._is_rigid and self._has_aim:
            radians = np.concatenate([np.radians(change[:3]), change[3:]])
            return Pose.from_parameters(np.asarray(self._pose.parameters) + radians)
        turn = scipy.spatial.transform.Rotation.from_rotvec(change[:3], degrees=True).as_matrix()
        return Pose.from_centre(turn @ self._pose.rotation, self._pose.centre_world_mm + change[3:])


def _centre_and_turn(first: Pose, second: Pose) -> Float[np.ndarray, "6"]:
    """Centre (mm) and rotation vector (degrees) of the second camera in the frame of the first,
    (6,).
    """
    centre_mm = first.rotation @ (second.centre_world_mm - first.centre_world_mm)
    turn = scipy.spatial.transform.Rotation.from_matrix(first.rotation @ second.rotation.T)
    return np.concatenate([centre_mm, turn.as_rotvec(degrees=True)])


def _central_differences(
    function: Callable[[np.ndarray], np.ndarray], steps: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "q p"]:
    """Jacobian, (q, p), of a function at 0, by central differences with the given steps."""
    columns = [
        (function(step) - function(-step)) / (2.0 * length)
        for step, length in zip(np.diag(steps), steps, strict=True)
    ]
    return np.stack(columns, axis=1)


def _directions(
    motion: Float[np.ndarray, "6"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Unit vectors of the baseline and of the rotation axis of a relative pose.

    The x axis is returned if the baseline is 0. The z axis is returned if the rotation is 0.

    motion : centre and rotation vector, as from `_centre_and_turn`.
    """
    baseline, angle = np.linalg.norm(motion[:3]), np.linalg.norm(motion[3:])
    direction = motion[:3] / baseline if baseline > 0.0 else np.array([1.0, 0.0, 0.0])
    axis = motion[3:] / angle if angle > _NO_AXIS_DEG else np.array([0.0, 0.0, 1.0])
    return direction, axis


def _root(variance: float) -> float:
    """Square root of a variance; 0 if rounding made the variance negative."""
    return float(np.sqrt(np.maximum(variance, 0.0)))
