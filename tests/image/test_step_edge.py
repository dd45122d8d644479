"""Laws of the blurred step: derivatives against differences, information against noisy fits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr

from trinoc.image.step_edge import (
    blur_of_two_slopes,
    blurred_step,
    fit_block,
    fit_profiles,
    height_of_step,
    log_parabola,
    peak_of_slope,
)

ROWS, HALF = 6, 11
NOISE = 1.5


def test_the_slope_of_a_step_is_its_derivative_and_tells_its_height() -> None:
    across, step = np.linspace(-4, 4, 33), 1e-6
    share, slope = blurred_step(across, 1.3)
    before, after = (blurred_step(across + k * step, 1.3)[0] for k in (-1, 1))
    np.testing.assert_allclose(slope, (after - before) / (2 * step), atol=1e-8)
    np.testing.assert_allclose(share + share[::-1], 1.0, atol=1e-12)
    middle = 40 * blurred_step(np.zeros(1), 1.3)[1]
    np.testing.assert_allclose(height_of_step(middle, np.full(1, 1.3**2)), 40.0, rtol=1e-6)


@pytest.mark.parametrize("slant", [0.0, 0.4, np.pi / 4])
def test_three_slopes_give_place_and_width_at_any_slant(slant: float) -> None:
    """Along the axis, the width and the offset of a slanted step grow by 1 / cosine."""
    positions_px = np.array([-0.45, 0.0, 0.3])
    off = (np.array([-1.0, 0.0, 1.0]) - positions_px[:, None]) * np.cos(slant)
    slope = 12 * blurred_step(off, 1.4)[1]
    offset, variance = peak_of_slope(slope)
    np.testing.assert_allclose(offset, positions_px, atol=1e-9)
    np.testing.assert_allclose(variance, (1.4 / np.cos(slant)) ** 2, rtol=1e-9)
    rise, bend = log_parabola(slope, np.full((3, 1), 1e-9))
    np.testing.assert_allclose(rise / bend, positions_px, atol=1e-9)


def test_two_slopes_give_the_blur_whatever_the_height() -> None:
    fine, coarse = (1 / np.hypot(1.7, scale) for scale in (1.0, 2.0))
    assert blur_of_two_slopes((fine / coarse) ** 2, 1.0, 2.0) == pytest.approx(1.7)


ACROSS = np.linspace(-6, 6, 49)
START_OFF, PLACE = np.array([0.3, -0.2, 2.0, 0.2]), np.array([1.0, 0.0, 0.0, 0.0])
TRUE = np.array([0.3, 0.2, 50.0, np.log(1.1)])


def profiles(count: int, noise: float) -> np.ndarray:
    clean = TRUE[2] + 60 * np.exp(TRUE[1]) * ndtr((ACROSS - TRUE[0]) / np.exp(TRUE[3]))
    return clean + noise * np.random.default_rng(3).normal(size=(count, len(ACROSS)))


def fitted(level: np.ndarray, noise: float, precision: np.ndarray, prior: np.ndarray = TRUE):
    count = len(level)
    return fit_profiles(
        np.tile(ACROSS, (count, 1)), level, np.full(level.shape, noise**-2), np.full(count, 60.0),
        np.tile(TRUE + START_OFF, (count, 1)), np.tile(prior, (count, 1)), precision,
        -np.inf,
    )  # fmt: skip


@pytest.mark.parametrize("known_blur", [False, True])
def test_profiles_scatter_as_their_variance_says(known_blur: bool) -> None:
    precision = np.array([0.0, 0.0, 0.0, 1e8 if known_blur else 0.0])
    fit = fitted(profiles(600, 4.0), 4.0, precision)
    z = (fit.position_px - TRUE[0]) / np.sqrt(fit.variance_px2)
    assert abs(z.mean()) < 0.15
    assert np.square(z).mean() == pytest.approx(1.0, abs=0.17)
    # Levels less the unknowns that no prior holds.
    assert fit.chi_square.mean() == pytest.approx(49 - (3 if known_blur else 4), abs=1.5)


def test_what_is_known_beforehand_is_weighed_against_the_profile() -> None:
    """A prior with as much information as the profile halves the variance and moves the position
    half of the distance to the prior."""
    level = profiles(1, 0.0)
    alone = fitted(level, 2.0, np.zeros(4))
    # All else fixed: then the position's information is that of its own slope.
    fixed = np.array([0.0, 1e9, 1e9, 1e9])
    position_information = 1 / fitted(level, 2.0, fixed).variance_px2[0]
    prior = TRUE + 0.01 * PLACE
    both = fitted(level, 2.0, fixed + position_information * PLACE, prior)
    assert both.position_px[0] - TRUE[0] == pytest.approx(0.005, rel=0.02)
    assert both.variance_px2[0] == pytest.approx(0.5 / position_information, rel=1e-3)
    assert alone.variance_px2[0] > 1 / position_information


def test_levels_without_information_are_as_if_they_were_not_there() -> None:
    level, there = profiles(3, 4.0), np.random.default_rng(5).random((3, len(ACROSS))) < 0.6
    start = np.tile(TRUE + START_OFF, (3, 1))

    def fitted_to(across: np.ndarray, level: np.ndarray, information: np.ndarray):
        count = len(level)
        arguments = across, level, information, np.full(count, 60.0), start[:count], start[:count]
        return np.stack(fit_profiles(*arguments, np.zeros(4), -np.inf))

    all_information = np.where(there, 4.0**-2, 0.0)
    together = fitted_to(np.tile(ACROSS, (3, 1)), np.where(there, level, 1e3), all_information)
    alone = [
        fitted_to(ACROSS[None, present], level[[k]][:, present], all_information[[k]][:, present])
        for k, present in enumerate(there)
    ]
    np.testing.assert_allclose(together, np.concatenate(alone, axis=1), rtol=1e-7)


def block(generator: np.random.Generator, noise: float = NOISE):
    """A noisy step, 0.2 px beside the line at one end and 0.1 px at the other, with blur 1.1."""
    v, u = np.mgrid[:ROWS, : 2 * HALF + 1].astype(float)
    across = (u - HALF) * 0.96 - 0.28 * (v - 2)
    share = 0.3 + 0.1 * v
    shift = 0.2 - 0.1 * share
    level = 60 + 50 * ndtr((across - shift) / 1.1)
    return across, share, level + noise * generator.normal(size=level.shape)


def fitted_block(parameters, level, across, share, slopes=1e6):
    usable, reach = np.ones(level.shape, bool), np.ones(level.shape[1], bool)
    core, slopes = jnp.array([2.2, 0.7]), jnp.full(2, slopes)
    return fit_block(core, slopes, across, share, level, usable, reach, parameters, 1.0)


def test_the_gradient_of_a_block_is_that_of_its_reduced_sum_of_squares() -> None:
    across, share, level = block(np.random.default_rng(1))
    fit_one = jax.jit(lambda parameters: fitted_block(parameters, level, across, share))
    parameters, step = jnp.array([0.1, 0.05, 0.0]), 1e-5
    numeric = [
        (fit_one(parameters - h).square - fit_one(parameters + h).square) / (4 * step)
        for h in step * jnp.eye(3)
    ]
    np.testing.assert_allclose(fit_one(parameters).gradient, numeric, rtol=1e-4, atol=1e-4)


def test_the_information_of_a_block_is_the_curvature_of_its_likelihood() -> None:
    """Without noise and at the true step the Gauss-Newton form is exact."""
    across, share, level = block(np.random.default_rng(1), noise=0.0)
    fit_one = jax.jit(lambda parameters: fitted_block(parameters, level, across, share))
    parameters, step = jnp.array([0.2, 0.1, np.log(1.1)]), 1e-4
    numeric = [
        (fit_one(parameters - h).gradient - fit_one(parameters + h).gradient) / (2 * step)
        for h in step * jnp.eye(3)
    ]
    np.testing.assert_allclose(
        fit_one(parameters).information, np.stack(numeric), rtol=2e-3, atol=0.5
    )


def test_places_of_blocks_scatter_as_their_information_says() -> None:
    """One Gauss-Newton step from the truth in 500 noisy pictures of one edge."""
    generator, parameters = np.random.default_rng(4), jnp.array([0.2, 0.1, np.log(1.1)])
    across, share, _ = block(generator)
    levels = np.stack([block(generator)[2] for _ in range(500)])
    fit_many = jax.jit(jax.vmap(lambda level: fitted_block(parameters, level, across, share)))
    fits = fit_many(levels)
    information = np.asarray(fits.information).mean(axis=0) / NOISE**2
    move = np.linalg.solve(np.asarray(fits.information), np.asarray(fits.gradient)[..., None])[
        ..., 0
    ]
    square = np.einsum("ni,ij,nj->n", move, information, move)
    assert square.mean() == pytest.approx(3.0, abs=0.4)
    # Six levels and slopes are each block's own.
    freedom = levels[0].size - 6
    assert np.asarray(fits.square).mean() / NOISE**2 == pytest.approx(freedom, rel=0.02)


def test_slopes_of_levels_are_held_by_what_is_known_of_them() -> None:
    """The step is that of a ridge regression with the prior's rows added to the pixels'."""
    generator = np.random.default_rng(6)
    across, share, level = block(generator)
    level = level + 1.5 * across
    right = ndtr((across - 0.2) / 1.1).reshape(-1, 1)
    along = np.broadcast_to(np.arange(ROWS)[:, None] - (ROWS - 1) / 2, across.shape)
    side = np.stack([np.ones_like(across), across - 0.2, along], axis=-1).reshape(-1, 3)
    basis = np.concatenate([side * (1 - right), side * right], axis=1)
    for sigma in (0.01, 0.1, 1e3):
        prior = np.diag([0.0, 1 / sigma, 1 / sigma] * 2)
        rows = np.concatenate([basis, prior])
        levels = np.linalg.lstsq(rows, np.append(level.reshape(-1), np.zeros(6)))[0]
        parameters = jnp.array([0.2, 0.2, np.log(1.1)])
        fit = fitted_block(parameters, level, across, share, slopes=sigma)
        assert float(fit.step) == pytest.approx(levels[3] - levels[0], rel=1e-3)
