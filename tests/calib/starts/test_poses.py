"""Poses of boards: from rays, in chains, and of boards with rotational symmetry."""

import jax
import numpy as np
import pytest

from tests.calib.made_shots import BOARD, board_poses, chained, inverse
from trinoc.calib.starts.camera_start import plane_pose
from trinoc.calib.starts.sightings import motion_in_plane
from trinoc.calib.targets.checkers import Chessboard
from trinoc.geometry import Pose
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt


@pytest.mark.parametrize("focal_px", [800.0, 120.0])
def test_a_plane_pose_is_found_from_its_rays(focal_px):
    pose = board_poses(1)[0].copy()
    if focal_px < 200.0:  # so near that a fisheye sees a part of it from behind
        turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
        pose = np.column_stack([turn @ pose[:, :3], [70.0, 0.0, 10.0]])
    lens = KannalaBrandt(np.full(2, focal_px), np.array([320.0, 240.0]), np.zeros(()), np.zeros(4))
    in_camera_mm = BOARD.centres_mm @ pose[:, :2].T + pose[:, 3]
    assert (in_camera_mm[:, 2] < 0).any() == (focal_px < 200.0)
    rays = jax.jit(jax.vmap(lambda ray: lens.unproject(lens.project_ray(ray))))(in_camera_mm)
    solution = plane_pose(np.asarray(rays), BOARD.centres_mm)
    assert solution is not None
    np.testing.assert_allclose(solution.cam_from_world, pose, atol=1e-6)


def test_points_on_a_line_have_no_pose():
    points_mm = np.stack([np.arange(6.0), np.zeros(6)], axis=1)
    assert plane_pose(np.pad(points_mm, ((0, 0), (0, 1)), constant_values=9.0), points_mm) is None


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
