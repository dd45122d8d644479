"""A board with its mirror image on the back connects cameras that face each other."""

from dataclasses import replace

import numpy as np

from simulation.camera_picture.layers import Paint
from simulation.camera_picture.render import render_sheet
from simulation.camera_picture.shapes import Cells
from tests.calib.photometric.test_squares import Bare
from tests.calib.simulated_lens import lens_values
from trinoc.calib.lens_calibration import calibrate_intrinsics
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.targets.board_set import BoardSet
from trinoc.calib.targets.checkers import Charuco
from trinoc.calib.targets.squares import square_sheet
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rotation import rotation_from_vector

LENS = Intrinsics(focal_length_mm=12.0, pixel_pitch_mm=(0.015, 0.015), image_size_px=(640, 480))
FRONT = Charuco(rows=5, columns=6, square_mm=30.0, dictionary="4x4_50", inverted=True)
BACK = Charuco(rows=5, columns=6, square_mm=30.0, dictionary="4x4_50", inverted=True, mirrored=True)
ABOUT_Y = np.diag([-1.0, 1.0, -1.0])
THICKNESS_MM = 6.0
# The far camera looks back at the near one, from 1.2 m.
FAR_FROM_NEAR = Pose(np.column_stack([ABOUT_Y, [25.0, -10.0, 1200.0]]))
# (tilt in degrees, the direction of its axis in the picture in degrees) of the front.
TILTS_DEG = ((25.0, 0.0), (30.0, 90.0), (28.0, 200.0), (33.0, 310.0), (20.0, 45.0))


def photograph(board: Charuco, pose: Pose) -> np.ndarray:
    sheet = square_sheet(board)
    paint = Paint(Cells(sheet.x_mm, sheet.y_mm, sheet.ink), 25.0)
    camera = Camera(LENS, pose)
    picture = render_sheet(Bare(), camera, covers=(paint,), supersampling=2)
    noise = np.random.default_rng(0).normal(0.0, 1.0, picture.shape)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)


def front_poses() -> list[Pose]:
    poses = []
    for tilt_deg, axis_deg in TILTS_DEG:
        axis = np.radians(axis_deg)
        turn = np.radians(tilt_deg) * np.array([np.cos(axis), np.sin(axis), 0.0])
        rotation = np.asarray(rotation_from_vector(turn)) @ np.diag([1.0, -1.0, -1.0])
        poses.append(Pose(np.column_stack([rotation, [10.0, 5.0, 600.0]])))
    return poses


def test_the_back_of_a_board_is_found_with_the_rig() -> None:
    front_from_back = Pose(np.column_stack([ABOUT_Y, [0.8, -0.5, -THICKNESS_MM]]))
    images: dict[str, list[np.ndarray]] = {"near": [], "far": []}
    for front in front_poses():
        images["near"].append(photograph(FRONT, front))
        images["far"].append(photograph(BACK, FAR_FROM_NEAR @ front @ front_from_back))
    board = BoardSet({"front": FRONT, "back": BACK})
    result = calibrate_rig(images, board, lens=LENS)
    assert not result.failures
    back = result.reference_from_board[1]
    np.testing.assert_allclose(back[:, :3], ABOUT_Y, atol=2e-3)
    np.testing.assert_allclose(back[:, 3], front_from_back.translation_mm, atol=0.4)
    pair = result.pairs[0]
    assert (pair.first, pair.second) == ("near", "far")
    np.testing.assert_allclose(pair.second_from_first[:, :3], ABOUT_Y, atol=2e-3)
    translation_mm = FAR_FROM_NEAR.translation_mm
    np.testing.assert_allclose(pair.second_from_first[:, 3], translation_mm, rtol=3e-3, atol=1.0)


def test_a_lens_is_that_of_the_board_that_was_printed_whatever_was_stated() -> None:
    images = [photograph(FRONT, pose) for pose in front_poses()]
    stated = replace(FRONT, rows=FRONT.columns, columns=FRONT.rows, inverted=False, name="mine")
    results = [calibrate_intrinsics(images, board, distortion=0) for board in (stated, FRONT)]
    np.testing.assert_allclose(lens_values(results[0]), lens_values(results[1]), rtol=1e-9)
    assert any("rows and columns exchanged (rows=5 columns=6)" in n for n in results[0].notes)
    assert not any("this layout was used" in note for note in results[1].notes)
    assert abs(results[0].value("fx_px") - LENS.focal_length_px[0]) < 4.0
