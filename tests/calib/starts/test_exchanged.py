"""Two cameras are reported as exchanged only if no other pair explains the shot."""

import numpy as np
import pytest

from tests.calib.made_shots import BOARD, board_poses, detection, lens_of
from trinoc.calib.starts import placing
from trinoc.calib.starts.links import AgreedBoard
from trinoc.calib.starts.sightings import IN_PLACE, Sighting
from trinoc.calib.tuning.every_group import TUNING

NAMES = ("left", "middle", "right")


@pytest.mark.parametrize(
    ("explaining", "expected"),
    [([], None), ([(0, 2)], (0, 2)), ([(0, 1), (1, 2)], None), ([(0, 1), (0, 2), (1, 2)], None)],
)
def test_two_explanations_are_none(monkeypatch, explaining, expected) -> None:
    random, pose = np.random.default_rng(0), board_poses(1)[0]
    pictures = [(detection(name, pose, random),) for name in NAMES]
    sightings = [
        Sighting(k, 0, lens_of(name), pictures[k], (IN_PLACE,)) for k, name in enumerate(NAMES)
    ]

    def placed(trial, cam_from_rig, target, tuning) -> AgreedBoard:
        moved = tuple(s.camera for s in trial if s.detections is not pictures[s.camera])
        return AgreedBoard([], IN_PLACE, [] if moved in explaining else [(trial[0], 9.0)])

    monkeypatch.setattr(placing, "place_board", placed)
    assert placing.find_exchanged_pair(sightings, {}, BOARD, TUNING) == expected
