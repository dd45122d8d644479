"""EM raises the likelihood and recovers the parameters of the simulated data."""

import numpy as np
import pytest

from trinoc.match.evidence.endpoints import END_COMPONENTS
from trinoc.match.evidence.mixture import (
    MixtureParameters,
    Volume,
    em_step,
    fit_volume,
    log_odds,
    log_position_density,
    prior_parameters,
    probability,
)
from trinoc.match.evidence.side_intensity import SIDE_COMPONENTS
from trinoc.match.tuning.every_group import DEFAULT

PRIOR_SHARES = np.array(DEFAULT.ends.prior_shares)
PRIOR_TAIL = np.array(DEFAULT.evidence.prior_tail)
TAIL_SCALES = np.array(DEFAULT.evidence.tail_scales)
PRIOR_SIDES = np.array(DEFAULT.sides.prior_shares)


COUNT = 6000
BOX_MM = np.array([100.0, 60.0, 30.0])
TAIL = np.array([0.15, 0.1, 0.45, 0.1, 0.2])
# Pseudo-observations of the prior shares.
USUAL = 10


class Made:
    """Triples drawn with known shares of the components; one sixth are no triples."""

    def __init__(self) -> None:
        rng = np.random.default_rng(8)
        self.posterior = np.where(np.arange(COUNT) % 6 == 0, 0.0, 1.0)
        scale = TAIL_SCALES[rng.choice(len(TAIL), COUNT, p=TAIL)]
        self.chi_square = scale**2 * rng.chisquare(2, COUNT)
        self.ends = rng.dirichlet(np.full(END_COMPONENTS, 5.0))
        self.end_log = self.outcomes(rng, self.ends, 2)
        self.sides = rng.dirichlet(np.full(len(SIDE_COMPONENTS), 5.0))
        self.side_log = self.outcomes(rng, self.sides, 1)[:, 0]
        self.middle = rng.uniform(-0.5, 0.5, (COUNT, 3)) * BOX_MM + [10, 20, 30]
        half = rng.normal(0, 4, (COUNT, 1, 3))
        self.ends_mm = self.middle[:, None] + np.concatenate([half, -half], axis=1)

    @staticmethod
    def outcomes(rng: np.random.Generator, shares: np.ndarray, columns: int) -> np.ndarray:
        """Log likelihoods: a component yields its own outcome in four of five draws, else any."""
        kinds = len(shares)
        drawn = rng.choice(kinds, (COUNT, columns), p=shares)
        astray = rng.random(drawn.shape) < 0.2
        drawn = np.where(astray, rng.integers(0, kinds, drawn.shape), drawn)
        chance = 0.8 * np.eye(kinds) + 0.2 / kinds
        return np.log(chance[drawn] * kinds)

    def step(self, mixture: MixtureParameters) -> MixtureParameters:
        return em_step(
            self.chi_square, self.end_log, self.ends_mm, self.side_log, self.posterior, mixture
        )

    def log_posterior(self, mixture: MixtureParameters) -> np.ndarray:
        """Log posterior of the shares of tail, ends and sides, including the priors."""
        variance = TAIL_SCALES**2
        tail = np.exp(-self.chi_square[:, None] / (2 * variance)) / (2 * np.pi * variance)
        ends, sides = np.exp(self.end_log) @ mixture.ends, np.exp(self.side_log) @ mixture.sides
        data = [np.log(tail @ mixture.tail), np.log(ends).sum(axis=1), np.log(sides)]
        shares = (
            (mixture.tail, PRIOR_TAIL),
            (mixture.ends, PRIOR_SHARES),
            (
                mixture.sides,
                PRIOR_SIDES / PRIOR_SIDES.sum(),
            ),
        )
        return np.array(
            [
                self.posterior @ log_likelihood + USUAL * usual @ np.log(share)
                for log_likelihood, (share, usual) in zip(data, shares, strict=True)
            ]
        )


@pytest.fixture(scope="module")
def made() -> Made:
    return Made()


@pytest.fixture(scope="module")
def rounds(made: Made) -> list[MixtureParameters]:
    mixture = [prior_parameters(made.ends_mm, 500.0)]
    for _ in range(80):
        mixture.append(made.step(mixture[-1]))
    return mixture


