"""The board in one picture, with every labelling that the board's symmetry leaves open."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.starts.camera_start import miss_px
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose

# numerical: where one board stands in the frame of all, which is its own.
IN_PLACE = Pose(np.eye(3, 4))


class Sighting(NamedTuple):
    """What one camera saw in one shot, and where the board then stood before it.

    Fields
    ------
    camera, shot : which; indices.
    lens : the camera's first lens.
    detections : the detection, in each labelling.
    cam_from_board : for each labelling.
    board : which of several boards it is.
    set_from_board : where this one is fixed among them, as far as that is known.
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
        """Where this board says that the set stands, for each labelling."""
        return tuple(pose @ self.set_from_board.inverse for pose in self.cam_from_board)

    def agreement_px(self, tuning: CalibTuning) -> float:
        """By how much the board may lie elsewhere and still be the same."""
        extent = float(np.ptp(self.detections[0].centres_px, axis=0).max())
        return max(tuning.starts.least_px, tuning.starts.elsewhere_share * extent)

    def nearest(self, cam_from_set: Pose, target: AbstractTarget) -> tuple[int, float]:
        """The labelling that a given pose of the set fits best, and by how many pixels not."""
        pose = cam_from_set @ self.set_from_board
        misses = [miss_px(self.lens, pose, each, target) for each in self.detections]
        best = int(np.argmin(misses))
        return best, misses[best]


def label_sighting(
    camera: int,
    shot: int,
    lens: AbstractLens,
    detection: Detection,
    cam_from_board: Pose,
    target: AbstractTarget,
    board: int = 0,
) -> Sighting:
    """All labellings of a detection, with the pose of the board in each."""
    detections = tuple(
        replace(detection, circle_index=index, ambiguity=None) for index in detection.labellings
    )
    places = [target.centres_mm[each.circle_index] for each in detections]
    poses = tuple(cam_from_board @ motion_in_plane(places[0], place) for place in places)
    return Sighting(camera, shot, lens, detections, poses, board)


def motion_in_plane(here_mm: Float[np.ndarray, "m 2"], there_mm: Float[np.ndarray, "m 2"]) -> Pose:
    """The motion of the plane Z = 0 in itself that takes places `there_mm` to `here_mm`."""
    here, there = here_mm - here_mm.mean(axis=0), there_mm - there_mm.mean(axis=0)
    cross = there[:, 0] @ here[:, 1] - there[:, 1] @ here[:, 0]
    angle = np.arctan2(cross, np.sum(there * here))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    motion = np.eye(3, 4)
    motion[:2, :2] = turn
    motion[:2, 3] = here_mm.mean(axis=0) - turn @ there_mm.mean(axis=0)
    return Pose(motion)
