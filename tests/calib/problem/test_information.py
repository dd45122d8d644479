"""Information of shots about lenses, cameras and board, by dense equations and random draws."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.calib.made_shots import board_poses
from tests.calib.problem.made_problem import problem
from trinoc.calib.problem.board_shape import shape_covariance, with_free_points
from trinoc.calib.problem.information import Information, compute_information, whiten_views
from trinoc.calib.problem.outcome import ShotScatter, enlarge_covariance, shot_scatter
from trinoc.calib.problem.problem import with_lens_free
from trinoc.calib.problem.reprojection import whitened_residuals
from trinoc.calib.problem.robust_fit import (
    degrees_of_freedom,
    inliers,
    whitened_errors,
    with_sigma_factors,
)
from trinoc.calib.problem.shape_prior import shape_prior
from trinoc.calib.problem.variables import retract
from trinoc.calib.problem.views import whitening_of_covariance
from trinoc.calib.tuning.every_group import TUNING


@pytest.fixture(scope="module")
def here():
    """Problem whose shots determine all parameters but the last coefficient of the lenses."""
    free = np.ones((3, 9), dtype=bool)
    free[:, -1] = False
    return with_lens_free(problem(board_poses(6)), free)


@pytest.fixture(scope="module")
def information(here):
    return compute_information(here)


@pytest.fixture(scope="module")
def dense(here):
    """Residuals of each view, and their derivatives by steps of head and boards."""
    shots = len(here.state.rig_from_board)

    state, parametrization, table = jax.tree.map(
        jnp.asarray, (here.state, here.parametrization, here.table)
    )

    @jax.jit
    def residuals(head, boards):
        return whitened_residuals(
            retract(state, parametrization, head, boards), parametrization, table
        )

    zero = jnp.zeros(len(here.free)), jnp.zeros((shots, 6))
    by_head, by_boards = jax.jit(jax.jacfwd(residuals, argnums=(0, 1)))(*zero)
    rows = np.asarray(residuals(*zero)), np.asarray(by_head), np.asarray(by_boards)
    views = len(here.views)
    return tuple(each[:views].reshape(views, -1, *each.shape[3:]) for each in rows)


def test_each_shot_says_what_dense_equations_say_once_its_board_is_eliminated(
    here, information, dense
):
    residual, by_head, by_boards = dense
    shot_of = np.array([view.shot for view in here.views])
    for shot in range(here.shots):
        in_shot = shot_of == shot
        r = residual[in_shot].ravel()
        head = by_head[in_shot].reshape(len(r), -1)
        board = by_boards[in_shot][:, :, shot].reshape(len(r), 6)
        follow = -np.linalg.solve(board.T @ board, board.T @ head)
        reduced = head + board @ follow
        scale = np.sqrt(np.maximum(np.diag(head.T @ head), 1.0))
        np.testing.assert_allclose(
            information.shot_information[shot] / np.outer(scale, scale),
            (reduced.T @ reduced) / np.outer(scale, scale),
            atol=1e-8,
        )
        np.testing.assert_allclose(
            information.gradients[shot] / scale, reduced.T @ r / scale, atol=1e-6
        )
        np.testing.assert_allclose(information.board_by_parameters[shot], follow, atol=1e-6)
        np.testing.assert_allclose(
            information.board_covariance[shot] @ board.T @ board, np.eye(6), atol=1e-6
        )


def test_the_covariance_is_that_of_all_unknowns_together_with_what_was_known(
    here, information, dense
):
    _, by_head, by_boards = dense
    rows = by_head.shape[0] * by_head.shape[1]
    boards = by_boards[:, :, : here.shots].reshape(rows, -1)
    every = np.concatenate([by_head.reshape(rows, -1)[:, information.free], boards], axis=1)
    normal = every.T @ every
    has_prior = np.zeros(len(here.free))
    has_prior[here.slices.sheets.start :] = 1.0
    count = len(information.free)
    sheet = np.asarray(here.parametrization.sheet_scale)
    prior = np.zeros((len(has_prior), len(has_prior)))
    prior[here.slices.sheets.start :, here.slices.sheets.start :] = (
        sheet[:, None] * here.priors.sheet_information * sheet
    )
    normal[:count, :count] += prior[np.ix_(information.free, information.free)]
    scale = np.sqrt(np.diag(normal))
    expected = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    covariance, expected = information.observability.covariance, expected[:count, :count]
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-4
    )


def test_views_are_linear_in_the_steps_of_the_head(here, information, dense):
    residual, by_head, _ = dense
    whitened = whiten_views(here)
    np.testing.assert_allclose(whitened.residual, residual, atol=1e-9)
    free = information.free
    np.testing.assert_allclose(
        whitened.jacobian[..., free], by_head[..., free], rtol=1e-7, atol=1e-6
    )


def test_noise_is_enlarged_and_what_was_known_is_not():
    random = np.random.default_rng(0)
    rows, root = random.normal(size=(9, 4)), random.normal(size=(4, 4))
    shown, prior, factor = rows.T @ rows, root @ root.T, 2.5
    covariance = np.linalg.inv(shown + prior)
    np.testing.assert_allclose(
        enlarge_covariance(covariance, factor, prior),
        covariance @ (factor * shown + prior) @ covariance,
    )


@pytest.mark.parametrize("variance", [1.0, 4.0])
def test_the_scatter_of_pulls_is_that_of_their_noise(variance):
    """The scatter of the pulls equals the variance of the noise.

    At the end of a fit the pulls of all shots cancel: each is its own noise less its share of the
    common step.
    """
    random, shots, size = np.random.default_rng(0), 6, 3
    rows = 30 * random.normal(size=(shots, 8, size))
    of_shot = np.swapaxes(rows, 1, 2) @ rows
    total, free = of_shot.sum(axis=0), np.arange(size)
    factors, sigmas = [], []
    for _ in range(2000):
        noise = np.sqrt(variance) * random.normal(size=(shots, 8))
        pulls = np.einsum("sni,sn->si", rows, noise)
        pulls = pulls - of_shot @ np.linalg.solve(total, pulls.sum(axis=0))
        shots_information = Information(
            of_shot,
            pulls,
            np.zeros((shots, 6, size)),
            np.zeros((shots, 6, 6)),
            free,
            np.zeros((size, size)),
            size,
        )
        scatter = shot_scatter(shots_information)
        factors.append(scatter.factor)
        sigmas.append(scatter.sigma)
    assert np.mean(factors) == pytest.approx(variance, rel=0.05)
    assert np.std(factors) / variance == pytest.approx(np.mean(sigmas), rel=0.3)


@pytest.mark.parametrize("off", [0.0, 30.0])
def test_the_scatter_of_pulls_is_that_of_their_noise_whatever_was_held(off):
    """Pulls at a parameter that was fixed wrongly do not count as disagreement of the shots."""
    random, shots, size, is_fixed = np.random.default_rng(0), 6, 3, np.arange(3) == 2
    rows = 30 * random.normal(size=(shots, 8, size))
    of_shot = np.swapaxes(rows, 1, 2) @ rows
    total, factors = of_shot.sum(axis=0), []
    wrong = np.where(is_fixed, off / np.sqrt(np.diag(total)), 0.0)
    for _ in range(1000):
        pulls = np.einsum("sni,sn->si", rows, random.normal(size=(shots, 8))) + of_shot @ wrong
        step = np.linalg.solve(total[:2, :2], pulls.sum(axis=0)[:2])
        pulls = pulls - of_shot[:, :, :2] @ step
        shots_information = Information(
            of_shot,
            pulls,
            np.zeros((shots, 6, size)),
            np.zeros((shots, 6, 6)),
            np.arange(size),
            np.zeros((size, size)),
            size,
        )
        factors.append(shot_scatter(shots_information, is_fixed).factor)
    assert np.mean(factors) == pytest.approx(1.0, rel=0.05)


def test_sigmas_of_corners_are_such_that_chi_square_is_as_large_as_it_should_be(here):
    """With the sigmas of cameras and images, chi-square equals its degrees of freedom."""
    chi_square = float(np.sum(whitened_errors(with_sigma_factors(here)) ** 2))
    assert chi_square == pytest.approx(degrees_of_freedom(here))


def test_an_image_that_is_noisier_has_larger_sigmas(here):
    """Residuals three times as large in one image enlarge its sigmas as much, up to bounds."""
    errors = whitened_errors(here)
    k = next(k for k, view in enumerate(here.views) if view.used.any())
    view = here.views[k]
    count = len(view.used)
    moved = view.detection.centres_px.copy()
    random = np.random.default_rng(0)
    typical = np.sqrt(np.mean(errors[k][:count] ** 2))
    sigma = np.sqrt(np.trace(view.detection.covariance_px2, axis1=1, axis2=2) / 2)
    moved += 3.0 * typical * sigma[:, None] * random.normal(size=moved.shape)
    detection = eqx.tree_at(lambda d: d.centres_px, view.detection, moved)
    views = list(here.views)
    views[k] = view._replace(detection=detection)
    after = with_sigma_factors(here._replace(views=tuple(views)))
    others = [
        v.sigma_ratio for j, v in enumerate(after.views) if j != k and v.camera == view.camera
    ]
    assert 2.0 < after.views[k].sigma_ratio / np.median(others) < 4.5


def test_the_shape_has_as_many_effective_parameters_as_the_shots_determine(here):
    """Their number is the trace of the shots' share of the information times the covariance."""
    prior = shape_prior(here.target, 0.05)
    free = with_free_points(here, prior.information)
    information = compute_information(free)
    covariance = information.observability.covariance
    factor, of_shape_mm2 = shape_covariance(free)
    share_of_shots = np.eye(len(covariance)) - covariance @ information.prior
    count = 3 * len(free.target)
    expected = np.trace(share_of_shots[-count:, -count:])
    assert prior.count_determined(of_shape_mm2 / factor) == pytest.approx(expected, rel=1e-5)


