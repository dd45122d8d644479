"""Mistakes that people make with shots, and the sentence that each gives."""

from typing import Any

import numpy as np
import pytest

from tests.calib.shots.made_shots import BOARD, LENSES, SIZE_PX, cam_from_rig, lens_of, shots
from trinoc.calib import Detection
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.starts.camera_start import start_poses
from trinoc.calib.starts.placing import boards_are_parallel, find_exchanged_pair
from trinoc.calib.starts.sightings import label_sighting
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import Pose
from trinoc.geometry.intrinsics import Intrinsics

EXACT = Systematics()
KNOWN = {name: Intrinsics.of_lens(lens_of(name), SIZE_PX) for name in LENSES}
# The labels of a board whose drawing is mirrored, left to right.
MIRRORED = np.arange(len(BOARD)).reshape(BOARD.rows, BOARD.columns)[:, ::-1].ravel()


def altered(detection: Detection, **fields: Any) -> Detection:
    return type(detection)(**{**vars(detection), **fields})


def test_pictures_exchanged_in_some_shots_are_named():
    seen = shots()
    seen["left"][4], seen["right"][4] = seen["right"][4], seen["left"][4]
    refused = calibrate_rig(seen, BOARD, lens=KNOWN, systematics=EXACT).refused
    assert any(
        each.startswith('shot 5: the pictures of "left" and "right" look exchanged')
        for each in refused
    )
    assert all(each.startswith("shot 5") for each in refused)


def test_an_exchange_is_found_in_its_own_shot_alone():
    poses = {k: Pose(cam_from_rig(name)) for k, name in enumerate(LENSES)}

    def seen_by(order: tuple[str, ...], shot: int):
        lenses = [lens_of(name) for name in LENSES]
        found = [shots(cameras=(name,))[name][shot] for name in order]
        starts = [start_poses(*each, BOARD) for each in zip(lenses, [[f] for f in found])]
        return [
            label_sighting(k, shot, start.lens, each, start.cam_from_board[0], BOARD)
            for k, (start, each) in enumerate(zip(starts, found, strict=True))
        ]

    assert find_exchanged_pair(seen_by(("middle", "left", "right"), 2), poses, BOARD) == (0, 1)
    assert find_exchanged_pair(seen_by(("middle", "right", "left"), 2), poses, BOARD) is None


def test_folders_exchanged_as_a_whole_are_known_by_lenses_of_other_pictures_alone():
    seen = shots(count=2)
    known = dict(KNOWN) | {"left": Intrinsics.of_lens(lens_of("left"), (800, 600))}
    with pytest.raises(InputError, match=r'of "left" is for pictures of 800 x 600 px, but .* 640'):
        calibrate_rig(seen, BOARD, lens=known)


def test_a_mirrored_layout_is_told():
    seen = {
        camera: [altered(each, circle_index=MIRRORED[each.circle_index]) for each in own]
        for camera, own in shots().items()
    }
    notes = calibrate_rig(seen, BOARD, lens=KNOWN, systematics=EXACT).notes
    assert any("show the board from behind" in note for note in notes)


def test_one_camera_whose_pictures_are_mirrored_is_told():
    seen = shots()
    seen["right"] = [
        altered(
            each,
            circle_index=MIRRORED[each.circle_index],
            centres_px=[SIZE_PX[0] - 1, 0] + [-1, 1] * np.asarray(each.centres_px),
        )
        for each in seen["right"]
    ]
    with pytest.raises(CalibrationError, match=r"\(the groups are left, middle; right\).* mirror"):
        calibrate_rig(seen, BOARD)


def test_boards_that_are_parallel_in_all_shots_are_told():
    with pytest.raises(CalibrationError, match="parallel in all shots"):
        calibrate_rig(shots(tilt_deg=0.0), BOARD)
    assert not boards_are_parallel([Pose(np.eye(3, 4))])


def test_another_board_that_looks_alike_is_refused_by_its_shot():
    seen, other = shots(), shots(seed=9)
    seen["right"][1] = other["right"][2]
    (sentence,) = calibrate_rig(seen, BOARD, lens=KNOWN, systematics=EXACT).refused
    assert sentence.startswith('shot 2: "right" shows the board')
    assert "another board that looks alike" in sentence


def test_a_wrong_size_of_the_squares_shows_in_no_residual_and_the_summary_says_so():
    seen = shots(count=2)
    right, wrong = (
        calibrate_rig(seen, Chessboard(rows=5, columns=6, square_mm=mm), lens=KNOWN)
        for mm in (25.0, 26.0)
    )
    assert wrong.rms_px() == pytest.approx(right.rms_px(), rel=1e-6)
    assert "it was said to be 130 x 104 mm from first to last place" in wrong.summary()
    assert "print size" in wrong.summary()
