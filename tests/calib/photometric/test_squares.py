"""Laws of a picture of squares: the model is the renderer's, and ink's spread is what it says."""

from dataclasses import dataclass, field

import jax
import numpy as np
import pytest

from tests.calib.simulated import LENS, TABLE_1, camera_of
from trinoc.calib import AprilGrid, Charuco, Chessboard, Pattern
from trinoc.calib.photometric.appearance import Appearance, predict
from trinoc.calib.photometric.gauss_newton import sheet_from_camera
from trinoc.calib.photometric.initial import initial_appearance
from trinoc.calib.photometric.ink_coverage import SQUARES, Cross, Drawing
from trinoc.calib.photometric.pixel_selection import group_of, select_pixels
from trinoc.calib.result.degrees import pose_of_values
from trinoc.calib.targets import square_sheet
from trinoc.errors import InputError
from trinoc.synth import Cells, render_sheet
from trinoc.synth.layers import Paint
from trinoc.synth.shapes import ConvexPolygon

BOARDS = {
    "chessboard": Chessboard(rows=4, columns=5, square_mm=20.0),
    "charuco": Charuco(rows=4, columns=5, square_mm=24.0, marker_mm=17.0),
    "april_grid": AprilGrid(rows=2, columns=2, tag_mm=40.0),
}
RIGHT = (*TABLE_1["right"], 0.0, 0.0)
NO_CROSS = Cross(np.array(0.0), np.zeros(2), np.array(0.0))
BLUR_PX, PAPER, INK = 0.7, 230.0, 25.0


@dataclass
class Bare:
    """A sheet without a print."""

    centres_mm: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    radius_mm: np.ndarray = field(default_factory=lambda: np.zeros(0))
    inner_radius_mm: np.ndarray = field(default_factory=lambda: np.zeros(0))
    line_width_mm: float = 0.0
    line_half_length_mm: tuple[float, float] = (0.0, 0.0)
    line_style: str = "stop"
    line_gap_mm: float = 0.0


@pytest.fixture(scope="module", params=BOARDS)
def board(request):
    return BOARDS[request.param]


@pytest.fixture(scope="module")
def picture(board):
    sheet = square_sheet(board)
    return render_sheet(
        Bare(),
        camera_of(RIGHT[:4], LENS, (0.0, 0.0)),
        above=(Paint(Cells(sheet.x_mm, sheet.y_mm, sheet.ink), INK),),
        paper=PAPER,
        blur_px=BLUR_PX,
        supersampling=6,
        dtype="float64",
    )


LOOK = Appearance(
    np.array(np.hypot(BLUR_PX, np.sqrt(1 / 12))),
    np.array(0.0),
    np.array(INK / PAPER - 1),
    np.array([PAPER, 0.0, 0.0, 0.0, 0.0, 0.0]),
)


@jax.jit
def predicted(homography, spread, pixels):
    own, drawing = LOOK._replace(spread_mm=spread), Drawing(SQUARES, False)
    return jax.vmap(lambda p: predict(homography, own, p, NO_CROSS, drawing, False))(pixels)


@pytest.fixture(scope="module")
def model(picture, board):
    """Residual and derivatives of every pixel near an edge, for an ink spread in mm."""
    sheet, pose = square_sheet(board), pose_of_values(np.array(RIGHT))
    choice = select_pixels(pose, LENS.lens, sheet, LENS.image_size_px, float(LOOK.sigma_px))
    assert not len(choice.near_lines.row)
    chosen = choice.near_circles
    pixels = group_of(chosen, picture, LENS.lens, sheet, 65536, np.float64).pixels
    homography = np.asarray(sheet_from_camera(pose))
    return lambda spread: jax.tree.map(
        lambda leaf: np.asarray(leaf)[: len(chosen.row)],
        predicted(homography, np.asarray(spread), pixels),
    )


def test_the_model_is_the_picture(model):
    residual = model(0.0).residual
    assert len(residual) > 10_000
    assert np.sqrt(np.mean(residual**2)) < 0.25
    assert abs(np.mean(residual)) < 0.02


def test_ink_spreads_as_its_derivative_says(model):
    step = 0.01
    above, below = model(step), model(-step)
    slope = (above.residual - below.residual) / (2 * step)
    np.testing.assert_allclose(model(0.0).by_appearance[1], slope, atol=0.02 * np.ptp(slope))
    # Ink that spreads makes the board darker.
    assert above.residual.mean() < below.residual.mean()


def test_light_and_ink_are_read_where_they_are_deep(picture, board):
    guess = initial_appearance(
        picture, pose_of_values(np.array(RIGHT)), LENS.lens, square_sheet(board)
    )
    np.testing.assert_allclose(guess.light[0], PAPER, atol=6.0)
    np.testing.assert_allclose(guess.ratio, INK / PAPER - 1, atol=0.02)
    np.testing.assert_allclose(guess.sigma_px, np.hypot(BLUR_PX, np.sqrt(1 / 12)), atol=0.25)


def test_the_grid_is_what_is_printed(board):
    sheet = square_sheet(board)
    random = np.random.default_rng(0)
    extent = np.array([[sheet.x_mm[0], sheet.y_mm[0]], [sheet.x_mm[-1], sheet.y_mm[-1]]])
    places = random.uniform(1.1 * extent[0], 1.1 * extent[1], (2000, 2))
    level = np.min(
        [ConvexPolygon(each.corners_mm).level_mm(places) for each in board.drawing()], axis=0
    )
    ink = sheet.ink[
        np.searchsorted(sheet.y_mm, places[:, 1]), np.searchsorted(sheet.x_mm, places[:, 0])
    ]
    np.testing.assert_array_equal(ink, level < 0)
    assert not sheet.ink[[0, -1]].any()
    assert not sheet.ink[:, [0, -1]].any()


def test_a_sheet_of_circles_is_no_board_of_squares():
    with pytest.raises(InputError, match="no board of squares"):
        square_sheet(Pattern.default())
