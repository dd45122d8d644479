"""Errors of shots that the fit leaves out, predicted by the lens alone and by the rig."""

import dataclasses

import numpy as np
import pytest

from tests.calib.made_shots import BOARD, LENSES, SIGMA_PX, shots
from trinoc.calib.result.halves import CrossValidation
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.uncertainty.systematics import Systematics

EXACT = Systematics()


@pytest.fixture(scope="module")
def errors():
    return calibrate_rig(shots(), BOARD, systematics=EXACT).cross_validation


def test_a_shot_held_out_is_missed_by_noise_and_by_what_the_others_do_not_tell(errors):
    # The pose takes six of the 60 coordinates of 30 points.
    noise_px = SIGMA_PX * np.sqrt(2.0 * (60 - 6) / 60)
    assert errors.shots == 7
    for name in LENSES:
        assert 0.9 * noise_px < errors.own_px[name] < 1.2 * noise_px
        assert 1.2 * noise_px < errors.across_px[name] < 6 * noise_px


def test_a_camera_that_moves_between_shots_shows_in_the_other_cameras_alone(errors):
    detections = shots()
    steps = np.arange(len(detections["right"]))[:, None] % 2 * [0.6, 0.0]
    detections["right"] = [
        dataclasses.replace(each, centres_px=each.centres_px + step)
        for each, step in zip(detections["right"], steps, strict=True)
    ]
    moved = calibrate_rig(detections, BOARD, systematics=EXACT).cross_validation
    assert moved is not None
    assert moved.across_px["right"] > 2.0 * errors.across_px["right"]
    assert moved.own_px["right"] < 1.2 * errors.own_px["right"]


def test_one_camera_has_no_other_to_be_told_by():
    alone = CrossValidation(7, {"left": 0.1}, {}).sentence
    assert "0.100 px (left)" in alone
    assert "another camera" not in alone


def test_too_few_shots_are_not_held_out():
    assert calibrate_rig(shots(count=3), BOARD, systematics=EXACT).cross_validation is None
