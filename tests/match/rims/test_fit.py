"""Errors of circles fitted to chords agree with their covariance, whatever the chords' errors."""

import numpy as np
import pytest

from tests.match.made import rig_of
from trinoc.geometry.projection import project_by_matrix
from trinoc.match.rims.circles import (
    GAUSS,
    Chords,
    Circles,
    circle_offsets,
    fit_circle,
    move_circle,
    points_on_circles,
)
from trinoc.match.rims.rim_answer import FittedRim, _build_pieces, _public_covariance, cover_circle
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.vectors import complete_axes

NORMAL = np.array([[0.1, -0.2, 0.97]])
CIRCLE = Circles(np.array([[8.0, -5.0, 30.0]]), NORMAL / np.linalg.norm(NORMAL), np.array([22.0]))
SIGMA_PX, TRIALS, PARAMETERS = 0.1, 150, 6


def chords_round(circle: Circles, views=("upper", "left", "right")) -> Chords:
    """Chords of arcs all round a circle, with two exact points on each arc."""
    columns = []
    for view, camera in enumerate(rig_of(*views)):
        matrix = np.asarray(rig_of(*views)[camera].matrix_px)
        middle = np.arange(10) * (2 * np.pi / 10) + 0.3 * view
        angle = np.stack([middle - 0.15, middle + 0.15], axis=1)
        on_arc = project_by_matrix(matrix, points_on_circles(circle, angle.reshape(1, -1))[0])
        on_arc = on_arc.reshape(-1, 2, 2)
        half = (on_arc[:, 1] - on_arc[:, 0]) / (2 * GAUSS)
        centre = on_arc.mean(axis=1)
        shares = np.array([-GAUSS, GAUSS, 0.0, -1.0, 1.0])
        points_px = centre[:, None] + shares[:, None] * half[:, None]
        rays = np.concatenate([points_px, np.ones((*points_px.shape[:2], 1))], axis=2)
        rays = rays @ np.linalg.inv(matrix[:, :3]).T
        count = len(points_px)
        columns.append(
            Chords(
                np.full(count, view),
                np.arange(count),
                points_px,
                rays / np.linalg.norm(rays, axis=2, keepdims=True),
                np.tile(-np.linalg.inv(matrix[:, :3]) @ matrix[:, 3], (count, 1)),
                np.tile(matrix, (count, 1, 1)),
                np.full(count, SIGMA_PX),
                2 * np.linalg.norm(half, axis=1),
            )
        )
    return Chords(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def shifted(chords: Chords, errors_px: np.ndarray) -> Chords:
    """The chords with their two points on the arc moved across by these errors, (n, 2) px."""
    chord = chords.points_px[:, 4] - chords.points_px[:, 3]
    right = np.stack([-chord[:, 1], chord[:, 0]], axis=1) / chords.length_px[:, None]
    points_px = chords.points_px.copy()
    points_px[:, :2] += errors_px[:, :, None] * right[:, None]
    rays = np.concatenate([points_px, np.ones((*points_px.shape[:2], 1))], axis=2)
    rays = np.einsum("nij,nkj->nki", np.linalg.inv(chords.matrix_px[:, :, :3]), rays)
    rays = rays / np.linalg.norm(rays, axis=2, keepdims=True)
    return chords._replace(points_px=points_px, rays=rays)


def error_of(circle: Circles) -> np.ndarray:
    """Parameters by which `move_circle` moves the fitted circle to the true one."""
    turn = (CIRCLE.normal - circle.normal)[0] @ complete_axes(circle.normal)[0].T
    return np.concatenate(
        [(CIRCLE.centre_mm - circle.centre_mm)[0], turn, CIRCLE.radius_mm - circle.radius_mm]
    )


def squares(draw) -> np.ndarray:
    """Squared Mahalanobis distances of fits from the truth, over the number of parameters."""
    exact, rng, normalised_squares = chords_round(CIRCLE), np.random.default_rng(0), []
    for _ in range(TRIALS):
        fit = fit_circle(shifted(exact, draw(rng, (len(exact.view), 2))), CIRCLE)
        error = error_of(fit.circle)
        normalised_squares.append(error @ np.linalg.solve(fit.covariance, error) / PARAMETERS)
    return np.array(normalised_squares)


def heavy(rng, size):
    """Normal errors, a tenth of which are five times as large."""
    return SIGMA_PX * rng.normal(size=size) * np.where(rng.random(size) < 0.1, 5.0, 1.0)


@pytest.mark.parametrize(
    ("draw", "smallest", "largest"),
    [
        # As stated: the covariance is enlarged where errors happen to be larger.
        (lambda rng, size: SIGMA_PX * rng.normal(size=size), 0.7, 1.1),
        # Smaller than stated: the covariance stays that of what is stated.
        (lambda rng, size: 0.2 * SIGMA_PX * rng.normal(size=size), 0.02, 0.06),
        # Three times as large: not enlarged, it would be some 9.
        (lambda rng, size: 3.0 * SIGMA_PX * rng.normal(size=size), 0.85, 1.25),
        (heavy, 0.8, 1.4),
    ],
)
def test_errors_are_those_of_the_covariance(draw, smallest, largest) -> None:
    assert smallest < squares(draw).mean() < largest


def test_exact_chords_leave_their_circle_from_beside_it() -> None:
    start = move_circle(CIRCLE, np.array([[0.3, -0.2, 0.2, 0.01, -0.01, 0.3]]))
    fit = fit_circle(chords_round(CIRCLE), start)
    fit = fit_circle(chords_round(CIRCLE), fit.circle)
    np.testing.assert_allclose(error_of(fit.circle), 0.0, atol=1e-4)


def test_chords_of_one_place_leave_the_circle_open() -> None:
    exact = chords_round(CIRCLE, ("upper",))
    one = Chords(*(column[[0, 0]] for column in exact))
    assert np.isnan(fit_circle(one, CIRCLE).covariance).all()


def fitted() -> tuple[Chords, FittedRim]:
    """A rim with independent errors of its parameters and one error common to all."""
    chords, root = chords_round(CIRCLE), np.random.default_rng(1).normal(size=(6, 6))
    scale = np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.15])
    around = circle_offsets(chords, CIRCLE, with_ends=True).nearest_mm[0]
    return chords, FittedRim(
        CIRCLE,
        (root @ root.T) * scale[:, None] * scale,
        np.arange(len(chords.view)),
        cover_circle(around, CIRCLE),
        1.0,
        1.0,
        only_two_views=False,
    )


