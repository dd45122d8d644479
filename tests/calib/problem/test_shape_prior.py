"""The prior of a board's shape: its parts, and the estimates of their variances."""

import numpy as np
import pytest

from trinoc.calib.problem.shape_prior import shape_prior
from trinoc.calib.targets.board_set import BoardSet
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.tuning.every_group import TUNING

BOARD = Chessboard(rows=6, columns=9, square_mm=25.0)


def part(prior, name):
    (match,) = (each for each in prior.parts if each.name == name)
    return match


def deviations_mm(prior, name):
    """(n, 3) standard deviations of X, Y and Z of each corner by one part of the prior."""
    (k,) = (k for k, each in enumerate(prior.parts) if each.name == name)
    modes = prior.parts[k].modes.reshape(len(BOARD), 3, -1)
    return np.sqrt(prior.variance[k] * np.sum(modes**2, axis=2))


def test_parts_have_the_stated_standard_deviations_before_any_image():
    """Single corners and each smooth amplitude: 0.05 mm. Twist: the flatness, at the corners of
    the board. Shear: half the angle times the distance from the middle."""
    prior = shape_prior(BOARD, 0.05)
    np.testing.assert_allclose(deviations_mm(prior, "corner plane"), [[0.05, 0.05, 0.0]] * 54)
    np.testing.assert_allclose(deviations_mm(prior, "corner height"), [[0.0, 0.0, 0.05]] * 54)
    for name, axes in (("height", [2]), ("plane", [0, 1])):
        by_axis = deviations_mm(prior, name)[:, axes]
        count = part(prior, name).modes.shape[1] / len(axes)
        np.testing.assert_allclose(np.sqrt(np.mean(by_axis**2, axis=0) / count), 0.05)
    twist = deviations_mm(prior, "twist")
    assert twist[:, 2].max() == pytest.approx(TUNING.uncertainty.flatness_mm)
    from_middle = np.abs(BOARD.centres_mm - BOARD.centres_mm.mean(axis=0))
    shear = deviations_mm(prior, "shear")
    np.testing.assert_allclose(shear[:, :2], 0.5 * TUNING.problem.shear * from_middle[:, ::-1])


@pytest.mark.parametrize("name", ["height", "plane"])
def test_smooth_parts_neither_move_nor_tilt_nor_stretch_the_board(name):
    modes = part(shape_prior(BOARD, 0.05), name).modes
    across = modes.reshape(len(BOARD), 3, -1)
    lower = np.column_stack([np.ones(len(BOARD)), BOARD.centres_mm])
    assert np.abs(np.einsum("nk,niw->kiw", lower, across)).max() < 1e-6 * len(BOARD) * 100
    np.testing.assert_allclose(modes.T @ modes / len(BOARD), np.eye(modes.shape[1]), atol=1e-9)


def test_each_board_of_a_set_has_modes_of_its_own():
    other = Chessboard(rows=5, columns=7, square_mm=20.0)
    both = shape_prior(BoardSet({"a": BOARD, "b": other}), 0.05)
    modes, count = part(both, "plane").modes, 3 * len(BOARD)
    is_first = np.any(modes[:count] != 0, axis=0)
    assert not np.any(is_first & np.any(modes[count:] != 0, axis=0))
    alone = part(shape_prior(BOARD, 0.05), "plane").modes
    np.testing.assert_allclose(modes[:count, is_first], alone)


def test_a_board_of_few_corners_has_the_modes_that_they_tell_apart():
    prior = shape_prior(Chessboard(rows=3, columns=3, square_mm=10.0), 0.05)
    assert np.linalg.cond(prior.covariance_mm2) < 1e8


def test_variances_of_shapes_are_found():
    """The mean of many estimates from drawn shapes with noise is the true variance."""
    random = np.random.default_rng(0)
    true = shape_prior(BOARD, 0.05)._replace(
        variance=np.square([1e-3, 0.3, 0.06, 0.02, 0.015, 0.04])
    )
    root, noise_mm = np.linalg.cholesky(true.covariance_mm2), 0.02
    variances = []
    for _ in range(12):
        size = len(root)
        noisy_shape = root @ random.normal(size=size) + noise_mm * random.normal(size=size)
        prior = shape_prior(BOARD, 0.1)
        for _ in range(40):
            covariance = np.linalg.inv(prior.information + np.eye(size) / noise_mm**2)
            shape = covariance @ noisy_shape / noise_mm**2
            prior = prior.update(shape.reshape(-1, 3), covariance)
        variances.append(prior.variance)
    ratio = np.sqrt(np.mean(variances, axis=0) / true.variance)
    np.testing.assert_allclose(ratio[2:], 1.0, atol=0.15)
    np.testing.assert_allclose(np.ptp(variances, axis=0)[:2], 0.0)