def test_whitened_errors_are_independent():
    roots = np.random.default_rng(0).normal(size=(20, 2, 2))
    covariance = roots @ np.swapaxes(roots, 1, 2)
    whitening = whitening_of_covariance(covariance)
    np.testing.assert_allclose(
        whitening @ covariance @ np.swapaxes(whitening, 1, 2),
        np.broadcast_to(np.eye(2), covariance.shape),
        atol=1e-9,
    )


@pytest.mark.parametrize("noise", [1.0, 3.0])
def test_noise_passes_the_gate_as_often_as_it_should_and_outliers_do_not(noise):
    """Lengths of whitened errors follow Rayleigh's law. Larger noise is estimated."""
    errors = noise * np.random.default_rng(0).normal(size=(4000, 2))
    errors[:40] = noise * 1.3 * TUNING.problem.gate * np.array([0.6, 0.8])
    agree = inliers(errors)
    assert not agree[:40].any()
    assert np.mean(~agree[40:]) == pytest.approx(np.exp(-(TUNING.problem.gate**2) / 2), abs=0.01)


@pytest.mark.parametrize(("factor", "applied"), [(3.0, 3.0), (1.05, 1.0), (0.4, 1.0)])
def test_sigmas_grow_where_shots_refute_them_and_never_shrink(factor, applied):
    assert ShotScatter(factor, 0.1).variance_factor == applied
