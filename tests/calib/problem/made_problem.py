"""Problem of a rig of three cameras, at the truth."""

import numpy as np

from tests.calib.made_shots import BOARD, SIZE_PX, cam_from_rig, lens_of, shots
from trinoc.calib.problem.problem import FreeLensParameters
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.problem.views import BoardObservation
from trinoc.calib.uncertainty.systematics import Systematics

CAMERAS = ("left", "middle", "right")


def problem(poses, systematics=None):
    """Problem at the truth, with noise in the detections."""
    detections = shots(count=len(poses))
    views = [
        BoardObservation(c, s, each, np.ones(len(each), dtype=bool))
        for c, camera_detections in enumerate(detections.values())
        for s, each in enumerate(camera_detections)
    ]
    lenses = [lens_of(name) for name in CAMERAS]
    return start_problem(
        views,
        BOARD,
        lenses,
        np.stack([cam_from_rig(name) for name in CAMERAS]),
        poses,
        [SIZE_PX] * 3,
        FreeLensParameters(np.arange(3), np.ones((3, 9), dtype=bool)),
        Systematics.typical({}) if systematics is None else systematics,
    )
