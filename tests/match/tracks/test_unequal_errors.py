"""Errors that differ from line to line: the learned tail, and the coverage of the ellipsoids."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import chi2

from tests.match.made import loose_lines, pictures, rig_of
from trinoc.errors import InputError
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import Matches
from trinoc.match.tracks.unequal_errors import (
    degrees_of_misfit,
    ellipsoid_limit,
    fit_tail,
    misfit_limit,
    scale_covariance_of_lines,
    variance_factor,
)

LIMIT = chi2.ppf(0.95, 4)
RIG = rig_of("upper", "left", "right")
SIGMA_PX = 0.4


def drawn(
    factor: np.ndarray, degrees: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Misfits and error chi-squares of lines whose variances are `factor` times as stated."""
    misfit = np.where(degrees > 0, factor * rng.chisquare(np.maximum(degrees, 1)), 0.0)
    return misfit, factor * rng.chisquare(4, len(factor))


def held(misfit: np.ndarray, degrees: np.ndarray, square: np.ndarray, tail: float) -> float:
    return float(np.mean(square / variance_factor(misfit, degrees, tail) < LIMIT))


@pytest.mark.parametrize("freedom", [3.0, 6.0, 12.0])
@pytest.mark.parametrize("views", [2, 3, 6])
def test_ellipsoids_of_unequal_errors_hold(freedom: float, views: int) -> None:
    rng, count = np.random.default_rng(7), 20_000
    factor = freedom / rng.chisquare(freedom, count)
    three = np.full(count, 2)
    learned = fit_tail(drawn(factor, three, rng)[0], three, has_images=True)
    np.testing.assert_allclose(learned, 1 / freedom, rtol=0.15)
    degrees = np.full(count, 2 * (views - 2))
    misfit, square = drawn(factor, degrees, rng)
    share = held(misfit, degrees, square, 1 / freedom)
    assert abs(share - 0.95) < 4 * np.sqrt(0.95 * 0.05 / count)
    square = square / variance_factor(misfit, degrees, 1 / freedom)
    for probability in (0.25, 0.5, 0.8, 0.99):
        share = np.mean(square < ellipsoid_limit(probability, degrees, 1 / freedom))
        assert abs(share - probability) < 4 * np.sqrt(probability * (1 - probability) / count)


def test_of_equal_errors_and_at_95_percent_ellipsoids_are_those_of_a_normal_distribution() -> None:
    degrees = np.array([0, 2, 6])
    for tail in (0.0, 0.2):
        np.testing.assert_allclose(ellipsoid_limit(0.95, degrees, tail), LIMIT)
    np.testing.assert_allclose(ellipsoid_limit(0.5, degrees, 0.0), chi2.ppf(0.5, 4))
    with pytest.raises(InputError, match="between 0 and 1"):
        match_segments(pictures(RIG, loose_lines(8, seed=1), 0.3), RIG).ellipsoid_limit(95)


@pytest.mark.parametrize("freedom", [4.0, 8.0, np.inf])
def test_misfits_pass_their_limit_as_often_as_it_says(freedom: float) -> None:
    rng, count = np.random.default_rng(9), 40_000
    equal = np.isinf(freedom)
    factor = np.ones(count) if equal else freedom / rng.chisquare(freedom, count)
    degrees = np.resize([2, 6, 18], count)
    misfit, _ = drawn(factor, degrees, rng)
    for probability in (0.3, 0.01):
        beyond = np.mean(misfit > misfit_limit(probability, degrees, 0.0 if equal else 1 / freedom))
        assert abs(beyond - probability) < 4 * np.sqrt(probability / count)


@pytest.mark.parametrize(("of_pictures", "max_tail"), [(True, 0.06), (False, 0.02)])
def test_normal_errors_leave_ellipsoids_as_they_are(of_pictures: bool, max_tail: float) -> None:
    rng = np.random.default_rng(2)
    for _ in range(5):
        degrees = np.full(400, 2)
        misfit, square = drawn(np.ones(400), degrees, rng)
        tail = fit_tail(misfit, degrees, has_images=of_pictures)
        assert tail < max_tail
        before = float(np.mean(square < LIMIT))
        assert before <= held(misfit, degrees, square, tail) <= before + 0.6 * max_tail


