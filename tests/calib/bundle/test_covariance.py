"""Sigmas of segments and their factors equal the scatter of simulated experiments."""

import jax
import numpy as np
import pytest

from tests.calib.bundle.made_tracks import TRUTH, made_tracks, rig_at
from trinoc.calib.bundle.camera import CameraState, camera_state, stack_states
from trinoc.calib.bundle.covariance import (
    determined_part,
    segment_and_errors,
    segment_factor,
    sheet_factor,
)
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.pose import PoseModel

segments = jax.jit(jax.vmap(segment_and_errors, (None, 0, 0, 0)))


def cameras():
    rig = rig_at(TRUTH, with_covariance=False)
    return stack_states([camera_state(each, PoseModel.AIM_FREE) for each in rig.cameras])


def test_ends_follow_the_cameras_as_whole_triangulations_do():
    lines, _, _ = made_tracks(1, 6, hidden=0.3, sigma_px=0.1)
    observed = lines.fragments_px, lines.covariance_px2, lines.seen
    by_cameras = np.asarray(segments(cameras(), *observed)[2])
    for k in range(18):
        step = 1e-5 * np.eye(18)[k].reshape(3, 6)
        above, below = (
            np.asarray(segments(jax.vmap(CameraState.retract)(cameras(), s), *observed)[0])
            for s in (step, -step)
        )
        expected = (above - below).reshape(6, 6) / 2e-5
        scale = np.abs(by_cameras).max(axis=(1, 2))[:, None]
        np.testing.assert_allclose(by_cameras[:, :, k] / scale, expected / scale, atol=0.02)


def test_ends_scatter_as_their_own_covariance_says():
    """Monte Carlo, seed fixed: 400 draws of one segment's noise, known cameras."""
    lines, ends, _ = made_tracks(2, 1, hidden=0.0, sigma_px=0.2)
    random, count = np.random.default_rng(3), 400
    rig = rig_at(TRUTH, with_covariance=False)
    homogeneous = np.concatenate([ends[0], np.ones((2, 1))], axis=1)
    image = np.einsum("vij,ej->vei", rig.matrices_px, homogeneous)
    exact = (image[..., :2] / image[..., 2:]).reshape(3, 4)
    root = np.linalg.cholesky(lines.covariance_px2[0])
    noise = np.einsum("vij,nvj->nvi", root, random.standard_normal((count, 3, 4)))
    covariance = np.tile(lines.covariance_px2, (count, 1, 1, 1))
    visible = np.ones((count, 3), dtype=bool)
    estimate, estimate_covariance, _ = segments(
        cameras(), (exact + noise).reshape(count, 3, 2, 2), covariance, visible
    )
    error = (np.asarray(estimate) - ends).reshape(count, 6)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(estimate_covariance), error)
    assert squared.mean() == pytest.approx(6, abs=4 * np.sqrt(12 / count))


def test_what_is_determined_is_the_inverse_and_what_is_not_is_named():
    random = np.random.default_rng(0)
    root = random.normal(size=(18, 18))
    information, none = root @ root.T, np.zeros((18, 18))
    determined = determined_part(information, none)
    assert (determined.rank, determined.gauge) == (18, "")
    np.testing.assert_allclose(determined.covariance, np.linalg.inv(information), rtol=1e-6)
    free = np.linalg.qr(random.normal(size=(18, 7)))[0]
    singular = information - information @ free @ np.linalg.solve(
        free.T @ information @ free, free.T @ information
    )
    determined = determined_part(singular, none)
    assert determined.rank == 11
    assert determined.gauge == "position, orientation and scale of the whole rig"


@pytest.mark.parametrize("factor", [0.3, 1.0, 2.5])
def test_the_factor_is_that_by_which_residuals_exceed_what_they_claim(factor: float) -> None:
    tracks, views = 400, 4
    squared = factor**2 * np.random.default_rng(2).chisquare(2, (tracks, views))
    # Each track's line takes four of the eight distances.
    fitted_factor, inlier = segment_factor(
        squared / 2, np.ones((tracks, views), dtype=bool), 0.0, TUNING
    )
    assert fitted_factor == pytest.approx(factor, rel=0.05)
    assert inlier.all()


def test_too_few_residuals_leave_the_claimed_sigmas() -> None:
    nothing, pairs = np.zeros((5, 3)), np.array([[True, True, False]] * 5)
    # The rounding error of a zero trace must not count as a degree of freedom.
    for trace in (0.0, -1e-12, 3.0):
        assert segment_factor(nothing, pairs, trace, TUNING)[0] == 1.0
    assert sheet_factor(400.0, 29.0, TUNING) == 1.0
    assert sheet_factor(400.0, 100.0, TUNING) == 2.0
