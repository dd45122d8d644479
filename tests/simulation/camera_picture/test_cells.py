"""Laws of a figure of cells: lines that part nothing change nothing, and two colours add up."""

import numpy as np

from simulation.camera_picture.layers import Paint
from simulation.camera_picture.render import render_sheet
from simulation.camera_picture.shapes import Cells, ConvexPolygon
from tests.calib.photometric.test_squares import Bare
from trinoc.synth import table1_rig

LINES = np.array([-30.0, -10.0, 10.0, 30.0])
CHECKERS = np.pad(np.array([[1, 0, 1], [0, 1, 0], [1, 0, 1]], dtype=bool), 1)
# The same cells with lines through them.
AGAIN = [0, 1, 1, 1, 2, 3, 3, 4]
MORE = np.array([-30.0, -28.0, -12.0, -10.0, 10.0, 12.0, 30.0])


def picture(*shapes) -> np.ndarray:
    return render_sheet(
        Bare(),
        table1_rig()["left"],
        covers=tuple(Paint(shape, 25.0) for shape in shapes),
        paper=230.0,
        supersampling=6,
        bits=None,
    )


def test_lines_that_part_nothing_change_nothing():
    plain = Cells(LINES, LINES, CHECKERS)
    finer = Cells(MORE, MORE, CHECKERS[np.ix_(AGAIN, AGAIN)])
    np.testing.assert_allclose(picture(finer), picture(plain), atol=0.7)
    points_mm = np.random.default_rng(0).uniform(-35, 35, (500, 2))
    np.testing.assert_array_equal(finer.level_mm(points_mm) < 0, plain.level_mm(points_mm) < 0)


def test_checkers_are_their_squares():
    middles = 20.0 * np.array([[-1, -1], [1, -1], [0, 0], [-1, 1], [1, 1]])
    squares = [ConvexPolygon.rectangle(middle, (20.0, 20.0)) for middle in middles]
    np.testing.assert_allclose(picture(Cells(LINES, LINES, CHECKERS)), picture(*squares), atol=1.5)


def test_the_level_has_no_jump():
    figure = Cells(MORE, MORE, CHECKERS[np.ix_(AGAIN, AGAIN)])
    points_mm = np.random.default_rng(1).uniform(-35, 35, (2000, 2))
    step = np.random.default_rng(2).normal(size=(2000, 2))
    step *= 1e-3 / np.linalg.norm(step, axis=1, keepdims=True)
    change = figure.level_mm(points_mm + step) - figure.level_mm(points_mm)
    assert np.abs(change).max() < 1.001e-3
