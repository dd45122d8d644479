"""Selection of pixels on a board of squares, and the true sigmas of a pose from one image."""

from dataclasses import replace

import numpy as np
import pytest

from simulation.camera_picture.layers import Paint
from simulation.camera_picture.render import render_sheet
from simulation.camera_picture.shapes import Cells
from tests.calib.photometric.pictures import INK, PAPER
from tests.calib.photometric.test_squares import Bare
from trinoc.calib.photometric.image_fit import refine_image
from trinoc.calib.photometric.sheet_geometry import lens_rays, sheet_points_and_slopes
from trinoc.calib.photometric.square_pixels import square_pixels
from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.targets.squares import square_sheet
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rotation import rotation_from_vector
from trinoc.numerics.precision import in_float64

SIZE_PX = (320, 240)
FISHEYE = KannalaBrandt.from_parameters(
    np.array([130.0, 131.0, 160.0, 121.0, -0.02, 0.006, -0.002, 0.0003])
)
PERSPECTIVE = BrownConrady.from_parameters(
    np.array([400.0, 402.0, 161.0, 118.0, -0.2, 0.06, 0.001, -0.0005, 0.0])
)
CHARUCO = Charuco(rows=4, columns=5, square_mm=24.0, marker_mm=18.0)
CHESSBOARD = Chessboard(rows=5, columns=6, square_mm=20.0)


def pose(turn_y_deg: float, place_mm: tuple[float, float, float]) -> np.ndarray:
    turns = [(0.0, np.radians(turn_y_deg), 0.0), (0.35, 0.0, 0.2)]
    first, second = (np.asarray(rotation_from_vector(np.array(turn))) for turn in turns)
    return np.column_stack([first @ second @ np.diag([1.0, -1.0, -1.0]), place_mm])


AHEAD = pose(0.0, (3.0, 8.0, 330.0))
AFAR = pose(0.0, (9.0, 24.0, 990.0))
# Seen 52 degrees off the axis and more, to the picture's side at 75.
ASIDE = pose(70.0, (150.0, -10.0, 30.0))


def picture_of(board, lens, where) -> np.ndarray:
    sheet = square_sheet(board)
    return render_sheet(
        Bare(),
        Camera(Intrinsics.of_lens(lens, SIZE_PX), Pose(where)),
        covers=(Paint(Cells(sheet.x_mm, sheet.y_mm, sheet.ink), INK),),
        paper=PAPER,
        blur_px=0.7,
        supersampling=4,
        bits=None,
    )


def test_derivatives_of_rays_are_those_of_the_lens():
    uv = np.array([[20.0, 30.0], [300.0, 100.0], [160.0, 121.0]])
    step = 0.01

    def at(u, v):
        return np.asarray(lens_rays(FISHEYE, uv + np.array([u, v])).direction)

    ray, middle = lens_rays(FISHEYE, uv), at(0, 0)
    by_u, by_v = ((at(*s) - at(*-s)) / (2 * step) for s in step * np.eye(2))
    uu, vv = ((at(*s) + at(*-s) - 2 * middle) / step**2 for s in step * np.eye(2))
    np.testing.assert_allclose(ray.by_pixel, np.stack([by_u, by_v], axis=2), atol=1e-8)
    assert ray.second_by_pixel is not None
    np.testing.assert_allclose(
        np.asarray(ray.second_by_pixel)[..., [0, 2]], np.stack([uu, vv], 2), atol=1e-8
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("board", "lens", "where"),
    [
        (CHESSBOARD, PERSPECTIVE, AHEAD),
        (CHESSBOARD, FISHEYE, ASIDE),
        (CHARUCO, PERSPECTIVE, AHEAD),
        (replace(CHARUCO, inverted=True, mirrored=True), PERSPECTIVE, AHEAD),
    ],
)
def test_one_picture_tells_its_pose_as_it_claims(board, lens, where):
    """The normalised squared errors of four draws of noise are chi-square of 24."""
    with_noise = np.random.default_rng(0)
    clean, total = picture_of(board, lens, where), 0.0
    for _ in range(4):
        noisy = np.rint(clean + with_noise.normal(0, 2, clean.shape)).astype(np.float32)
        total += _squared(noisy, board, lens, where)
    assert 8 < total < 51


@in_float64
def _squared(picture, board, lens, where) -> float:
    true = Pose(where)
    fit = refine_image(picture, square_sheet(board), lens, true, PoseModel.RIGID)
    assert fit is not None
    assert fit.converged
    assert not fit.effects
    unit = np.linalg.norm(where[:, 3])
    turn = np.asarray(fit.state.pose.rotation) @ where[:, :3].T
    vector = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    centre = np.asarray(fit.state.pose.centre_world_mm) - np.asarray(true.centre_world_mm)
    error = np.concatenate([vector, centre / unit])
    return float(error @ fit.information @ error)


def test_every_edge_in_reach_is_looked_at_once_and_fine_cells_are_not():
    sheet, reach = square_sheet(CHARUCO), 2.7
    near_pixels = square_pixels(Pose(AHEAD), PERSPECTIVE, sheet, SIZE_PX, reach)
    far_pixels = square_pixels(Pose(AFAR), PERSPECTIVE, sheet, SIZE_PX, reach)
    for selected, pose_of in ((near_pixels, AHEAD), (far_pixels, AFAR)):
        assert len(np.unique(np.stack([selected.column, selected.row]), axis=1).T) == len(
            selected.row
        )
        ink = selected.squares.ink.reshape(-1, 3, 3)
        assert (ink.min(axis=(1, 2)) < ink.max(axis=(1, 2))).all()
        # The cell in the middle of the window, or beside it, is the one under the pixel.
        point, _ = sheet_points_and_slopes(
            selected.column, selected.row, Pose(pose_of), PERSPECTIVE
        )
        row = (point[1][:, None] > selected.squares.y_mm).sum(axis=1)
        column = (point[0][:, None] > selected.squares.x_mm).sum(axis=1)
        is_ink_below = sheet.ink[
            np.searchsorted(sheet.y_mm, point[1]), np.searchsorted(sheet.x_mm, point[0])
        ]
        np.testing.assert_array_equal(ink[np.arange(len(row)), row, column] > 0, is_ink_below)
    # Three times as far away, a ninth of the area: of the markers little is left.
    assert len(far_pixels.row) < len(near_pixels.row) / 9
