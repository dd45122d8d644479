"""Grey levels count as points with correlated errors, and impossible requests are named."""

from typing import Literal

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.linalg import block_diag

from simulation.camera_picture.layers import Paint
from simulation.camera_picture.render import render_sheet
from simulation.camera_picture.shapes import Cells
from tests.calib.made_shots import (
    BOARD,
    LENSES,
    SIZE_PX,
    board_poses,
    cam_from_rig,
    lens_of,
    shots as made,
)
from trinoc.calib import BoardSet
from trinoc.calib.problem.apparent_shift import apparent_shift
from trinoc.calib.problem.problem import FreeLensParameters, cam_from_board, lens_of_index
from trinoc.calib.problem.robust_fit import degrees_of_freedom, whitened_errors
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.problem.views import BoardObservation, SheetPoints, whitening_of_covariance
from trinoc.calib.problem.wrong_circles import discount_points, drop_wrong_circles
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.rig_pixels import expect_method, quarters_of_tags
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import square_sheet
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import InputError
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.projection import project_point

SHEET = Pattern.cross_grid(rows=5, columns=6, pitch_mm=25.0, radius_mm=7.0, line_width_mm=0.0)


def problem(target: AbstractTarget = BOARD):
    poses = board_poses(2)
    detections = made(count=2)
    views = [
        BoardObservation(c, s, each, np.ones(len(each), dtype=bool))
        for c, camera_detections in enumerate(detections.values())
        for s, each in enumerate(camera_detections)
    ]
    return start_problem(
        views,
        target,
        [lens_of(name) for name in LENSES],
        np.stack([cam_from_rig(name) for name in LENSES]),
        poses,
        [SIZE_PX] * 3,
        FreeLensParameters(np.arange(3), np.ones((3, 9), dtype=bool)),
        Systematics.typical({}),
    )


def shown(view, target: AbstractTarget = BOARD):
    """Grey-level points at the detection's points."""
    detection = view.detection
    whitening = np.asarray(block_diag(*whitening_of_covariance(detection.covariance_px2)))
    return SheetPoints(target.centres_mm[detection.circle_index], detection.centres_px, whitening)


def test_points_count_alike_whether_detected_or_shown():
    detected = problem()
    views = [view._replace(grey_level_points=shown(view)) for view in detected.views]
    # One of them is silent, and counts as it was detected.
    views[0] = detected.views[0]
    both = detected._replace(views=tuple(views))
    errors = [whitened_errors(each).reshape(len(each.table.shot), -1) for each in (detected, both)]
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-9)
    assert degrees_of_freedom(detected) == degrees_of_freedom(both)
    silenced = both._replace(views=tuple(v._replace(used=0 * v.used > 0) for v in both.views))
    assert not whitened_errors(silenced).any()


def test_points_that_may_lie_anywhere_take_their_information_along():
    random = np.random.default_rng(3)
    root = random.normal(size=(8, 8))
    points = SheetPoints(np.zeros((4, 2)), np.zeros((4, 2)), root)
    whitening = discount_points(points, np.array([1])).whitening
    rest = [0, 1, 4, 5, 6, 7]
    covariance = np.linalg.inv(root.T @ root)[np.ix_(rest, rest)]
    np.testing.assert_allclose(
        np.linalg.inv((whitening.T @ whitening)[np.ix_(rest, rest)]), covariance
    )
    assert not whitening[:, 2:4].any()


def test_a_circle_that_is_shown_elsewhere_is_left_out():
    here = problem(SHEET)
    views = []
    for view in here.views:
        points = shown(view, SHEET)
        aside = np.zeros_like(points.uv_px)
        aside[4] = 3.0
        views.append(view._replace(grey_level_points=points._replace(uv_px=points.uv_px + aside)))
    cleaned = drop_wrong_circles(here._replace(views=tuple(views)))
    assert all(np.flatnonzero(~view.rows_used).tolist() == [4] for view in cleaned.views)