def test_a_mixture_that_is_no_student_distribution_is_held_all_the_same() -> None:
    rng, count = np.random.default_rng(5), 5000
    factor = np.where(rng.random(count) < 0.12, 9.0, 1.0)
    degrees = np.full(count, 2)
    misfit, square = drawn(factor, degrees, rng)
    tail = fit_tail(misfit, degrees, has_images=False)
    assert np.mean(square < LIMIT) < 0.89
    assert 0.935 < held(misfit, degrees, square, tail) < 0.965
    # The worse the views agree, the larger is what is claimed.
    agree = np.sort(misfit)
    assert (np.diff(variance_factor(agree, degrees, tail)) >= 0).all()


def test_without_observations_what_is_known_before_holds() -> None:
    none = np.zeros(0), np.zeros(0, dtype=np.int64)
    in_pictures, otherwise = (
        fit_tail(*none, has_images=has_images) for has_images in (True, False)
    )
    assert 0.2 < in_pictures < 0.3
    assert 0.005 < otherwise < 0.015
    misfit = np.array([0.0, 3.0, 40.0])
    np.testing.assert_array_equal(variance_factor(misfit, np.full(3, 2), 0.0), np.ones(3))
    two = variance_factor(misfit, np.zeros(3, dtype=np.int64), 0.25)
    np.testing.assert_array_equal(two, np.full(3, two[0]))
    assert degrees_of_misfit(np.array([[0, -1, 2], [0, 1, 2]])).tolist() == [0, 2]


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(1e-3, 1e3), factor=st.floats(0.1, 20.0))
def test_variances_grow_across_and_stay_along(seed: int, size: float, factor: float) -> None:
    rng = np.random.default_rng(seed)
    ends, root = size * rng.normal(size=(1, 2, 3)), rng.normal(size=(1, 6, 6))
    covariance = root @ root.mT
    scaled = scale_covariance_of_lines(ends, covariance, np.array([factor]))
    direction = (ends[0, 1] - ends[0, 0]) / np.linalg.norm(ends[0, 1] - ends[0, 0])
    across = np.linalg.svd(direction[None])[2][1:]
    both, along = np.kron(np.eye(2), across), np.kron(np.eye(2), direction)
    np.testing.assert_allclose(
        both @ scaled[0] @ both.T, factor * both @ covariance[0] @ both.T, rtol=1e-9, atol=1e-9
    )
    np.testing.assert_allclose(
        along @ scaled[0] @ along.T, along @ covariance[0] @ along.T, rtol=1e-9, atol=1e-9
    )
    back = scale_covariance_of_lines(ends, scaled, np.array([1 / factor]))
    np.testing.assert_allclose(back, covariance, rtol=1e-7, atol=1e-7)


def uneven_matches(seed: int, views: tuple[str, ...]) -> Matches:
    """Matches of lines, one in six of which has errors five times as large as the others."""
    rig, lines = rig_of("upper", "left", "right"), loose_lines(60, seed=seed)
    exact, rng = pictures(rig, lines), np.random.default_rng(seed)
    sigma = 0.2 * np.where(rng.random(len(lines)) < 1 / 6, 5.0, 1.0)
    pictures_px = {
        v: ends + sigma[:, None, None] * rng.normal(size=ends.shape) for v, ends in exact.items()
    }
    return match_segments({view: pictures_px[view] for view in views}, rig, sigma_px=SIGMA_PX)


def test_matches_learn_the_tail_in_any_order_of_views() -> None:
    names = "upper", "left", "right"
    first = uneven_matches(30, names)
    other = uneven_matches(30, names[::-1])
    assert first.noise_tail > 0.02
    assert first.noise_tail == pytest.approx(other.noise_tail, rel=1e-9)
    same = [np.lexsort(matches.lines_mm.reshape(-1, 6).T) for matches in (first, other)]
    np.testing.assert_allclose(
        first.covariance_mm2[same[0]], other.covariance_mm2[same[1]], rtol=1e-5, atol=1e-9
    )
