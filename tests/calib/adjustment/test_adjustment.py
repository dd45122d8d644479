"""Laws of the joint adjustment of cameras over one sheet: derivatives, coverage, symmetries."""

import dataclasses

import jax
import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.stats import chi2

from tests.calib.adjustment.made_views import LENS_FACTOR, SHEET, TYPICAL, made_views
from trinoc.calib.adjustment.adjustment import Adjustment, adjust
from trinoc.calib.problem.information import whiten_views
from trinoc.calib.problem.sheet_problem import SheetPriors
from trinoc.calib.problem.variables import evaluate_prior, retract
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry import Pose
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rotation import vector_from_rotation
from trinoc.numerics.precision import as_numpy


def adjusted(cameras, systematics: Systematics = TYPICAL) -> Adjustment:
    return adjust(cameras, SHEET, SheetPriors(PoseModel.AIMED, systematics))


def off(adjustment: Adjustment, truth: Pose, view: int) -> np.ndarray:
    """Step of AIM_FREE from the adjusted pose to the true one."""
    adjusted_pose = adjustment.pose(view)
    turn = vector_from_rotation(truth.rotation @ np.asarray(adjusted_pose.rotation).T)
    away = np.append(
        truth.distance_mm - adjusted_pose.distance_mm, truth.aim_mm - adjusted_pose.aim_mm
    )
    return np.append(turn, away / adjustment.problem.parametrization.unit_mm)


def pose_covariance(adjustment: Adjustment, view: int) -> np.ndarray:
    """Covariance of a camera's step, in rad and mm."""
    rows, unit_mm = adjustment.rows(view), float(adjustment.problem.parametrization.unit_mm)
    units = np.diag([1.0] * 3 + [unit_mm] * 3)
    return units @ adjustment.covariance[np.ix_(rows, rows)] @ units


@pytest.mark.parametrize(
    "lens_factor",
    [
        pytest.param(None, marks=pytest.mark.slow, id="lens exact"),
        pytest.param(LENS_FACTOR, id="lens open"),
    ],
)
def test_errors_are_as_large_as_the_joint_covariance_says(lens_factor) -> None:
    """The 18 pose errors of 24 draws of sheet, print, aims, lenses and noise are chi-square."""
    squared = []
    for seed in range(24):
        made = made_views(seed, lens_factor=lens_factor)
        adjustment = adjusted(made.cameras)
        assert adjustment.converged
        error = np.concatenate([off(adjustment, truth, k) for k, truth in enumerate(made.poses)])
        rows = np.concatenate([adjustment.rows(k) for k in range(3)])
        covariance = adjustment.covariance[np.ix_(rows, rows)]
        squared.append(error @ np.linalg.solve(covariance, error))
    total = float(np.sum(squared))
    assert chi2.ppf(1e-4, 18 * 24) < total < chi2.ppf(1 - 1e-4, 18 * 24)


@pytest.mark.parametrize("sigma_px", [1e-2, 1e-6], ids=["circles", "far finer than the priors"])
def test_one_camera_is_known_by_the_rest_of_the_root(sigma_px) -> None:
    """The root is exact even if the image is far more accurate than the priors."""
    adjustment = adjusted(made_views(4, lens_factor=LENS_FACTOR, sigma_px=sigma_px).cameras)
    assert adjustment.converged
    scale = np.sqrt(np.diag(adjustment.covariance))
    assert np.linalg.eigvalsh(adjustment.covariance / np.outer(scale, scale)).min() > -1e-15
    root, camera_covariance = adjustment.pose_root(1), pose_covariance(adjustment, 1)
    units = np.diag([1.0] * 3 + [1 / float(adjustment.problem.parametrization.unit_mm)] * 3)
    np.testing.assert_allclose(
        root @ units @ camera_covariance @ units @ root.T, np.eye(6), atol=1e-5
    )
    np.testing.assert_array_less(0, np.linalg.svd(root, compute_uv=False))


def test_the_root_is_that_of_the_pixels_and_of_all_that_was_known() -> None:
    # A lens from a data sheet leaves directions to the aim's prior, though it is wide.
    adjustment = adjusted(made_views(0, lens_factor=10 * LENS_FACTOR).cameras)
    rows = np.concatenate(list(adjustment.whitened.jacobian[..., adjustment.free]))
    state, parametrization = adjustment.problem.state, adjustment.problem.parametrization
    prior_information = np.asarray(jax.jit(evaluate_prior)(state, parametrization).information)[
        np.ix_(adjustment.free, adjustment.free)
    ]
    expected = rows.T @ rows + prior_information
    scale = np.sqrt(np.diag(expected))
    inverse = np.linalg.inv(expected / np.outer(scale, scale)) / np.outer(scale, scale)
    np.testing.assert_allclose(
        adjustment.root @ inverse @ adjustment.root.T, np.eye(len(rows.T)), atol=1e-4
    )


def test_residuals_scatter_as_the_noise_does() -> None:
    reduced = np.concatenate(
        [adjusted(made_views(seed).cameras).reduced_chi_square for seed in range(20)]
    )
    freedom = adjusted(made_views(0).cameras).freedom
    assert abs(reduced.mean() - 1) < 4 * np.sqrt(2 / freedom.sum() / 20)


