"""The advised next shot has the promised effect, and more effect than other shots."""

import json

import equinox as eqx
import numpy as np
import pytest

from tests.calib.made_shots import BOARD, LENSES, board_poses, chained, detection, shots
from trinoc.calib import next_shot
from trinoc.calib.advice.foreseen_shots import candidate_shots, foresee_shots, point_sigma_px
from trinoc.calib.advice.next_shot import add_shot, shot_error_px
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.cli.calibrate_rig import rig_record, shot_record
from trinoc.errors import InputError
from trinoc.geometry import Pose

CAMERAS = tuple(LENSES)


def calibrated(detections):
    return calibrate_rig(detections, BOARD, systematics=Systematics(), distortion=4)


def worst_error_px(result):
    end = result.solved_problem
    return max(
        shot_error_px(shot, end.covariance)
        for shot in foresee_shots(end.problem, candidate_shots(end.problem))
    )


@pytest.fixture(scope="module")
def before():
    return calibrated(shots())


@pytest.fixture(scope="module")
def advice(before):
    return next_shot(before)


@pytest.fixture(scope="module")
def after(advice):
    """The calibration with the advised shot added. Its world is the board of the first shot."""
    pose, random = chained(board_poses(7)[0], advice.world_from_board), np.random.default_rng(9)
    detections = shots()
    for name, camera_detections in detections.items():
        camera_detections.append(detection(name, pose, random) if name in advice.cameras else None)
    return calibrated(detections)


def test_what_is_promised_comes(advice, after):
    assert advice.error_then_px < 0.5 * advice.error_now_px
    assert worst_error_px(after) == pytest.approx(advice.error_then_px, rel=0.35)
    promised = np.array(list(advice.sigma_then.values()))
    sigmas = np.array([after.sigma(name) for name in advice.sigma_then])
    # Noise's scale, and with it all sigmas, is told anew by each camera's residuals.
    np.testing.assert_allclose(sigmas, promised, rtol=0.25)


def test_the_advice_gives_more_than_another_shot(after):
    assert worst_error_px(after) < 0.5 * worst_error_px(calibrated(shots(count=8)))


def test_a_shot_never_takes_away(before):
    end = before.solved_problem
    foreseen = foresee_shots(end.problem, candidate_shots(end.problem))
    assert {camera for shot in foreseen for camera in shot.cameras} == {0, 1, 2}
    for shot in foreseen[::17]:
        less = end.covariance - add_shot(end.covariance, shot, end.variance_factor)
        assert np.linalg.eigvalsh(less).min() > -1e-9 * np.abs(end.covariance).max()
        assert shot_error_px(shot, end.covariance) > 0


def test_a_shot_that_was_taken_is_foreseen_as_it_was(before):
    """The predicted shot has as many points as the real one, with the sigmas that the fit uses."""
    problem = before.solved_problem.problem
    shot = foresee_shots(problem, candidate_shots(problem)[:2])[0]
    ratios = [np.median([v.sigma_ratio for v in problem.views if v.camera == c]) for c in range(3)]
    factors = np.array([before.fits[c].sigma_factor for c in CAMERAS])
    np.testing.assert_allclose(point_sigma_px(problem), 0.05 * factors * ratios, rtol=0.03)
    foreseen = foresee_shots(
        problem,
        [
            shot.candidate._replace(rig_from_board=Pose(problem.state.rig_from_board[k]))
            for k in range(7)
        ],
    )
    assert [each.point_count for each in foreseen] == [
        sum(len(view.detection) for view in problem.views if view.shot == k) for k in range(7)
    ]


def test_the_sentence_says_who_sees_it_and_where(advice, before):
    for name in advice.cameras:
        assert name in advice.sentence
    assert "of its image" in advice.sentence
    assert advice.parameter in before.parameters
    assert f"sigma of {advice.parameter}" in advice.sentence
    without_parameter = advice._replace(parameter=None)
    assert "sigma of" not in without_parameter.sentence


def test_the_command_s_record_is_json(advice, before):
    record = json.loads(json.dumps({**rig_record(before), "next_shot": shot_record(advice)}))
    assert record["next_shot"]["sentence"] == advice.sentence
    assert np.shape(record["next_shot"]["world_from_board"]) == (3, 4)
    assert set(record["cross_validation"]["across_px"]) == set(CAMERAS)
    assert shot_record(None) is None


def test_what_did_not_converge_has_no_next_shot(before):
    nothing = eqx.tree_at(lambda result: result.solved_problem, before, None)
    with pytest.raises(InputError, match="A shot cannot be added"):
        next_shot(nothing)
