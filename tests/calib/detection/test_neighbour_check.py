"""The check finds exactly the corners that deviate from the prediction by their neighbours."""

import numpy as np
import pytest

from trinoc.calib.detection.neighbour_check import are_in_place, predict_from_neighbours
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.tuning.every_group import TUNING

BOARD = Chessboard(rows=6, columns=9, square_mm=25.0).centres_mm


def image_of(board_mm, *, tilt=0.0015, bend=-0.3, seed=0, noise_px=0.1):
    """Pixels of the board through a tilted homography and a lens with radial distortion."""
    random = np.random.default_rng(seed)
    turn = random.uniform(0, 2 * np.pi)
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = (board_mm @ np.array([[cos, sin], [-sin, cos]])).T
    about = random.uniform(0, 2 * np.pi)
    depth = 1 + tilt * (np.cos(about) * x + np.sin(about) * y)
    u, v = x / depth / 350, y / depth / 350
    radial = 1 + bend * (u * u + v * v)
    pixels = 320 + 600 * np.stack([u * radial, v * radial], axis=1)
    return pixels + random.normal(0, noise_px, pixels.shape)


def in_place(board_mm, corners_px):
    return are_in_place(board_mm, corners_px, TUNING.detection.out_of_place_share, TUNING)


@pytest.mark.parametrize("seed", range(12))
def test_right_corners_are_in_place_whatever_tilt_and_lens(seed):
    assert in_place(BOARD, image_of(BOARD, seed=seed)).all()


@pytest.mark.parametrize("wrong", [0, 8, 13, 30, 53])
@pytest.mark.parametrize("share", [0.12, 0.4, 3.0])
def test_a_corner_aside_is_named_alone(wrong, share):
    pixels = image_of(BOARD)
    spacing = np.linalg.norm(pixels[1] - pixels[0])
    direction = np.array([np.cos(wrong), np.sin(wrong)])
    pixels[wrong] += share * spacing * direction
    assert np.flatnonzero(~in_place(BOARD, pixels)).tolist() == [wrong]


def test_a_part_of_the_board_with_gaps_is_tested_too():
    random = np.random.default_rng(3)
    rows = np.sort(random.permutation(len(BOARD))[:20])
    pixels = image_of(BOARD)[rows]
    assert in_place(BOARD[rows], pixels).all()
    pixels[7] += 25.0
    assert np.flatnonzero(~in_place(BOARD[rows], pixels)).tolist() == [7]


def test_the_prediction_has_the_stated_noise():
    """Prediction minus observation has `gain` times the standard deviation of a corner."""
    ideal = image_of(BOARD, noise_px=0.0, tilt=0.0, bend=0.0)
    random, squares = np.random.default_rng(0), []
    for _ in range(300):
        noisy = ideal + random.normal(0, 0.5, ideal.shape)
        prediction = predict_from_neighbours(BOARD, noisy)
        squares.append(np.sum((prediction.px - noisy) ** 2, axis=1) / prediction.gain**2)
    sigma = np.sqrt(np.mean(squares, axis=0) / 2)
    assert np.all(np.abs(sigma / 0.5 - 1) < 0.15)
    assert abs(np.mean(sigma) / 0.5 - 1) < 0.02