def test_derivatives_are_those_of_differences() -> None:
    """Derivatives equal differences for every step of poses, lenses and sheet, fixed ones too."""
    problem = adjusted(made_views(3, lens_factor=LENS_FACTOR).cameras).problem
    # By how much a circle's image lies aside of its centre's is taken where a step begins.
    parametrization = dataclasses.replace(problem.parametrization, has_circles=False)
    problem = problem._replace(parametrization=parametrization)
    jacobian = whiten_views(problem).jacobian
    every = np.ones(len(problem.free))
    opened = dataclasses.replace(parametrization, free=every)
    boards = np.zeros((1, 6))
    # Steps of camera 1, its lens and the sheet.
    slices, move = problem.slices, jax.jit(retract)
    pose = slices.camera(1)
    columns = [*range(slices.lens_size, slices.lens_size + 5), *range(pose.start, pose.stop)]
    columns += range(slices.sheets.start, len(every))
    for column in columns:
        step = 1e-3 * np.eye(len(every))[column]
        step /= max(np.abs(jacobian[1][:, column]).max(), 1.0)
        ends = [
            whiten_views(
                problem._replace(state=as_numpy(move(problem.state, opened, sign * step, boards)))
            ).residual[1]
            for sign in (1, -1)
        ]
        expected = (ends[0] - ends[1]) / (2 * step[column])
        scale = np.abs(expected).max()
        np.testing.assert_allclose(jacobian[1][:, column] / scale, expected / scale, atol=1e-4)


def test_the_order_of_the_cameras_is_no_matter() -> None:
    made = made_views(5)
    there, back = adjusted(made.cameras), adjusted(made.cameras[::-1])
    np.testing.assert_allclose(
        [there.parameters(k) for k in range(3)],
        [back.parameters(2 - k) for k in range(3)],
        rtol=1e-7,
        atol=1e-6,
    )
    scale = np.sqrt(np.diag(pose_covariance(there, 0)))
    share = (pose_covariance(there, 0) - pose_covariance(back, 2)) / np.outer(scale, scale)
    np.testing.assert_allclose(share, 0, atol=1e-5)


def test_two_cameras_know_more_of_the_bend_than_one() -> None:
    made = made_views(6)
    alone, both = adjusted(made.cameras[:1]), adjusted(made.cameras)
    # Both end at sheets that differ a little, and with them what a step does.
    share = eigh(pose_covariance(both, 0), pose_covariance(alone, 0), eigvals_only=True)
    assert share.max() < 1 + 1e-3
    assert share.min() < 0.5


def test_a_circle_that_is_elsewhere_is_left_out() -> None:
    made = made_views(7)
    detection = made.cameras[0].detection
    centres = detection.centres_px + 1.5 * (np.arange(len(detection)) == 11)[:, None]
    wrong = dataclasses.replace(
        made.cameras[0], detection=dataclasses.replace(detection, centres_px=centres)
    )
    adjustment = adjusted([wrong, *made.cameras[1:]])
    assert np.flatnonzero(~adjustment.used[0]).tolist() == [11]
    assert adjustment.used[1].all()
    assert adjustment.used[2].all()


def test_an_adjustment_continues_from_another_with_its_outliers() -> None:
    """A second adjustment of the same observations, started from the first, equals it."""
    made = made_views(7)
    detection = made.cameras[0].detection
    centres = detection.centres_px + 1.5 * (np.arange(len(detection)) == 11)[:, None]
    detection = dataclasses.replace(detection, centres_px=centres)
    cameras = [dataclasses.replace(made.cameras[0], detection=detection), *made.cameras[1:]]
    first, priors = adjusted(cameras), SheetPriors(PoseModel.AIMED, TYPICAL)
    continued = adjust(cameras, SHEET, priors, first)
    assert np.flatnonzero(~continued.used[0]).tolist() == [11]
    for view in range(3):
        sigma = np.sqrt(np.diag(pose_covariance(first, view)))
        away = np.abs(continued.parameters(view) - first.parameters(view))
        np.testing.assert_array_less(away, 1e-3 * sigma)
    np.testing.assert_allclose(continued.covariance, first.covariance, rtol=1e-4, atol=1e-12)


def test_places_that_scatter_more_than_they_claim_enlarge_their_camera_alone() -> None:
    made = made_views(8)
    camera = made.cameras[2]
    bold = dataclasses.replace(camera, detection=camera.detection.with_larger_sigmas(1 / 3))
    adjustment, honest = adjusted([*made.cameras[:2], bold]), adjusted(made.cameras)
    assert adjustment.sigma_factors[:2].tolist() == [1.0, 1.0]
    assert adjustment.sigma_factors[2] == pytest.approx(3, rel=0.3)
    ratio = np.diag(pose_covariance(adjustment, 2)) / np.diag(pose_covariance(honest, 2))
    assert (np.abs(np.log(ratio)) < np.log(1.5)).all()
