"""Boards are found and labelled in any orientation, and ambiguous ones are refused."""

import cv2
import numpy as np
import pytest

from trinoc.calib import detect_target
from trinoc.calib.targets.abstract_target import Polygon
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.board_set import BoardSet
from trinoc.calib.targets.checkers import Charuco, Chessboard, opencv_board
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import DetectionError, InputError

BOARDS = {
    "chessboard": Chessboard(rows=5, columns=8, square_mm=10.0),
    "symmetric": Chessboard(rows=5, columns=7, square_mm=10.0),
    "charuco": Charuco(rows=6, columns=8, square_mm=10.0, marker_mm=7.5, dictionary="4x4_50"),
    "aprilgrid": AprilGrid(rows=3, columns=4, tag_mm=18.0),
    "numbered": AprilGrid(rows=2, columns=3, tag_mm=24.0, spacing=0.2, border=1, first=7),
}
FINER = 6
SHIFT = 4  # bits behind the point of cv2.fillPoly


def polygons(board):
    return [figure.corners_mm for figure in board.drawing()]


def picture(board, turn_deg=20.0, size=(480, 640), figures=None, slant=0.001):
    """Slanted image of a board drawn from its figures, and the function from mm to pixels."""
    angle, scale = np.radians(turn_deg), 4.2
    turn = scale * np.array([[np.cos(angle), np.sin(angle)], [np.sin(angle), -np.cos(angle)]])

    def pixels(points_mm):
        point_mm = np.asarray(points_mm, dtype=float)
        share = 1 + slant * point_mm[..., :1]
        return point_mm @ turn.T / share + np.array([size[1], size[0]]) / 2 - 0.5

    large = np.full((FINER * size[0], FINER * size[1]), 225, np.uint8)
    drawing = board.drawing() if figures is None else [Polygon(each, True) for each in figures]
    for corners, is_ink in drawing:
        on_large = FINER * (pixels(corners) + 0.5) - 0.5
        outline = np.rint(on_large * 2**SHIFT).astype(np.int32)
        cv2.fillPoly(large, [outline], 30 if is_ink else 225, shift=SHIFT)
    image = cv2.resize(large, size[::-1], interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(image, (0, 0), 0.8), pixels


@pytest.mark.parametrize("name", BOARDS)
@pytest.mark.parametrize("turn_deg", [0.0, 75.0, 170.0, -100.0])
def test_a_board_is_found_where_it_was_drawn(name, turn_deg):
    board = BOARDS[name]
    image, pixels = picture(board, turn_deg)
    detection = detect_target(image, board)
    choices = [detection.circle_index]
    choices += [] if detection.ambiguity is None else list(detection.ambiguity)
    assert len(choices) == (2 if name == "symmetric" else 1)
    misses = [
        np.abs(detection.centres_px - pixels(board.centres_mm[index])).max() for index in choices
    ]
    assert min(misses) < 0.25
    assert len(detection) == len(board)
    sigma = np.sqrt(np.linalg.eigvalsh(detection.covariance_px2))
    assert (sigma > 0).all()
    assert (sigma < 0.2).all()


def test_outer_rows_of_a_slanted_chessboard_are_where_they_were_drawn():
    board = Chessboard(rows=6, columns=9, square_mm=5.0)
    image, pixels = picture(board, slant=0.006)
    detection = detect_target(image, board)
    miss = np.abs(detection.centres_px - pixels(board.centres_mm[detection.circle_index])).max()
    # Edges are drawn at a sixth of a pixel; OpenCV's search alone is .74 px off.
    assert miss < 0.15


@pytest.mark.parametrize("name", ["charuco", "aprilgrid"])
def test_a_covered_board_is_found_and_a_mirrored_one_refused(name):
    board = BOARDS[name]
    image, pixels = picture(board)
    covered = image.copy()
    covered[:, :280] = 128
    detection = detect_target(covered, board)
    assert 6 <= len(detection) < len(board)
    miss = np.abs(detection.centres_px - pixels(board.centres_mm[detection.circle_index])).max()
    assert miss < 0.25
    with pytest.raises(DetectionError, match="as in a mirror"):
        detect_target(image[:, ::-1].copy(), board)


def test_tags_that_touch_at_their_corners_are_told_apart():
    board = AprilGrid(rows=6, columns=6, tag_mm=9.0)
    image, pixels = picture(board)
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    image = image + np.random.default_rng(0).normal(0, 4.0, image.shape)
    detection = detect_target(np.clip(image, 0, 255).astype(np.uint8), board)
    assert len(detection) > 0.9 * len(board)
    miss = np.linalg.norm(
        detection.centres_px - pixels(board.centres_mm[detection.circle_index]), axis=1
    )
    assert np.quantile(miss, 0.95) < 0.3


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_tags_that_are_printed_turned_are_the_same_board(quarters):
    board = BOARDS["aprilgrid"]
    turn = np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), quarters)
    figures = []
    for corners in polygons(board):
        offset = corners.mean(axis=0) - board.tags_mm
        tag = int(np.abs(offset).max(axis=1).argmin())
        of_tag = np.abs(offset[tag]).max() < 0.5 * board.tag_mm
        middle = board.tags_mm[tag]
        figures.append((corners - middle) @ turn.T + middle if of_tag else corners)
    image, pixels = picture(board, figures=figures)
    detection = detect_target(image, board)
    assert len(detection) == len(board)
    assert (
        np.abs(detection.centres_px - pixels(board.centres_mm[detection.circle_index])).max() < 0.25
    )