def test_no_round_lowers_the_likelihood(made: Made, rounds: list[MixtureParameters]) -> None:
    log_posteriors = np.array([made.log_posterior(mixture) for mixture in rounds])
    assert (np.diff(log_posteriors, axis=0) > -1e-9 * np.abs(log_posteriors[1:])).all()
    assert (log_posteriors[10] > log_posteriors[0]).all()


def test_the_shares_that_made_the_data_are_learned(
    made: Made, rounds: list[MixtureParameters]
) -> None:
    learned, used = rounds[-1], made.posterior.sum()
    # Neighbouring scales overlap, and outcomes stray: the errors are a few of a plain count's.
    np.testing.assert_allclose(learned.tail, TAIL, atol=0.05)
    np.testing.assert_allclose(learned.ends, made.ends, atol=5 * np.sqrt(0.1 / used))
    np.testing.assert_allclose(learned.sides, made.sides, atol=5 * np.sqrt(0.15 / used))
    np.testing.assert_allclose(learned.log_count, np.log(used))
    np.testing.assert_allclose(learned.volume.log_size, np.log(BOX_MM.prod()), atol=0.05)
    np.testing.assert_allclose(learned.volume.centre_mm, [10, 20, 30], atol=2.0)


def test_shares_sum_to_one(rounds: list[MixtureParameters]) -> None:
    for mixture in rounds:
        for shares in (mixture.tail, mixture.ends, mixture.sides):
            np.testing.assert_allclose(shares.sum(), 1.0, atol=1e-2)
            assert (shares > 0).all()


def test_what_is_not_likely_teaches_nothing(made: Made, rounds: list[MixtureParameters]) -> None:
    some = made.posterior > 0
    alone = em_step(
        made.chi_square[some], made.end_log[some], made.ends_mm[some], made.side_log[some],
        made.posterior[some], rounds[0],
    )  # fmt: skip
    for one, other in zip(alone[:2], rounds[1][:2], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    np.testing.assert_allclose(alone.volume.centre_mm, rounds[1].volume.centre_mm)


def test_a_volume_turns_and_moves_with_the_world(made: Made) -> None:
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    here = fit_volume(made.ends_mm, made.posterior)
    there = fit_volume(made.ends_mm @ turn.T + [500.0, 0, -70], made.posterior)
    np.testing.assert_allclose(there.log_size, here.log_size, atol=1e-9)
    np.testing.assert_allclose(there.centre_mm, turn @ here.centre_mm + [500, 0, -70], atol=1e-9)
    np.testing.assert_allclose(there.precision, turn @ here.precision @ turn.T, atol=1e-12)


def test_log_odds_multiply_independent_evidence(made: Made) -> None:
    mixture = prior_parameters(made.ends_mm, 500.0)

    def odds(side_log: np.ndarray, log_density: float = 0.0) -> np.ndarray:
        density = np.full(COUNT, log_density)
        return log_odds(made.chi_square, density, made.end_log, made.ends_mm, side_log, mixture)

    plain = odds(np.zeros_like(made.side_log))
    sides = np.log(np.exp(made.side_log) @ mixture.sides)
    np.testing.assert_allclose(odds(made.side_log) - plain, sides, atol=1e-9)
    np.testing.assert_allclose(odds(made.side_log, 3.0) - odds(made.side_log), 3.0, atol=1e-9)
    doubled = mixture._replace(log_count=mixture.log_count + np.log(2))
    doubled_odds = log_odds(
        made.chi_square, np.zeros(COUNT), made.end_log, made.ends_mm, 0 * made.side_log, doubled
    )
    np.testing.assert_allclose(doubled_odds - plain, np.log(2), atol=1e-9)
    np.testing.assert_allclose(probability(plain) + probability(-plain), 1.0)


def test_places_are_uniform_in_the_box_and_gaussian_outside():
    volume = Volume(np.zeros(3), np.eye(3), np.log(1000.0))
    corner = DEFAULT.evidence.box_corner_sigmas
    reach = np.array([0.5, 0.9 * corner, np.sqrt(corner**2 + 2), np.sqrt(corner**2 + 6)])
    ends = np.zeros((4, 2, 3))
    ends[:, 0, 0] = reach
    inside, edge, outside, far_outside = log_position_density(ends, volume)
    assert np.exp(inside) == pytest.approx(1 / 1000 / (2 * np.pi))
    assert edge == inside
    np.testing.assert_allclose([inside - outside, inside - far_outside], [1.0, 3.0])
