"""Messages for common mistakes with shots."""

import re
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from tests.calib.made_shots import BOARD, LENSES, SIZE_PX, board_poses, cam_from_rig, lens_of, shots
from tests.calib.problem.made_problem import problem
from trinoc.calib import Detection, sentences
from trinoc.calib.problem.outcome import ShotScatter
from trinoc.calib.problem.rao_test import FixedScore, detectable_sigmas
from trinoc.calib.refutations import _Noise
from trinoc.calib.result.calibration import CalibrationResult, Status
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.shot_notes import reason_undetermined
from trinoc.calib.starts.camera_start import start_poses
from trinoc.calib.starts.placing import boards_are_parallel, find_exchanged_pair
from trinoc.calib.starts.sightings import label_sighting
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import Pose
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.pose import PoseModel

EXACT = Systematics()
KNOWN = {name: Intrinsics.of_lens(lens_of(name), SIZE_PX) for name in LENSES}
# The labels of a board whose drawing is mirrored, left to right.
MIRRORED = np.arange(len(BOARD)).reshape(BOARD.rows, BOARD.columns)[:, ::-1].ravel()


def altered(detection: Detection, **fields: Any) -> Detection:
    return type(detection)(**{**vars(detection), **fields})


def test_pictures_exchanged_in_some_shots_are_named():
    detections = shots()
    detections["left"][4], detections["right"][4] = detections["right"][4], detections["left"][4]
    refused = calibrate_rig(detections, BOARD, lens=KNOWN, systematics=EXACT).refused
    assert any(
        each.startswith('shot 5: the images of "left" and "right" seem to be exchanged')
        for each in refused
    )
    assert all(each.startswith("shot 5") for each in refused)


def test_an_exchange_is_found_in_its_own_shot_alone():
    poses = {k: Pose(cam_from_rig(name)) for k, name in enumerate(LENSES)}

    def sightings(order: tuple[str, ...], shot: int):
        lenses = [lens_of(name) for name in LENSES]
        detections = [shots(cameras=(name,))[name][shot] for name in order]
        starts = [start_poses(*each, BOARD) for each in zip(lenses, [[f] for f in detections])]
        return [
            label_sighting(k, shot, start.lens, each, start.cam_from_board[0], BOARD)
            for k, (start, each) in enumerate(zip(starts, detections, strict=True))
        ]

    assert find_exchanged_pair(sightings(("middle", "left", "right"), 2), poses, BOARD, TUNING) == (
        0,
        1,
    )
    assert (
        find_exchanged_pair(sightings(("middle", "right", "left"), 2), poses, BOARD, TUNING) is None
    )


def test_folders_exchanged_as_a_whole_are_known_by_lenses_of_other_pictures_alone():
    detections = shots(count=2)
    lenses = dict(KNOWN) | {"left": Intrinsics.of_lens(lens_of("left"), (800, 600))}
    with pytest.raises(InputError, match=r'of "left" is for images of 800 x 600 px, but .* 640'):
        calibrate_rig(detections, BOARD, lens=lenses)


def test_a_mirrored_layout_is_told():
    detections = {
        camera: [
            altered(each, circle_index=MIRRORED[each.circle_index]) for each in camera_detections
        ]
        for camera, camera_detections in shots().items()
    }
    notes = calibrate_rig(detections, BOARD, lens=KNOWN, systematics=EXACT).notes
    assert any("show the board from behind" in note for note in notes)


def test_one_camera_whose_pictures_are_mirrored_is_told():
    detections = shots()
    detections["right"] = [
        altered(
            each,
            circle_index=MIRRORED[each.circle_index],
            centres_px=[SIZE_PX[0] - 1, 0] + [-1, 1] * np.asarray(each.centres_px),
        )
        for each in detections["right"]
    ]
    with pytest.raises(CalibrationError, match=r"\(the groups are left, middle; right\).* mirror"):
        calibrate_rig(detections, BOARD)


def test_boards_that_are_parallel_in_all_shots_are_told():
    with pytest.raises(CalibrationError, match="parallel in all shots"):
        calibrate_rig(shots(tilt_deg=0.0), BOARD)
    assert not boards_are_parallel([Pose(np.eye(3, 4))])


def test_another_board_that_looks_alike_is_refused_by_its_shot():
    detections, other = shots(), shots(seed=9)
    detections["right"][1] = other["right"][2]
    (sentence,) = calibrate_rig(detections, BOARD, lens=KNOWN, systematics=EXACT).refused
    assert sentence.startswith('shot 2: "right" shows the board')
    assert "another board that looks the same" in sentence


def test_a_wrong_size_of_the_squares_shows_in_no_residual_and_the_summary_says_so():
    detections = shots()
    right, wrong = (
        calibrate_rig(detections, Chessboard(rows=5, columns=6, square_mm=mm), lens=KNOWN)
        for mm in (25.0, 26.0)
    )
    assert wrong.rms_px() == pytest.approx(right.rms_px(), rel=1e-6)
    assert (
        "scale: taken from the board, 130 x 104 mm from the first to the last corner"
        in wrong.summary()
    )
    assert "print size" in wrong.summary()


def with_left(skew_px: float = 0.0, **off: float) -> dict[str, Intrinsics]:
    """True lenses of all cameras, with that of "left" changed by these amounts."""
    lens = lens_of("left")
    names = lens.parameter_names
    values = np.array(lens.parameters) + [off.get(name, 0.0) for name in names]
    wrong = Intrinsics(
        focal_length_px=values[:2],
        image_size_px=SIZE_PX,
        principal_point_px=values[2:4],
        skew_px=skew_px,
        distortion=tuple(values[4:]),
    )
    return KNOWN | {"left": wrong}


