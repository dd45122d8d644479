"""Laws of the image model of squares: agreement with the renderer, and the spread of ink."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from simulation.camera_picture.layers import Paint
from simulation.camera_picture.render import render_sheet
from simulation.camera_picture.shapes import Cells, ConvexPolygon
from tests.calib.photometric.pictures import (
    BLUR_PX,
    INK,
    PAPER,
    RIGHT,
    SIGMA_PX,
    drawing_of,
    pixels_of,
    pose_of,
    rows_of,
    state_at,
    with_appearance,
)
from tests.calib.simulated import LENS, camera_of
from trinoc.calib.photometric.scene import first_guess
from trinoc.calib.photometric.unknowns import IDEAL
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import square_sheet
from trinoc.errors import InputError

BOARDS = {
    "chessboard": Chessboard(rows=4, columns=5, square_mm=20.0),
    "charuco": Charuco(rows=4, columns=5, square_mm=24.0, marker_mm=17.0),
    "april_grid": AprilGrid(rows=2, columns=2, tag_mm=40.0),
}


@dataclass
class Bare:
    """Target without a print."""

    centres_mm: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    radius_mm: np.ndarray = field(default_factory=lambda: np.zeros(0))
    inner_radius_mm: np.ndarray = field(default_factory=lambda: np.zeros(0))
    line_width_mm: float = 0.0
    line_half_length_mm: tuple[float, float] = (0.0, 0.0)
    line_style: str = "stop"
    line_gap_mm: float = 0.0


# Those of a ChArUco board are squares, too.
@pytest.fixture(
    scope="module",
    params=[pytest.param("chessboard", marks=pytest.mark.slow), "charuco", "april_grid"],
)
def board(request):
    return BOARDS[request.param]


@pytest.fixture(scope="module")
def picture(board):
    sheet = square_sheet(board)
    return render_sheet(
        Bare(),
        camera_of(RIGHT[:4], LENS, (0.0, 0.0)),
        covers=(Paint(Cells(sheet.x_mm, sheet.y_mm, sheet.ink), INK),),
        paper=PAPER,
        blur_px=BLUR_PX,
        supersampling=6,
        bits=None,
    )


@pytest.fixture(scope="module")
def model(picture, board):
    """Function of the ink spread in mm: residual and derivatives of every pixel near an edge."""
    sheet = square_sheet(board)
    assert not pixels_of(picture, sheet, near_line=True)[1]
    group, count = pixels_of(picture, sheet)

    def residuals_and_rows(spread_mm):
        state = with_appearance(state_at(RIGHT), spread_mm=spread_mm)
        rows = rows_of(state, group, drawing=drawing_of(sheet))
        return (np.asarray(rows.level) - group.pixels.grey)[:count], np.asarray(rows.rows)[
            :, :count
        ]

    return residuals_and_rows


def test_the_model_is_the_picture(model):
    residual, _ = model(0.0)
    assert len(residual) > 10_000
    assert np.sqrt(np.mean(residual**2)) < 0.25
    assert abs(np.mean(residual)) < 0.02


def test_ink_spreads_as_its_derivative_says(model):
    step = 0.01
    (above, _), (below, _) = model(step), model(-step)
    slope, spread = (above - below) / (2 * step), 9 + IDEAL.indices("spread_mm")[0]
    np.testing.assert_allclose(model(0.0)[1][spread], slope, atol=0.02 * np.ptp(slope))
    # Ink that spreads makes the board darker.
    assert above.mean() < below.mean()


def test_light_and_ink_are_read_where_they_are_deep(picture, board):
    guess = first_guess(picture, pose_of(RIGHT), LENS.lens, square_sheet(board))
    np.testing.assert_allclose(guess.light[0], PAPER, atol=6.0)
    np.testing.assert_allclose(guess["ratio"], INK / PAPER - 1, atol=0.02)
    np.testing.assert_allclose(guess["sigma_px"], SIGMA_PX, atol=0.25)


def test_the_grid_is_what_is_printed(board):
    sheet = square_sheet(board)
    random = np.random.default_rng(0)
    extent = np.array([[sheet.x_mm[0], sheet.y_mm[0]], [sheet.x_mm[-1], sheet.y_mm[-1]]])
    points_mm = random.uniform(1.1 * extent[0], 1.1 * extent[1], (2000, 2))
    level = np.min(
        [ConvexPolygon(each.corners_mm).level_mm(points_mm) for each in board.drawing()], axis=0
    )
    ink = sheet.ink[
        np.searchsorted(sheet.y_mm, points_mm[:, 1]), np.searchsorted(sheet.x_mm, points_mm[:, 0])
    ]
    np.testing.assert_array_equal(ink, level < 0)
    assert not sheet.ink[[0, -1]].any()
    assert not sheet.ink[:, [0, -1]].any()


def test_a_sheet_of_circles_is_no_board_of_squares():
    with pytest.raises(InputError, match="no board of squares"):
        square_sheet(Pattern.default())
