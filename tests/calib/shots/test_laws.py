"""Laws of the pieces: poses from rays, gradients, centres of circles' images, labellings."""

import jax
import numpy as np
import pytest

from tests.calib.shots.equations import assert_equations_are_those_of_the_cost
from tests.calib.shots.made_shots import (
    BOARD,
    SIZE_PX,
    board_poses,
    cam_from_rig,
    chained,
    inverse,
    lens_of,
    shots,
)
from trinoc.calib.problem.board_shape import with_free_places
from trinoc.calib.problem.places import BoardView, predict_places
from trinoc.calib.problem.problem import Freedom
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.problem.views import View, pad_count
from trinoc.calib.shot_messages import undetermined_sentence
from trinoc.calib.starts.camera_start import plane_pose
from trinoc.calib.starts.sightings import motion_in_plane
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt

CAMERAS = ("left", "middle", "right")


def problem(poses, systematics=None):
    """At the truth, with noise in what was seen."""
    seen = shots(count=len(poses))
    views = [
        View(c, s, each, np.ones(len(each), dtype=bool))
        for c, own in enumerate(seen.values())
        for s, each in enumerate(own)
    ]
    lenses = [lens_of(name) for name in CAMERAS]
    return start_problem(
        views,
        BOARD,
        lenses,
        np.stack([cam_from_rig(name) for name in CAMERAS]),
        poses,
        [SIZE_PX] * 3,
        Freedom(np.arange(3), np.ones((3, 9), dtype=bool)),
        Systematics.typical({}) if systematics is None else systematics,
    )


@pytest.mark.parametrize("focal_px", [800.0, 120.0])
def test_a_plane_pose_is_found_from_its_rays(focal_px):
    pose = board_poses(1)[0].copy()
    if focal_px < 200.0:  # so near that a fisheye sees a part of it from behind
        turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
        pose = np.column_stack([turn @ pose[:, :3], [70.0, 0.0, 10.0]])
    lens = KannalaBrandt(np.full(2, focal_px), np.array([320.0, 240.0]), np.zeros(()), np.zeros(4))
    seen = BOARD.centres_mm @ pose[:, :2].T + pose[:, 3]
    assert (seen[:, 2] < 0).any() == (focal_px < 200.0)
    rays = jax.jit(jax.vmap(lambda ray: lens.unproject(lens.project_ray(ray))))(seen)
    found = plane_pose(np.asarray(rays), BOARD.centres_mm)
    assert found is not None
    np.testing.assert_allclose(found.cam_from_world, pose, atol=1e-6)


def test_points_on_a_line_have_no_pose():
    places = np.stack([np.arange(6.0), np.zeros(6)], axis=1)
    assert plane_pose(np.pad(places, ((0, 0), (0, 1)), constant_values=9.0), places) is None


@pytest.mark.parametrize("places_are_free", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_equations_are_those_of_the_cost(places_are_free):
    here = problem(board_poses(3))
    assert_equations_are_those_of_the_cost(with_free_places(here) if places_are_free else here)


def test_a_circle_is_predicted_as_the_exact_model_has_it():
    sheet, lens, pose = Pattern.default(), lens_of("left"), board_poses(1)[0]
    chart = problem(board_poses(1)).chart
    chart = type(chart)(**{**vars(chart), "has_circles": True})
    places, radius = sheet.centres_mm[:5], sheet.radius_mm[:5]
    view = BoardView(lens, np.eye(3, 4), pose, None, np.zeros(4))
    found = jax.jit(predict_places)(
        view, chart, 0, np.pad(places, ((0, 0), (0, 1))), np.zeros((5, 3)), radius
    )
    camera = Camera(Intrinsics.of_lens(lens, SIZE_PX), Pose(pose))
    exact = jax.jit(jax.vmap(image_of_circle_centre, (None, 0, 0)))(camera, places, radius)
    np.testing.assert_allclose(found, exact, atol=2e-4)


def test_poses_are_chained_and_undone_as_matrices_are():
    first, second = board_poses(2)
    both = Pose(second) @ Pose(first)
    assert isinstance(both.cam_from_world, np.ndarray)
    np.testing.assert_allclose(both.cam_from_world, chained(second, first), atol=1e-9)
    np.testing.assert_allclose(Pose(first).inverse.cam_from_world, inverse(first), atol=1e-9)


@pytest.mark.parametrize("board", [Chessboard(rows=5, columns=7, square_mm=1.0),
                                   Chessboard(rows=4, columns=4, square_mm=1.0)])  # fmt: skip
def test_turns_of_a_board_are_motions_in_its_plane(board):
    assert len(board.turns) == (2 if board.rows == 5 else 4)
    for turn in board.turns:
        there = board.centres_mm[turn]
        motion = motion_in_plane(board.centres_mm, there)
        back = motion.transform_points(np.pad(there, ((0, 0), (0, 1))))
        np.testing.assert_allclose(back[:, :2], board.centres_mm, atol=1e-12)
        np.testing.assert_array_equal(back[:, 2], 0.0)


def test_lengths_of_arrays_are_few():
    padded = {pad_count(count, 8) for count in range(1, 200)}
    assert padded == {8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256}
    assert all(pad_count(count, 8) >= count for count in range(1, 200))


def test_a_board_that_is_parallel_in_all_shots_is_told():
    flat = np.stack([board_poses(1)[0]] * 3)
    flat[:, :, 3] += np.arange(3)[:, None] * 20.0
    assert "parallel in all shots" in undetermined_sentence(problem(flat), ("left.fx_px",))