@pytest.mark.parametrize(
    ("wrong", "named", "amount"),
    [
        ({"fx_px": 8.0, "fy_px": 8.05}, "fx_px", -8.0),
        ({"k1": 0.06}, "k1", -0.06),
        ({"skew_px": 3.0}, "skew_px", -3.0),
    ],
)
def test_a_lens_that_was_given_and_shots_refute_is_named(wrong, named, amount):
    result = calibrate_rig(shots(), BOARD, lens=with_left(**wrong), systematics=EXACT)
    assert result.overall_status is Status.SUSPECT
    assert result.has_rig
    assert 'given lens of "left"' in result.notes[0]
    pattern = rf"largest estimated corrections are {named} by (\S+) \+- (\S+?)(?:, |\. )"
    match = re.search(pattern, result.notes[0])
    assert match is not None
    assert float(match[1]) == pytest.approx(amount, abs=4 * float(match[2]))
    assert result.summary().startswith("SUSPECT: The shots contradict the given lens")


def test_a_lens_of_all_cameras_is_refuted_as_one(monkeypatch):
    monkeypatch.setitem(LENSES, "right", LENSES["left"])
    detections, wrong = shots(cameras=("left", "right")), with_left(k1=0.1)["left"]
    result = calibrate_rig(detections, BOARD, lens=wrong, same_lens=True, systematics=EXACT)
    assert result.overall_status is Status.SUSPECT
    assert (
        'given lens of "left", "right". The largest estimated corrections are k1' in result.notes[0]
    )


def test_a_lens_that_is_another_cameras_is_refuted():
    """All parameters are wrong, so that the shots do not agree on one cause."""
    lenses = KNOWN | {"left": KNOWN["right"]}
    result = calibrate_rig(shots(), BOARD, lens=lenses, systematics=EXACT)
    assert result.overall_status is Status.SUSPECT
    assert 'given lens of "left"' in result.notes[0]


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 9))]
)
def test_lenses_that_are_as_given_are_hardly_ever_accused(seed):
    """Right lenses are refuted once in 10,000, even if the board moves between the cameras."""
    detections = shots(seed=seed, count=4, cameras=("left", "right"))
    later = np.random.default_rng(seed).normal(0, 0.6, (4, 1, 2))
    pairs = zip(detections["right"], later, strict=True)
    moved = [altered(each, centres_px=each.centres_px + by) for each, by in pairs]
    lens = {name: KNOWN[name] for name in detections}
    for each in (detections, detections | {"right": moved}):
        result = calibrate_rig(each, BOARD, lens=lens, systematics=EXACT)
        assert result.overall_status is Status.CONVERGED


def test_an_error_of_a_lens_that_goes_unseen_moves_a_camera_as_is_said():
    """A lens error of the stated size moves the rig by the stated number of sigmas."""

    def fitted(lenses: dict[str, Intrinsics]) -> CalibrationResult:
        two = {name: lenses[name] for name in ("left", "right")}
        detections = shots(cameras=("left", "right"))
        return calibrate_rig(
            detections, BOARD, lens=two, systematics=EXACT, world="left", throw=False
        )

    right = fitted(KNOWN)
    (note,) = right.notes
    pattern = r'"(\w+)" is assumed.* cx_px by (\S+) and cy_px by (\S+)\. This .* by (\d+) of its'
    match = re.search(pattern, note)
    assert match is not None
    wrong = np.array(LENSES[match[1]])
    wrong[2:4] += float(match[2]), float(match[3])
    lens = Intrinsics.of_lens(BrownConrady.from_parameters(wrong), SIZE_PX)
    off = fitted(KNOWN | {match[1]: lens})
    assert right.has_rig
    assert off.has_rig
    before, after = right.rig["right"].pose, off.rig["right"].pose
    start, end = (each.model_parameters(PoseModel.RIGID, before) for each in (before, after))
    step = np.asarray(end) - np.asarray(start)
    step[:3] = np.degrees(step[:3])
    sigma = [right.sigma(f"right.{name}") for name in PoseModel.RIGID.parameter_names]
    # Numbers are said with two digits.
    assert np.abs(step / sigma).max() == pytest.approx(float(match[4]), rel=0.1)


@pytest.mark.parametrize("freedom", [1, 2, 4])
def test_what_goes_unseen_is_found_as_often_as_is_said(freedom):
    random, chance = np.random.default_rng(freedom), 1e-3
    off = np.zeros(freedom)
    off[0] = detectable_sigmas(chance, freedom)
    squared = np.sum((random.normal(size=(20000, freedom)) + off) ** 2, axis=1)
    share = np.mean(squared > chi2.isf(chance, freedom))
    assert share == pytest.approx(TUNING.answer.power, abs=0.01)


def test_a_board_that_is_parallel_in_all_shots_is_told():
    flat = np.stack([board_poses(1)[0]] * 3)
    flat[:, :, 3] += np.arange(3)[:, None] * 20.0
    assert reason_undetermined(problem(flat)) == sentences.PARALLEL_BOARDS


def test_rounding_errors_are_no_noise_that_tests_divide_by():
    nothing = np.zeros((1, 1)), np.zeros(1), np.ones(1)
    exact = FixedScore(*nothing, squared=0.0, freedom=10, are_exact=True)
    assert _Noise.of(exact, ShotScatter(factor=1.0, sigma=0.1)).variance > 0
