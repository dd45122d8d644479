"""Pose of the board in one image, for every labelling that the symmetry of the board allows.

A labelling is an assignment of detected points to board points.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.starts.camera_start import median_error_px
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose

# numerical: pose of a single board in the frame of its set.
IN_PLACE = Pose(np.eye(3, 4))


class Sighting(NamedTuple):
    """Detection of a board in one image, with the board's pose relative to the camera.

    Boards that look the same after a rotation have several labellings: assignments of detected
    points to board points.

    Attributes
    ----------
    camera, shot : indices of the camera and the shot.
    lens : initial lens of the camera.
    detections : the detection with each labelling.
    cam_from_board : board pose for each labelling.
    board : index of the board in a set of boards that are fixed to each other.
    set_from_board : pose of the board in its set; the identity while unknown.
    """

    camera: int
    shot: int
    lens: AbstractLens
    detections: tuple[Detection, ...]
    cam_from_board: tuple[Pose, ...]
    board: int = 0
    set_from_board: Pose = IN_PLACE

    @property
    def cam_from_set(self) -> tuple[Pose, ...]:
        """Pose of the whole set of boards relative to the camera, for each labelling of this
        detection.
        """
        return tuple(pose @ self.set_from_board.inverse for pose in self.cam_from_board)

    def agreement_px(self, tuning: CalibTuning) -> float:
        """Largest median reprojection error, px, at which a board pose still agrees with this
        detection.

        It is a share of the size of the board's image.
        """
        extent = float(np.ptp(self.detections[0].centres_px, axis=0).max())
        return max(tuning.starts.least_px, tuning.starts.elsewhere_share * extent)

    def nearest(self, cam_from_set: Pose, target: AbstractTarget) -> tuple[int, float]:
        """Find the labelling with the smallest reprojection error for a given pose of the set.

        Returns the index of the labelling, and its median error in px.
        """
        pose = cam_from_set @ self.set_from_board
        errors_px = [
            median_error_px(self.lens, pose, detection, target) for detection in self.detections
        ]
        best = int(np.argmin(errors_px))
        return best, errors_px[best]


def label_sighting(
    camera: int,
    shot: int,
    lens: AbstractLens,
    detection: Detection,
    cam_from_board: Pose,
    target: AbstractTarget,
    board: int = 0,
) -> Sighting:
    """Sighting with all labellings of a detection, and the board pose for each of them.

    cam_from_board : board pose for the first labelling.
    """
    detections = tuple(
        replace(detection, circle_index=index, ambiguity=None) for index in detection.labellings
    )
    points_mm = [target.centres_mm[labelled.circle_index] for labelled in detections]
    poses = tuple(
        cam_from_board @ motion_in_plane(points_mm[0], labelled_mm) for labelled_mm in points_mm
    )
    return Sighting(camera, shot, lens, detections, poses, board)


def motion_in_plane(to_mm: Float[np.ndarray, "m 2"], from_mm: Float[np.ndarray, "m 2"]) -> Pose:
    """Rigid motion within the plane Z = 0 that maps `from_mm` to `to_mm` (least squares)."""
    to_centred, from_centred = to_mm - to_mm.mean(axis=0), from_mm - from_mm.mean(axis=0)
    cross = from_centred[:, 0] @ to_centred[:, 1] - from_centred[:, 1] @ to_centred[:, 0]
    angle = np.arctan2(cross, np.sum(from_centred * to_centred))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    motion = np.eye(3, 4)
    motion[:2, :2] = turn
    motion[:2, 3] = to_mm.mean(axis=0) - turn @ from_mm.mean(axis=0)
    return Pose(motion)
