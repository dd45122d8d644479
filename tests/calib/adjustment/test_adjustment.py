"""Cameras over one sheet adjusted together: derivatives, coverage, symmetries."""

import jax
import numpy as np
import pytest
from scipy.stats import chi2

from tests.calib.adjustment.made_views import LENS_FACTOR, TYPICAL, made_views
from trinoc.calib.adjustment import Adjustment, adjusted_views, residuals_px
from trinoc.calib.uncertainty import Systematics
from trinoc.geometry import Pose, PoseModel

FREE = PoseModel.AIM_FREE


def adjusted(views, known: Systematics = TYPICAL) -> Adjustment:
    return adjusted_views(views, known, FREE, known.aim_sigma_mm)


def off(found: Adjustment, truth: Pose, view: int) -> np.ndarray:
    """The step from what was found to the truth."""
    pose = jax.tree.map(lambda leaf: leaf[view], found.adjusted.pose)
    return np.asarray(pose.step_to(truth, pose.distance_mm))


def pose_covariance(found: Adjustment, view: int) -> np.ndarray:
    return found.covariance[found.rows(view), found.rows(view)]


@pytest.mark.parametrize(
    "lens_factor",
    [
        pytest.param(None, marks=pytest.mark.slow, id="lens exact"),
        pytest.param(LENS_FACTOR, id="lens open"),
    ],
)
def test_errors_are_as_large_as_the_joint_covariance_says(lens_factor) -> None:
    """Sheet, print, aims, lenses and noise drawn 60 times: all 18 numbers together."""
    squared = []
    for seed in range(60):
        made = made_views(seed, lens_factor=lens_factor)
        found = adjusted(made.views)
        assert found.converged
        error = np.concatenate([off(found, truth, k) for k, truth in enumerate(made.poses)])
        covariance = found.covariance[: len(error), : len(error)]
        squared.append(error @ np.linalg.solve(covariance, error))
    total = float(np.sum(squared))
    assert chi2.ppf(1e-4, 18 * 60) < total < chi2.ppf(1 - 1e-4, 18 * 60)


@pytest.mark.parametrize("sigma_px", [1e-2, 1e-6], ids=["circles", "far finer than the priors"])
def test_one_camera_is_known_by_the_rest_of_the_root(sigma_px) -> None:
    """However much finer the picture is than the priors on sheet and lens."""
    found = adjusted(made_views(4, lens_factor=LENS_FACTOR, sigma_px=sigma_px).views)
    assert found.converged
    scale = np.sqrt(np.diag(found.covariance))
    assert np.linalg.eigvalsh(found.covariance / np.outer(scale, scale)).min() > -1e-15
    root, own = found.pose_root(1), pose_covariance(found, 1)
    np.testing.assert_allclose(root @ own @ root.T, np.eye(6), atol=1e-5)
    np.testing.assert_array_less(0, np.linalg.svd(root, compute_uv=False))


def test_residuals_scatter_as_the_noise_does() -> None:
    reduced = np.concatenate(
        [adjusted(made_views(seed).views).reduced_chi_square for seed in range(20)]
    )
    freedom = adjusted(made_views(0).views).freedom
    assert abs(reduced.mean() - 1) < 4 * np.sqrt(2 / freedom.sum() / 20)


def test_derivatives_are_those_of_differences() -> None:
    made = made_views(3, lens_factor=LENS_FACTOR)
    found = adjusted(made.views)
    state = found.adjusted
    points = made.views[1].points
    pose, lens = jax.tree.map(lambda leaf: leaf[1], (state.pose, state.lens))
    count = len(points.place_mm)

    def whitened(step, change, bend):
        moved = pose.retract(step, FREE, pose.distance_mm)
        off_px = residuals_px(
            moved, lens.retract(change), state.shape + bend, points, found.reach_mm
        )
        return points.whitening @ np.asarray(off_px).reshape(-1)

    sizes, columns = (6, 9, len(state.shape)), (state.by_pose, state.by_lens, state.by_shape)
    for kind, (size, derivative) in enumerate(zip(sizes, columns, strict=True)):
        for k in range(size):
            step = 1e-5 * np.eye(size)[k] * (1e2 if kind == 2 and k >= 3 else 1)
            at = [np.zeros(other) for other in sizes]
            ends = []
            for sign in (1, -1):
                at[kind] = sign * step
                ends.append(whitened(*at))
            expected = (ends[0] - ends[1]) / (2 * step[k])
            scale = np.abs(expected).max()
            own = np.asarray(derivative)[1, : 2 * count, k]
            np.testing.assert_allclose(own / scale, expected / scale, atol=1e-4)


def test_the_order_of_the_cameras_is_no_matter() -> None:
    made = made_views(5)
    there, back = adjusted(made.views), adjusted(made.views[::-1])
    np.testing.assert_allclose(there.parameters, back.parameters[::-1], rtol=1e-8, atol=1e-6)
    scale = np.sqrt(np.diag(pose_covariance(there, 0)))
    share = (pose_covariance(there, 0) - pose_covariance(back, 2)) / np.outer(scale, scale)
    np.testing.assert_allclose(share, 0, atol=1e-5)


def test_two_cameras_know_more_of_the_bend_than_one() -> None:
    made = made_views(6)
    alone, both = adjusted(made.views[:1]), adjusted(made.views)
    assert np.linalg.eigvalsh(pose_covariance(alone, 0) - pose_covariance(both, 0)).min() > -1e-18


def test_a_circle_that_is_elsewhere_is_left_out() -> None:
    made = made_views(7)
    view = made.views[0]
    uv = view.points.uv_px.copy()
    uv[11] += 1.5
    wrong = view._replace(points=view.points._replace(uv_px=uv))
    found = adjusted([wrong, *made.views[1:]])
    assert np.flatnonzero(~found.used[0]).tolist() == [11]
    assert found.used[1].all()
    assert found.used[2].all()


def test_places_that_scatter_more_than_they_claim_enlarge_their_camera_alone() -> None:
    made = made_views(8)
    view = made.views[2]
    bold = view._replace(points=view.points._replace(whitening=3 * view.points.whitening))
    found, honest = adjusted([*made.views[:2], bold]), adjusted(made.views)
    assert found.enlarged[:2].tolist() == [1.0, 1.0]
    assert found.enlarged[2] == pytest.approx(3, rel=0.3)
    ratio = np.diag(pose_covariance(found, 2)) / np.diag(pose_covariance(honest, 2))
    assert (np.abs(np.log(ratio)) < np.log(1.5)).all()
