"""Cameras without a common trigger: lenses as good as from each camera alone, and true sigmas."""

import numpy as np
import pytest

from tests.calib.made_shots import BOARD, board_poses, detection
from tests.calib.problem.made_problem import problem
from trinoc.calib.problem.board_shape import _lenses_stay
from trinoc.calib.problem.moments import ImagePoses
from trinoc.calib.problem.robust_fit import RobustFit
from trinoc.calib.problem.unsynchronised import _motion_covariance, fit_with_motion
from trinoc.calib.problem.variables import POSE_SIZE
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.rotation import rotation_from_vector

SHOTS, SIGMA_PX = 14, 0.05


def moving(seed, motion_mm=0.6, motion_deg=0.1):
    """Detections of a moving board. The right camera sees it later, slightly moved and turned."""
    random = np.random.default_rng(seed)
    images = {"left": {}, "right": {}}
    for number, pose in enumerate(board_poses(SHOTS, seed)):
        later = pose.copy()
        turn = np.radians(motion_deg) * random.normal(size=3)
        later[:, :3] = np.asarray(rotation_from_vector(turn)) @ pose[:, :3]
        later[:, 3] += motion_mm * random.normal(size=3)
        for name, shown_pose in (("left", pose), ("right", later)):
            images[name][f"shot {number}"] = detection(name, shown_pose, random, sigma_px=SIGMA_PX)
    return images


# Standard deviations of steps of a pose: turn in rad, shift in units of the problem.
STEP_SIGMA = np.array([1e-3, 2e-3, 5e-4, 0.1, 0.3, 0.2])
MOTION = 0.4 * np.ones((POSE_SIZE, POSE_SIZE)) + 0.6 * np.eye(POSE_SIZE)


def motion_by_drawn_steps(noise=0.9, larger=1.0, shots=600):
    """Estimated covariance of the motion over its standard deviations, from drawn steps of poses.

    Each shot has two images, with a motion drawn from MOTION and noise of the corners in each.

    noise : standard deviation of the noise over that of the motion.
    larger : factor of the motion in 12 of the shots.
    """
    random, size = np.random.default_rng(4), POSE_SIZE
    here = problem(board_poses(1))
    pairs = [each._replace(shot=k) for k in range(shots) for each in here.views[:2]]
    motion = random.normal(size=(2 * shots, size)) @ np.linalg.cholesky(MOTION).T
    motion[:24] *= larger
    step = STEP_SIGMA * (motion + noise * random.normal(size=motion.shape))
    information = np.tile(np.diag((noise * STEP_SIGMA) ** -2), (2 * shots, 1, 1))
    poses = ImagePoses(step, information, np.zeros((2 * shots, 1, 2, size)))
    covariance = _motion_covariance(here._replace(views=tuple(pairs)), poses)
    return covariance / np.outer(STEP_SIGMA, STEP_SIGMA)


def test_the_covariance_of_the_motion_is_that_of_one_image_without_the_noise_of_its_corners():
    # An element of a covariance of 600 differences has a standard deviation of about 0.1.
    motion = motion_by_drawn_steps()
    assert np.abs(motion - MOTION).max() < 0.35
    assert abs(np.trace(motion) / POSE_SIZE - 1) < 0.12


def test_a_few_shots_of_a_far_larger_motion_hardly_enlarge_it():
    """In a fiftieth of the shots the board moves 20 times as far."""
    assert np.trace(motion_by_drawn_steps(larger=20.0)) / POSE_SIZE < 1.5


@pytest.fixture(scope="module")
def fits():
    return [calibrate_rig(moving(seed), BOARD, systematics=Systematics()) for seed in range(3)]


def test_the_cause_is_named_with_its_size(fits):
    for result in fits:
        assert any("are not synchronised" in note for note in result.notes)


def test_sigmas_of_corners_are_those_of_each_camera_alone(fits):
    """The motion is about ten times the noise of the corners and must not be included in it."""
    for result in fits:
        assert all(0.8 < fit.sigma_factor < 1.3 for fit in result.fits.values())


def test_lenses_are_as_good_as_those_of_cameras_alone(fits):
    """Errors of focal lengths have the reported sigma, which is no larger than for one camera."""
    normalised = []
    for seed, result in enumerate(fits):
        alone = calibrate_rig({"left": moving(seed)["left"]}, BOARD, systematics=Systematics())
        assert result.sigma("left.fx_px") < 1.2 * alone.sigma("left.fx_px")
        true = {
            "left.fx_px": 800.0,
            "left.fy_px": 805.0,
            "right.fx_px": 820.0,
            "right.fy_px": 818.0,
        }
        normalised += [(result.value(n) - v) / result.sigma(n) for n, v in true.items()]
    assert 0.4 < np.sqrt(np.mean(np.square(normalised))) < 1.6


def test_the_baseline_has_the_stated_sigma(fits):
    """The cameras stand 440 mm apart but for the turn of their frames."""
    truth = _baseline_mm()
    normalised = [
        (result.pairs[0].baseline_mm - truth) / result.pairs[0].baseline_sigma_mm for result in fits
    ]
    assert np.sqrt(np.mean(np.square(normalised))) < 2.0


def _baseline_mm():
    from tests.calib.made_shots import cam_from_rig, inverse

    centres = [inverse(cam_from_rig(name))[:, 3] for name in ("left", "right")]
    return float(np.linalg.norm(centres[1] - centres[0]))


def test_the_prior_of_the_shape_does_not_pull_at_the_size():
    """A board with displaced corners keeps its stated size, which no image contradicts."""
    random = np.random.default_rng(1)
    aside_mm = 0.2 * random.normal(size=(len(BOARD), 3))
    images = {
        name: {
            f"shot {k}": detection(name, pose, random, sigma_px=0.02, aside_mm=aside_mm)
            for k, pose in enumerate(board_poses(SHOTS, 3))
        }
        for name in ("left", "right")
    }
    systematics = Systematics(print_size_sigma=0.01, flatness_mm=0.3)
    result = calibrate_rig(images, BOARD, systematics=systematics)
    assert len(result.place_shifts_mm)
    size = 0.5 * (result.value("board.scale_x") + result.value("board.scale_y"))
    assert abs(size) < 1e-4


def test_a_shape_that_runs_away_with_the_lens_is_refused(fits):
    import equinox as eqx

    problem = fits[0].solved_problem.problem
    assert _lenses_stay(problem, problem)
    away = eqx.tree_at(
        lambda s: s.lenses.focal_length_px,
        problem.state,
        0.3 * np.asarray(problem.state.lenses.focal_length_px),
    )
    assert not _lenses_stay(problem, problem._replace(state=away))


def test_without_two_images_of_a_shot_there_is_no_motion_to_find(fits):
    """All images of the right camera may have been dropped as wrong."""
    fit = RobustFit(fits[0].solved_problem.problem, True, [], 0.0, 0)
    views = tuple(view._replace(used=view.used & (view.camera == 0)) for view in fit.problem.views)
    left_alone = fit._replace(problem=fit.problem._replace(views=views))
    assert fit_with_motion(left_alone, fit) is None
