"""From what each triple says to how likely it is: the mixtures, and their learning by EM."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import expit, logsumexp

from trinoc.match.ends import USUAL_SHARES

# Real segments have heavy tails: their error is the stated one times one of these.
TAIL_SCALES = np.array([0.2, 0.6, 1.0, 2.0, 4.0])
USUAL_TAIL = np.array([0.05, 0.25, 0.5, 0.15, 0.05])
# A component that no accepted candidate shows keeps this share.
LEAST_SHARE = 1e-3
# Of the spread of lines, so that lines of one plane leave a volume.
THINNEST = 0.05


class Habits(NamedTuple):
    """What is learned from the pictures at hand.

    tail : share of each of TAIL_SCALES. ends : share of each end component.
    log_line_density : log of lines in space per volume (mm^3) and direction (2 pi).
    """

    tail: Float[np.ndarray, "k"]
    ends: Float[np.ndarray, "c"]
    log_line_density: float


def log_odds(
    chi_square: Float[np.ndarray, "m"],
    log_density: Float[np.ndarray, "m"],
    end_log: Float[np.ndarray, "m 2 c"],
    habits: Habits,
) -> Float[np.ndarray, "m"]:
    """Log odds that each triple is one line rather than three strangers."""
    tail = logsumexp(_tail_terms(chi_square, habits.tail), axis=1)
    ends = logsumexp(end_log + np.log(habits.ends), axis=2).sum(axis=1)
    return habits.log_line_density + log_density + tail + ends


def learn(
    chi_square: Float[np.ndarray, "m"],
    end_log: Float[np.ndarray, "m 2 c"],
    middles_mm: Float[np.ndarray, "m 3"],
    posterior: Float[np.ndarray, "m"],
    habits: Habits,
) -> Habits:
    """One round of expectation maximisation, given how likely each triple is now."""
    tail_terms = _tail_terms(chi_square, habits.tail)
    tail = np.exp(tail_terms - logsumexp(tail_terms, axis=1, keepdims=True))
    return Habits(
        _shares(posterior @ tail, USUAL_TAIL),
        _shares(posterior @ _responsibilities(end_log, habits.ends), USUAL_SHARES),
        log_line_density(middles_mm, posterior),
    )


def log_line_density(
    middles_mm: Float[np.ndarray, "m 3"], posterior: Float[np.ndarray, "m"]
) -> float:
    """Expected number of lines over the volume they fill, and over the directions (2 pi)."""
    count = posterior.sum() + 1e-9
    centred = middles_mm - posterior @ middles_mm / count
    spread = np.einsum("m,mi,mj->ij", posterior, centred, centred) / count
    variance = np.linalg.eigvalsh(spread)
    variance = np.maximum(variance, THINNEST**2 * variance.max() + 1e-30)
    # Of a box, each side is sqrt(12) standard deviations.
    volume_root = 0.5 * np.log(12 * variance).sum()
    return float(np.log(max(count, 1.0)) - volume_root - np.log(2 * np.pi))


def _responsibilities(end_log, shares):
    terms = end_log + np.log(shares)
    return np.exp(terms - logsumexp(terms, axis=2, keepdims=True)).sum(axis=1)


def _tail_terms(
    chi_square: Float[np.ndarray, "m"], shares: Float[np.ndarray, "k"]
) -> Float[np.ndarray, "m k"]:
    variance = TAIL_SCALES**2
    return np.log(shares / (2 * np.pi * variance)) - chi_square[:, None] / (2 * variance)


def _shares(weights: Float[np.ndarray, "k"], usual: Float[np.ndarray, "k"]) -> np.ndarray:
    # The usual shares count as ten observations, so that few lines do not teach nonsense.
    shares = weights + 10 * usual
    return np.maximum(shares / shares.sum(), LEAST_SHARE)


def probability(log_odds: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    """Odds to probability, without overflow."""
    return expit(log_odds)
