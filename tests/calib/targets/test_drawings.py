"""Printed boards have their points where the board states them, and equal OpenCV's prints."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from trinoc.calib.targets.abstract_target import Disc
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.board_set import BOARDS
from trinoc.calib.targets.checkers import Charuco, Chessboard, opencv_board
from trinoc.calib.targets.markers import marker_cells, opencv_dictionary
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import AbstractSquareBoard, square_sheet

SQUARES = {
    "chessboard": Chessboard(rows=4, columns=5, square_mm=20.0),
    "charuco": Charuco(rows=5, columns=4, square_mm=24.0, marker_mm=17.0, first=3),
    "legacy": Charuco(rows=4, columns=5, square_mm=24.0, legacy=True),
    "inverted": Charuco(rows=4, columns=5, square_mm=24.0, inverted=True, mirrored=True),
    "april_grid": AprilGrid(rows=2, columns=3, tag_mm=40.0, spacing=0.25, first=7),
}


def is_ink(board, points_mm):
    """Mask of the points (n, 2) that are ink, by the figure painted last over each point."""
    inked = np.zeros(len(points_mm), dtype=bool)
    for figure in board.drawing():
        if isinstance(figure, Disc):
            inside = np.hypot(*(points_mm - figure.centre_mm).T) < figure.radius_mm
        else:
            corners = figure.corners_mm
            along = np.roll(corners, -1, axis=0) - corners
            out = np.stack([along[:, 1], -along[:, 0]], axis=1)
            side = np.einsum("ki,nki->nk", out, points_mm[:, None] - corners)
            inside = (side < 0).all(axis=1) | (side > 0).all(axis=1)
        inked[inside] = figure.is_ink
    return inked


@pytest.mark.parametrize("name", SQUARES)
def test_every_place_is_a_corner_between_two_inked_fields_and_two_of_paper(name):
    board = SQUARES[name]
    step = 1.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    fields = is_ink(board, (board.centres_mm[:, None] + step).reshape(-1, 2)).reshape(-1, 4)
    np.testing.assert_array_equal(fields[:, 0], fields[:, 2])
    np.testing.assert_array_equal(fields[:, 1], fields[:, 3])
    assert (fields[:, 0] != fields[:, 1]).all()
    # Every place is one of the nodes to which edges belong.
    node_distances = np.linalg.norm(board.centres_mm[:, None] - board.nodes_mm, axis=2)
    assert node_distances.min(axis=1).max() < 1e-9


@pytest.mark.parametrize("style", ["stop", "through", "white"])
def test_every_circle_is_where_the_sheet_says(style):
    sheet = Pattern.cross_grid(rows=5, columns=4, pitch_mm=20, radius_mm=6, line_style=style)
    angle = np.deg2rad(45.0 + 90.0 * np.arange(4))
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for radii, inked in ((1.05, False), (0.95, True), (0.45, None)):
        points_mm = sheet.centres_mm[:, None] + radii * sheet.radius_mm[:, None, None] * around
        shown = is_ink(sheet, points_mm.reshape(-1, 2)).reshape(-1, 4)
        expected = ~sheet.is_ring[:, None] if inked is None else inked
        np.testing.assert_array_equal(shown, np.broadcast_to(expected, shown.shape))


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("rows", "columns"), [(4, 5), (5, 4), (5, 5), (6, 4)])
def test_a_charuco_board_is_opencv_s(rows, columns, legacy):
    board = Charuco(rows=rows, columns=columns, square_mm=8.0, marker_mm=6.0, legacy=legacy)
    theirs = opencv_board(board)
    middles = np.array([np.asarray(each)[:, :2].mean(axis=0) for each in theirs.getObjPoints()])
    half_mm = 4.0 * np.array([columns, rows])
    np.testing.assert_allclose(board.markers_mm, (middles - half_mm) * [1, -1], atol=1e-5)
    picture = theirs.generateImage((columns * 48, rows * 48), marginSize=0)
    row, column = np.indices(picture.shape)[:, 2::5, 2::5].reshape(2, -1)
    points_mm = (np.stack([column, row], axis=1) + 0.5) / 6.0 - half_mm
    np.testing.assert_array_equal(is_ink(board, points_mm * [1, -1]), picture[row, column] < 128)


def on_board(board, step_mm=1.1):
    """Grid of positions that covers a board of squares."""
    half = 0.5 * board.square_mm * np.array([board.columns, board.rows])
    axes = [np.arange(-side + 0.3, side, step_mm) for side in half]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("name", ["charuco", "legacy"])
def test_an_inverted_board_is_white_for_black_and_a_mirrored_one_the_image_of_a_mirror(name):
    board = SQUARES[name]
    positions, flip = on_board(board), np.array([-1.0, 1.0])
    ink = is_ink(board, positions)
    assert 0.2 < ink.mean() < 0.8
    inverted, mirrored = replace(board, inverted=True), replace(board, mirrored=True)
    np.testing.assert_array_equal(is_ink(inverted, positions), ~ink)
    np.testing.assert_array_equal(is_ink(mirrored, positions * flip), ink)
    both = replace(board, inverted=True, mirrored=True)
    np.testing.assert_array_equal(is_ink(both, positions * flip), ~ink)
    np.testing.assert_array_equal(inverted.centres_mm, board.centres_mm)
    np.testing.assert_array_equal(mirrored.centres_mm, board.centres_mm * flip)
    # The paper around stays white.
    beyond = 1.01 * np.abs(positions).max(axis=0)
    assert not is_ink(both, np.array([beyond, -beyond])).any()


@pytest.mark.parametrize("name", SQUARES)
def test_the_ink_of_the_fit_of_grey_levels_is_that_of_the_drawing(name):
    board = SQUARES[name]
    sheet = square_sheet(board)
    positions = np.random.default_rng(0).uniform(-100, 100, (4000, 2))
    column, row = (
        np.searchsorted(edges_mm, positions[:, k])
        for k, edges_mm in enumerate((sheet.x_mm, sheet.y_mm))
    )
    np.testing.assert_array_equal(sheet.ink[row, column], is_ink(board, positions))


def test_a_tag_is_the_dictionary_s_and_turns_as_a_whole():
    board = SQUARES["april_grid"]
    tag = cv2.aruco.generateImageMarker(opencv_dictionary(board.dictionary), 9, 80, borderBits=2)
    row, column = np.indices(tag.shape)[:, 3::7, 3::7].reshape(2, -1)
    offset = 40.0 * np.stack([(column + 0.5) / 80 - 0.5, 0.5 - (row + 0.5) / 80], axis=1)
    # The third tag, of number 9.
    points_mm = board.tags_mm[2] + offset
    np.testing.assert_array_equal(is_ink(board, points_mm), tag[row, column] < 128)
    for quarters in range(4):
        cells = board.cell_grids(quarters=quarters)[2].is_ink
        plain = marker_cells(opencv_dictionary(board.dictionary), 9, border=2)
        np.testing.assert_array_equal(cells, np.rot90(plain, quarters))


def test_every_kind_of_board_says_what_others_need_of_it():
    examples = [*SQUARES.values(), Pattern.default()]
    assert {board.kind for board in examples} == set(BOARDS)
    for board in examples:
        assert board.marks.likeness_to(board.marks)
        assert set(board.added_keys) <= set(board.layout)
        if isinstance(board, AbstractSquareBoard):
            fields = {field: getattr(board, field) for field in board.layout.values()}
            assert type(board)(**fields, name=board.name) == board