def test_a_board_as_drawn_shifts_nothing_and_a_warped_one_its_middle():
    here = problem(SHEET)
    view = here.views[0]
    lens, pose = lens_of_index(here, 0), cam_from_board(here.state, view)
    points_mm = SHEET.centres_mm[:5]
    np.testing.assert_allclose(apparent_shift(here, view, pose, lens)(points_mm), 0.0, atol=1e-9)
    warped = eqx.tree_at(lambda state: state.sheet, here.state, np.array([0.0, 0.0, 1.0, 0.0]))
    shift = apparent_shift(here._replace(state=warped), view, pose, lens)
    edge = np.array([[0.0, 0.0], [62.5, 10.0], [-62.5, 0.0]])
    assert np.linalg.norm(shift(edge)[0]) > 0.1
    # At the edge the board does not rise; a parabola of 1 mm is shorter there by 2 / (3 * 62.5) mm.
    nearer = edge[1:] * [1 - 2 / 3 / 62.5**2, 1.0]
    drawn, bent = (
        np.array([project_point(pose, lens, np.append(xy, 0.0)) for xy in points_mm])
        for points_mm in (edge[1:], nearer)
    )
    np.testing.assert_allclose(shift(edge)[1:], bent - drawn, atol=1e-6)
    assert np.linalg.norm(bent - drawn, axis=1).max() > 0.005


@pytest.mark.parametrize("quarters", [1, 2])
def test_how_tags_are_turned_is_read_off_a_picture(quarters):
    board = AprilGrid(rows=2, columns=3, tag_mm=40.0)
    here = problem(board)
    one_view = here._replace(views=here.views[:1])
    sheet = square_sheet(board, quarters=quarters)
    picture = render_sheet(
        Pattern.circle_grid(rows=1, columns=1, pitch_mm=1, radius_mm=0.1),
        _camera("left", board_poses(2)[0]),
        covers=(Paint(Cells(sheet.x_mm, sheet.y_mm, sheet.ink), 25.0),),
        supersampling=2,
    )
    assert quarters_of_tags(one_view, board, lambda _: picture) == quarters


@pytest.mark.parametrize(
    ("method", "target", "message"),
    [
        ("grey", BOARD, 'must be "points" or "pixels"'),
        ("pixels", BOARD, "is a detection without grey levels"),
        ("pixels", BoardSet([BOARD, SHEET]), "contains several boards"),
    ],
)
def test_what_cannot_be_fitted_to_pixels_is_said(method, target, message):
    with pytest.raises(InputError, match=message):
        expect_method(method, target, made(count=1))


@pytest.mark.slow
def test_pixels_tell_more_than_circles_and_what_they_claim_is_true():
    sheet = Pattern.default()
    poses = board_poses(8, seed=2)
    keys: list = []
    errors: dict[Literal["points", "pixels"], list] = {"points": [], "pixels": []}
    for seed in range(2):
        random = np.random.default_rng(seed)
        pictures = {
            name: [
                render_sheet(
                    sheet, _camera(name, pose), noise_sigma=2.0, supersampling=4,
                    seed=int(random.integers(1 << 30)),
                )
                for pose in poses
            ]
            for name in ("left", "middle")
        }  # fmt: skip
        sigmas = {}
        for method, method_errors in errors.items():
            result = calibrate_rig(
                pictures, sheet, systematics=Systematics(), distortion=4, method=method
            )
            keys = [
                (f"{name}.{each}", value)
                for name in pictures
                for each, value in zip(lens_of(name).parameter_names[:8], LENSES[name])
            ]
            sigmas[method] = np.array([result.sigma(key) for key, _ in keys])
            method_errors.append(
                [(result.value(key) - value) / result.sigma(key) for key, value in keys]
            )
            assert result.halves is not None
            assert 0.5 < result.halves.ratio < 1.6
        assert np.all(sigmas["pixels"] < sigmas["points"])
    for method_errors in errors.values():
        assert 0.6 < np.sqrt(np.mean(np.square(method_errors))) < 1.5


def _camera(name, pose):
    camera_pose = cam_from_rig(name)
    both = np.column_stack(
        [camera_pose[:, :3] @ pose[:, :3], camera_pose[:, :3] @ pose[:, 3] + camera_pose[:, 3]]
    )
    with jax.enable_x64(True):
        return Camera(Intrinsics.of_lens(lens_of(name), SIZE_PX), Pose(both))