def test_a_tag_of_another_board_in_view_is_left_out():
    board = BOARDS["aprilgrid"]
    image, pixels = picture(board, 0.0)
    tag_middles_px = [np.rint(pixels(middle)).astype(int) for middle in board.tags_mm[[0, 5]]]
    half = int(np.rint(0.5 * board.tag_mm * 4.2)) + 3
    (u, v), (to_u, to_v) = tag_middles_px
    image[to_v - half : to_v + half, to_u - half : to_u + half] = image[
        v - half : v + half, u - half : u + half
    ]
    detection = detect_target(image, board)
    assert not set(detection.circle_index) & {*range(4), *range(20, 24)}
    miss = np.abs(detection.centres_px - pixels(board.centres_mm[detection.circle_index])).max()
    assert miss < 0.25


@pytest.mark.parametrize("name", BOARDS)
def test_rows_of_two_moments_and_pixels_of_several_colours_are_refused_in_boards_and_sets(name):
    board = BOARDS[name]
    plain, _ = picture(board)
    fields, mosaic = plain.copy(), plain.copy()
    fields[1::2] = np.roll(plain, 2, axis=1)[1::2]
    mosaic[::2, ::2] //= 2
    for target in (board, BoardSet([board])):
        assert len(detect_target(plain, target)) > 0
        with pytest.raises(DetectionError, match="interlaced"):
            detect_target(fields, target)
        with pytest.raises(DetectionError, match="raw mosaic"):
            detect_target(mosaic, target)


def test_what_is_no_such_board_is_refused():
    image, _ = picture(BOARDS["chessboard"])
    with pytest.raises(DetectionError, match="No chessboard"):
        detect_target(image, Chessboard(rows=6, columns=9, square_mm=10.0))
    with pytest.raises(DetectionError, match="corners of the board"):
        detect_target(image, BOARDS["charuco"])
    with pytest.raises(DetectionError, match="tags of the board"):
        detect_target(image, BOARDS["aprilgrid"])
    with pytest.raises(DetectionError):
        detect_target(np.full((100, 100), 90, np.uint8), Pattern.default())


def test_boards_of_one_dictionary_are_told_apart_by_their_first_markers():
    board, other = (
        Charuco(rows=4, columns=6, square_mm=15.0, marker_mm=11.0, dictionary="4x4_50", first=first)
        for first in (0, 12)
    )
    image, _ = picture(other)
    assert len(detect_target(image, other)) == len(other)
    with pytest.raises(DetectionError, match="fits with first=12"):
        detect_target(image, board)


def test_boards_that_cannot_be_are_refused():
    for wrong in (
        {"rows": 2, "columns": 9, "square_mm": 10.0},
        {"rows": 5, "columns": 9, "square_mm": 0.0},
    ):
        with pytest.raises(InputError, match="board"):
            Chessboard(**wrong)
    for wrong, message in (
        ({"rows": 1, "columns": 1}, "two tags"),
        ({"spacing": 2.0}, "spacing of 2"),
        ({"border": 3}, "border of 3 cells"),
        ({"tag_mm": np.nan}, "a finite number"),
        ({"tag_mm": 0.0}, "give a positive side"),
        ({"dictionary": "9x9"}, "unknown"),
    ):
        with pytest.raises(InputError, match=message):
            AprilGrid(**{"rows": 3, "columns": 3, "tag_mm": 20.0, **wrong})
    with pytest.raises(InputError, match="smaller than the squares"):
        Charuco(rows=5, columns=5, square_mm=10.0, marker_mm=10.0)
    with pytest.raises(InputError, match="dictionary '9x9' is unknown"):
        Charuco(rows=5, columns=5, square_mm=10.0, marker_mm=7.0, dictionary="9x9")


def test_every_dictionary_is_one_of_opencv():
    from trinoc.calib.targets.markers import DICTIONARIES

    for name in DICTIONARIES:
        board = Charuco(rows=3, columns=3, square_mm=2.0, marker_mm=1.0, dictionary=name)
        assert len(opencv_board(board).getChessboardCorners()) == len(board)
