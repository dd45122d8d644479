"""A rig at rest raises no alarm; a knocked camera is named and corrected."""

import numpy as np
import pytest

from tests.calib.bundle.made_tracks import NAMES, SHEET_SIGMA, TRUTH, made_tracks, rig_at
from trinoc.calib.rig_check.knocked import check_rig
from trinoc.calib.tuning.every_group import TUNING
from trinoc.errors import CalibrationError
from trinoc.numerics.tables import take_rows, with_field

SIZES_DEG = 0.2


def knocked(seed, cameras, size):
    """A calibration of the rig before some of its cameras were turned by `size` degrees."""
    random = np.random.default_rng(seed)
    values = TRUTH + SHEET_SIGMA * random.standard_normal(12)
    for camera in cameras:
        rows = [i for i, name in enumerate(NAMES) if name.startswith(camera)][:3]
        values[rows] += size * random.choice([-1, 1], 3)
    return rig_at(values, with_covariance=True)


@pytest.mark.slow
def test_a_rig_at_rest_is_left_in_peace():
    suspected = 0
    for seed in range(10):
        lines, _, _ = made_tracks(seed, 100)
        check = check_rig(knocked(300 + seed, (), 0), lines)
        suspected += bool(check.moved)
        assert "No camera has moved" in check.summary() or check.moved
    assert suspected <= 1


@pytest.mark.parametrize("camera", ["upper", "right", "left"])
def test_a_knocked_camera_is_named_and_corrected(camera):
    lines, _, _ = made_tracks(40, 100)
    rig = knocked(41, (camera,), SIZES_DEG)
    check = check_rig(rig, lines)
    assert check.moved == (camera,)
    assert check.refined is not None
    motion = next(motion for motion in check.motions if motion.name == camera)
    assert motion.sigmas > 4
    truth = dict(zip(NAMES, TRUTH.tolist(), strict=True))
    rows = [i for i, name in enumerate(check.refined.parameters) if name.startswith(camera)]
    right = [truth.get(check.refined.parameters[i], 0.0) for i in rows]  # the aims are at 0
    error = check.refined.values[rows] - right
    sigma = np.sqrt(np.diag(check.refined.covariance))[rows]
    assert (abs(error) < 4 * sigma).all()
    assert camera in check.summary()


def test_two_knocked_cameras_are_not_corrected_in_secret():
    lines, _, _ = made_tracks(50, 100)
    check = check_rig(knocked(51, ("upper", "left"), 1.0), lines)
    assert len(check.moved) >= 2
    assert check.refined is None
    assert "calibrate the rig again" in check.summary()


def test_a_rig_without_covariance_cannot_be_checked():
    lines, _, _ = made_tracks(60, 10)
    with pytest.raises(CalibrationError, match="covariance of their calibration"):
        check_rig(rig_at(TRUTH, with_covariance=False), lines)


def test_a_scene_that_tells_nothing_is_said_to():
    lines, _, _ = made_tracks(80, 100, hidden=0.94)
    assert 3 < lines.seen.all(axis=1).sum() < 12
    check = check_rig(knocked(81, ("left",), SIZES_DEG), lines)
    assert not check.conclusive
    assert check.moved == ()
    assert "is not sufficient" in check.summary()


def test_matching_again_while_checking_finds_the_camera():
    lines, _, _ = made_tracks(82, 100)
    rig = knocked(83, ("right",), SIZES_DEG)
    check = check_rig(rig, take_rows(lines, np.arange(100) < 80), match_again=lambda rig: lines)
    assert check.conclusive
    assert check.moved == ("right",)
    assert check.refined is not None
    assert len(check.refined.tracks) == 100


@pytest.mark.parametrize(
    ("share", "camera", "is_matched_again"),
    [(0.6, None, False), (0.4, None, True), (0.6, "right", True)],
    ids=["at rest", "lines may be hidden", "a motion shows"],
)
def test_a_scene_is_matched_again_only_where_something_calls_for_it(
    share, camera, is_matched_again
):
    lines, _, _ = made_tracks(84, 100)
    calls = []

    class Tracks:
        share_in_three_views = share

        def line_observations(self):
            return lines

    def match_again(rig):
        calls.append(rig)
        return lines

    check_rig(
        knocked(85, () if camera is None else (camera,), SIZES_DEG),
        Tracks(),
        match_again=match_again,
    )
    assert bool(calls) is is_matched_again


def test_another_limit_of_suspicion_is_used_after_a_call_with_the_default():
    lines, _, _ = made_tracks(40, 100)
    rig = knocked(41, ("right",), SIZES_DEG)
    usual = check_rig(rig, lines)
    assert usual.moved == ("right",)
    patient = with_field(TUNING, "rig_check.suspect_sigmas", 1e6)
    check = check_rig(rig, lines, tuning=patient)
    assert check.moved == ()
    assert [motion.sigmas for motion in check.motions] == [each.sigmas for each in usual.motions]
    # The summary lists the change of each suspected motion, by the limit of its own check.
    assert "+-" in usual.summary()
    assert "+-" not in check.summary()
