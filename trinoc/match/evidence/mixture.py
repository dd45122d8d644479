"""Prior log odds of a triple from its log likelihood ratios: the mixtures, fitted by EM."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import expit, logsumexp

from trinoc.match.tuning import DEFAULT, EvidenceTuning, MatchTuning


class Volume(NamedTuple):
    """Where lines are: uniform in a box about a centre, with a thin tail outside it.

    precision : inverse of the covariance of places, 1/mm^2. log_size : of the box, mm^3.
    """

    centre_mm: Float[np.ndarray, "3"]
    precision: Float[np.ndarray, "3 3"]
    log_size: float


class MixtureParameters(NamedTuple):
    """The mixture parameters, estimated from the images at hand.

    tail : share of each of the tail's scales. ends : share of each end component.
    volume : where lines are. log_count : log of their number. sides : share of each component
    of the levels beside them.
    """

    tail: Float[np.ndarray, "k"]
    ends: Float[np.ndarray, "c"]
    volume: Volume
    log_count: float
    sides: Float[np.ndarray, "s"]


def prior_parameters(
    ends_mm: Float[np.ndarray, "m 2 3"], count: float, tuning: MatchTuning = DEFAULT
) -> MixtureParameters:
    """Before the first EM step: `count` lines among candidates that are all equally likely."""
    share = min(1.0, count / max(len(ends_mm), 1))
    posterior = np.full(len(ends_mm), share)
    return MixtureParameters(
        _normalised(tuning.evidence.prior_tail),
        _normalised(tuning.ends.prior_shares),
        volume_of(ends_mm, posterior, tuning.evidence),
        float(np.log(max(posterior.sum(), 1.0))),
        _normalised(tuning.sides.prior_shares),
    )


def log_place(
    ends_mm: Float[np.ndarray, "m 2 3"],
    volume: Volume,
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Float[np.ndarray, "m"]:
    """Log density of a line at each place, per volume (mm^3) and direction (of 2 pi)."""
    centred = ends_mm - volume.centre_mm
    square = np.einsum("mei,ij,mej->me", centred, volume.precision, centred).max(axis=1)
    # The corners of a box lie three standard deviations out; beyond is for the few.
    outside = 0.5 * np.clip(square - tuning.box_corner_sigmas**2, 0.0, tuning.box_cost)
    return -volume.log_size - np.log(2 * np.pi) - outside


def log_odds(
    chi_square: Float[np.ndarray, "m"],
    log_density: Float[np.ndarray, "m"],
    end_log: Float[np.ndarray, "m 2 c"],
    ends_mm: Float[np.ndarray, "m 2 3"],
    side_log: Float[np.ndarray, "m s"],
    mixture: MixtureParameters,
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Float[np.ndarray, "m"]:
    """Log odds that each triple is one line rather than three segments of clutter."""
    tail = np.logaddexp.reduce(_tail_terms(chi_square, mixture.tail, tuning), axis=1)
    ends = _log_mixture(end_log, mixture.ends).sum(axis=1)
    prior = mixture.log_count + log_place(ends_mm, mixture.volume, tuning)
    return prior + log_density + tail + ends + tuning.log_odds_offset + log_sides(side_log, mixture)


def temper(
    posterior_log_odds: Float[np.ndarray, "m"],
    side_log: Float[np.ndarray, "m s"],
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Float[np.ndarray, "m"]:
    """Tempered log odds: times the temperature where side intensities are known."""
    tempered = tuning.temperature * posterior_log_odds
    return np.where(side_log.any(axis=1), tempered, posterior_log_odds)


def log_sides(
    side_log: Float[np.ndarray, "m s"], mixture: MixtureParameters
) -> Float[np.ndarray, "m"]:
    """Evidence of the levels beside the members, zero where they are not known."""
    if not side_log.any():
        return np.zeros(len(side_log))
    mixed = _log_mixture(side_log[:, None], mixture.sides)[:, 0]
    return np.where(side_log.any(axis=1), mixed, 0.0)


def em_step(
    chi_square: Float[np.ndarray, "m"],
    end_log: Float[np.ndarray, "m 2 c"],
    ends_mm: Float[np.ndarray, "m 2 3"],
    side_log: Float[np.ndarray, "m s"],
    posterior: Float[np.ndarray, "m"],
    mixture: MixtureParameters,
    tuning: MatchTuning = DEFAULT,
) -> MixtureParameters:
    """One round of expectation maximisation, given the current posterior of each triple."""
    evidence = tuning.evidence
    likely = posterior > evidence.negligible
    weight = posterior[likely]
    tail_terms = _tail_terms(chi_square[likely], mixture.tail, evidence)
    tail = np.exp(tail_terms - logsumexp(tail_terms, axis=1, keepdims=True))
    return MixtureParameters(
        _shares(weight @ tail, np.array(evidence.prior_tail), evidence),
        _shares(
            weight @ _responsibilities(end_log[likely], mixture.ends),
            np.array(tuning.ends.prior_shares),
            evidence,
        ),
        volume_of(ends_mm[likely], weight, evidence),
        float(np.log(max(weight.sum(), 1.0))),
        _shares(
            (weight * side_log[likely].any(axis=1))
            @ _responsibilities(side_log[likely][:, None], mixture.sides),
            _normalised(tuning.sides.prior_shares),
            evidence,
        ),
    )


def volume_of(
    ends_mm: Float[np.ndarray, "m 2 3"],
    posterior: Float[np.ndarray, "m"],
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Volume:
    """The box that has the spread of the lines' middles."""
    middles = ends_mm.mean(axis=1)
    count = posterior.sum() + 1e-9
    centre = posterior @ middles / count
    centred = middles - centre
    spread = np.einsum("m,mi,mj->ij", posterior, centred, centred) / count
    variance, axes = np.linalg.eigh(spread)
    variance = np.maximum(variance, tuning.thinnest**2 * variance.max() + 1e-30)
    # Of a box, each side is sqrt(12) standard deviations.
    log_size = 0.5 * float(np.log(12 * variance).sum())
    return Volume(centre, (axes / variance) @ axes.T, log_size)


def _log_mixture(
    log_terms: Float[np.ndarray, "m e c"], shares: Float[np.ndarray, "c"]
) -> Float[np.ndarray, "m e"]:
    highest = log_terms.max(axis=2)
    return highest + np.log(np.exp(log_terms - highest[..., None]) @ shares)


def _responsibilities(end_log, shares):
    terms = end_log + np.log(shares)
    return np.exp(terms - logsumexp(terms, axis=2, keepdims=True)).sum(axis=1)


def _tail_terms(
    chi_square: Float[np.ndarray, "m"], shares: Float[np.ndarray, "k"], tuning: EvidenceTuning
) -> Float[np.ndarray, "m k"]:
    variance = np.array(tuning.tail_scales) ** 2
    return np.log(shares / (2 * np.pi * variance)) - chi_square[:, None] / (2 * variance)


def _shares(
    weights: Float[np.ndarray, "k"], prior: Float[np.ndarray, "k"], tuning: EvidenceTuning
) -> np.ndarray:
    # The prior shares count as observations: a Dirichlet prior, for scenes of few lines.
    shares = weights + tuning.prior_observations * prior
    return np.maximum(shares / shares.sum(), tuning.min_share)


def _normalised(shares: tuple[float, ...]) -> np.ndarray:
    return np.array(shares) / np.sum(shares)


def probability(log_odds: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    """Odds to probability, without overflow."""
    return expit(log_odds)
