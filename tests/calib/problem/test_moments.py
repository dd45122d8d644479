"""Images taken at another moment leave their shots, and images of one moment do not."""

import numpy as np
import pytest

from tests.calib.made_shots import BOARD, board_poses, detection
from tests.calib.problem.made_problem import problem
from trinoc.calib.problem.misfit_causes import change_point, lens_pattern_px, smooth_pattern_px
from trinoc.calib.problem.moments import (
    errors_about_image_poses_px,
    find_unsynchronised_images,
    fit_image_poses,
    images_of_shots,
    split_into_own_shots,
    typical_excess,
)
from trinoc.calib.problem.problem import with_free_parameters
from trinoc.calib.problem.robust_fit import errors_px, fit_points, whitened_errors
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.numerics.tables import with_field

SHOTS = 10


def moved_images(seed=0, moved=(), shift_mm=6.0, late=()):
    """Detections of both cameras; in the shots `moved` the right one sees the board displaced."""
    random = np.random.default_rng(seed)
    images = {"left": {}, "right": {}}
    for number, pose in enumerate(board_poses(SHOTS, seed)):
        for name in images:
            shown_pose = pose.copy()
            if name == "right" and (number in moved or number in late):
                shown_pose[0, 3] += shift_mm
            images[name][f"shot {number}"] = detection(name, shown_pose, random)
    return images


@pytest.fixture(scope="module")
def fair():
    return calibrate_rig(moved_images(), BOARD, systematics=Systematics())


def test_shots_of_one_moment_stay_together(fair):
    assert fair.refused == ()
    assert not any("moment" in note or "moved" in note for note in fair.notes)


def test_shots_of_other_moments_are_named_and_move_no_camera(fair):
    result = calibrate_rig(moved_images(moved=(2, 7)), BOARD, systematics=Systematics())
    named = {sentence.partition(":")[0] for sentence in result.refused}
    assert named == {"shot 2", "shot 7"}
    for name in ("right.fx_px", "left.fx_px", "right.distance_mm"):
        assert abs(result.value(name) - fair.value(name)) < 4 * result.sigma(name)
    # Each image still serves for its camera's lens.
    assert all(
        len({v.shot for v in result.views if v.camera == c and v.used.any()}) == SHOTS
        for c in (0, 1)
    )


def of_shots(*, late_mm=0.0, seed=0):
    """Problem with the true cameras and the best-fitting poses of the shots.

    For the middle camera the board is displaced in shot 2.
    """
    here = problem(board_poses(6))
    views = list(here.views)
    random = np.random.default_rng(seed)
    for k, view in enumerate(views):
        aside = np.array([late_mm, 0.0, 0.0]) * ((view.camera, view.shot) == (1, 2))
        pose = np.array(here.state.rig_from_board[view.shot])
        pose[:, 3] += aside
        name = ("left", "middle", "right")[view.camera]
        views[k] = view._replace(detection=detection(name, pose, random))
    here = here._replace(views=tuple(views))
    fixed_cameras = with_free_parameters(here, np.zeros(len(here.free)))
    return fit_points(fixed_cameras)[0]


def test_the_excess_is_the_fall_of_chi_square_where_each_image_has_a_pose_of_its_own():
    """Lenses and cameras are fixed, and all points have full weight.

    The excess is the median over the six shots, divided by 12 degrees of freedom.
    """
    together = of_shots()._replace(tuning=with_field(TUNING, "problem.gate", 1e6))
    others = [k for images in images_of_shots(together).values() for k in images[1:]]
    separated, _ = fit_points(split_into_own_shots(together, others))
    before, after = (
        np.sum(np.square(whitened_errors(each)), axis=(1, 2))[: len(together.views)]
        for each in (together, separated)
    )
    shot_of = np.array([view.shot for view in together.views])
    fall = np.bincount(shot_of, before - after) / 12
    median = (1 - 2 / (9 * 12)) ** 3
    assert typical_excess(together) == pytest.approx(np.median(fall) / median, rel=0.02)


def test_images_of_one_moment_have_an_excess_of_one():
    """The excess averages 20 medians of six chi-square values, over the median of the law."""
    excess = [typical_excess(of_shots(seed=seed)) for seed in range(20)]
    assert abs(np.mean(excess) - 1.0) < 0.15


def test_of_three_images_the_one_that_disagrees_is_named():
    here = of_shots(late_mm=4.0)
    (other,) = find_unsynchronised_images(here)
    view = here.views[other.view]
    assert (view.camera, view.shot) == (1, 2)


def test_errors_about_its_own_pose_are_the_noise_of_an_image_of_another_moment():
    """The noise is 0.05 px, of which the fitted pose absorbs a tenth."""
    here = of_shots(late_mm=1.0)
    (k,) = (k for k, view in enumerate(here.views) if (view.camera, view.shot) == (1, 2))
    before, after = (
        float(np.sqrt(np.mean(errors**2)))
        for errors in (
            errors_px(here)[k],
            errors_about_image_poses_px(here, fit_image_poses(here))[k],
        )
    )
    assert before > 0.3
    assert 0.035 < after < 0.06


def test_noise_alone_has_no_pattern():
    random = np.random.default_rng(0)
    positions_px = [random.uniform(0, 640, (54, 2)) for _ in range(15)]
    board = [np.asarray(BOARD.centres_mm) for _ in positions_px]
    noise = [random.normal(0, 0.1, (54, 2)) for _ in positions_px]
    assert lens_pattern_px(noise, positions_px, (640, 640)) == 0.0
    assert smooth_pattern_px([n[: len(b)] for n, b in zip(noise, board)], board) == 0.0


def test_a_pattern_of_the_image_has_its_amplitude():
    random = np.random.default_rng(1)
    positions_px = [random.uniform(0, 640, (54, 2)) for _ in range(25)]
    pattern = [0.3 * np.sin(position / 100) for position in positions_px]
    residuals = [each + random.normal(0, 0.1, each.shape) for each in pattern]
    true_px = np.sqrt(np.mean(np.sum(np.concatenate(pattern) ** 2, axis=1)))
    assert abs(lens_pattern_px(residuals, positions_px, (640, 640)) / true_px - 1) < 0.15


def test_a_bend_that_differs_between_images_has_its_amplitude():
    random = np.random.default_rng(2)
    board = [np.asarray(BOARD.centres_mm) for _ in range(20)]
    x = [2 * b[:, 0] / np.ptp(b[:, 0]) for b in board]
    bends = [random.normal(0, 0.5) * np.stack([e**2, e * e], axis=1) for e in x]
    # A pose has taken the mean and the slope away.
    bends = [b - b.mean(axis=0) for b in bends]
    residuals = [b + random.normal(0, 0.1, b.shape) for b in bends]
    true_px = np.sqrt(np.mean(np.sum(np.concatenate(bends) ** 2, axis=1)))
    assert abs(smooth_pattern_px(residuals, board) / true_px - 1) < 0.15


def test_a_jump_is_found_where_it_is_and_scatter_is_none():
    random = np.random.default_rng(3)
    shifts = random.normal(0, 0.2, (20, 2))
    assert change_point(shifts) is None
    shifts[13:] += [4.0, 0.0]
    jump = change_point(shifts)
    assert jump is not None
    index, size_px = jump
    assert index == 13
    assert abs(size_px - 4.0) < 0.4
