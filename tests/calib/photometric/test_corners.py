"""Laws of a chessboard's picture: the model is the renderer's, and ink's spread is what it says."""

from dataclasses import dataclass, field

import jax
import numpy as np
import pytest

from tests.calib.simulated import LENS, TABLE_1, camera_of
from trinoc.calib import Chessboard, dark_squares
from trinoc.calib.photometric.appearance import Appearance, predict
from trinoc.calib.photometric.gauss_newton import sheet_from_normalised
from trinoc.calib.photometric.initial import initial_appearance
from trinoc.calib.photometric.ink_coverage import Cross, Drawing
from trinoc.calib.photometric.pixel_selection import group_of, select_pixels
from trinoc.calib.pose import pose_of_values
from trinoc.calib.targets import corner_sheet
from trinoc.synth import render_sheet
from trinoc.synth.layers import Paint
from trinoc.synth.shapes import ConvexPolygon

BOARD = Chessboard(rows=4, columns=5, square_mm=20.0)
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


@pytest.fixture(scope="module")
def picture():
    dark = np.argwhere(dark_squares(BOARD.rows + 1, BOARD.columns + 1))
    middles = BOARD.square_mm * np.stack(
        [dark[:, 1] - 0.5 * BOARD.columns, 0.5 * BOARD.rows - dark[:, 0]], axis=1
    )
    side = BOARD.square_mm
    squares = [ConvexPolygon.rectangle(middle, (side, side)) for middle in middles]
    return render_sheet(
        Bare(),
        camera_of(RIGHT[:4], LENS, (0.0, 0.0)),
        above=tuple(Paint(square, INK) for square in squares),
        paper=PAPER,
        blur_px=BLUR_PX,
        supersampling=8,
        dtype="float64",
    )


@pytest.fixture(scope="module")
def model(picture):
    """Residual and derivatives of every pixel near an edge, for an ink spread in mm."""
    sheet, pose = corner_sheet(BOARD), pose_of_values(np.array(RIGHT))
    look = Appearance(
        np.array(np.hypot(BLUR_PX, np.sqrt(1 / 12))),
        np.array(0.0),
        np.array(INK / PAPER - 1),
        np.array([PAPER, 0.0, 0.0, 0.0, 0.0, 0.0]),
    )
    choice = select_pixels(pose, LENS.lens, sheet, LENS.image_size_px, float(look.sigma_px))
    assert not len(choice.near_lines.row)
    chosen = choice.near_circles
    pixels = group_of(chosen, picture, LENS.lens, sheet, 16384, np.float64).pixels
    homography, drawing = np.asarray(sheet_from_normalised(pose)), Drawing("corners", True)

    @jax.jit
    def predicted(spread):
        own = look._replace(spread_mm=spread)
        return jax.vmap(lambda p: predict(homography, own, p, NO_CROSS, drawing, False))(pixels)

    return lambda spread: jax.tree.map(
        lambda leaf: np.asarray(leaf)[: len(chosen.row)], predicted(np.asarray(spread))
    )


def test_the_model_is_the_picture(model):
    residual = model(0.0).residual
    assert len(residual) > 3000
    assert np.sqrt(np.mean(residual**2)) < 0.4
    assert abs(np.mean(residual)) < 0.05


def test_ink_spreads_as_its_derivative_says(model):
    step = 0.01
    above, below = model(step), model(-step)
    slope = (above.residual - below.residual) / (2 * step)
    np.testing.assert_allclose(model(0.0).by_appearance[1], slope, atol=0.02 * np.ptp(slope))
    # Ink that spreads makes the board darker.
    assert above.residual.mean() < below.residual.mean()


def test_light_and_ink_are_read_beside_the_corners(picture):
    guess = initial_appearance(
        picture, pose_of_values(np.array(RIGHT)), LENS.lens, corner_sheet(BOARD)
    )
    np.testing.assert_allclose(guess.light[0], PAPER, atol=1.0)
    np.testing.assert_allclose(guess.ratio, INK / PAPER - 1, atol=0.01)
    np.testing.assert_allclose(guess.sigma_px, np.hypot(BLUR_PX, np.sqrt(1 / 12)), atol=0.25)