def test_a_rim_s_covariance_is_that_of_its_centre_normal_and_radius() -> None:
    _, rim = fitted()
    slope = np.zeros((7, 6))
    for k, step in enumerate(1e-6 * np.eye(6)):
        moved = move_circle(CIRCLE, np.stack([step, -step]))
        change = [column[0] - column[1] for column in moved]
        slope[:, k] = np.hstack(change) / 2e-6
    np.testing.assert_allclose(
        _public_covariance(rim), slope @ rim.covariance @ slope.T, rtol=1e-5, atol=1e-9
    )


def test_pieces_move_out_and_up_as_their_circle_does() -> None:
    chords, rim = fitted()
    # Pixels so small that where detectors cut an arc says all along it.
    pieces = _build_pieces(rim, chords, 3, 1e-9, DEFAULT.rims)
    assert len(pieces.lines_mm) > 10
    normal, centre = CIRCLE.normal[0], CIRCLE.centre_mm[0]
    for ends, covariance in zip(pieces.lines_mm, pieces.covariance_mm2, strict=True):
        out = (ends - centre) / CIRCLE.radius_mm
        slope = np.zeros((4, 6))
        for k, step in enumerate(1e-6 * np.eye(6)):
            for sign in (1, -1):
                moved = move_circle(CIRCLE, sign * step[None])
                off = ends - moved.centre_mm[0]
                height = off @ moved.normal[0]
                beyond = np.linalg.norm(off - height[:, None] * moved.normal[0], axis=1)
                change = np.concatenate([moved.radius_mm[0] - beyond, -height])
                slope[:, k] += sign * change / 2e-6
        ways = np.zeros((4, 6))
        for end in (0, 1):
            ways[end, 3 * end : 3 * end + 3] = out[end]
            ways[2 + end, 3 * end : 3 * end + 3] = normal
        expected = slope @ rim.covariance @ slope.T
        np.testing.assert_allclose(ways @ covariance @ ways.T, expected, rtol=1e-4, atol=1e-6)
