"""Prior log odds of candidates from their log likelihood ratios, with mixtures estimated by EM.

In a stack of frames, each candidate has the parameters of its own `frame`. All parameters then
have a leading axis of frames.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.evidence import EvidenceTuning
from trinoc.numerics.joins import broadcast_groups, group_sums, take_groups

Frame = Int[np.ndarray, "m"] | None


class Volume(NamedTuple):
    """Density of lines in space: uniform in a box, with a thin tail outside.

    Attributes
    ----------
    centre_mm : (3,)
        Centre of the box.
    precision : (3, 3)
        Inverse covariance of the lines' midpoints, 1/mm^2.
    log_size : ()
        Log of the volume of the box, mm^3.
    """

    centre_mm: Float[np.ndarray, "*f 3"]
    precision: Float[np.ndarray, "*f 3 3"]
    log_size: Float[np.ndarray, "*f"] | float


class MixtureParameters(NamedTuple):
    """Weights of the mixtures in the evidence, and density of the lines, estimated by EM.

    In a stack of frames, all attributes have a leading axis of frames.

    Attributes
    ----------
    tail : (k,)
        Weight of each error scale in the heavy-tailed distribution of residuals.
    ends : (c,)
        Weight of each component of `end_evidence`.
    volume : Volume
        Density of lines in space.
    log_count : ()
        Log of the number of lines.
    sides : (s,)
        Weight of each component of `side_evidence`.
    """

    tail: Float[np.ndarray, "*f k"]
    ends: Float[np.ndarray, "*f c"]
    volume: Volume
    log_count: Float[np.ndarray, "*f"] | float
    sides: Float[np.ndarray, "*f s"]


def prior_parameters(
    ends_mm: Float[np.ndarray, "m 2 3"],
    count: Float[np.ndarray, "f"] | float,
    tuning: MatchTuning = DEFAULT,
    frame: Frame = None,
) -> MixtureParameters:
    """Return the mixture parameters before the first EM step.

    All candidates are assumed equally likely, with `count` lines among them.
    """
    frames = np.size(count)
    candidate_count = group_sums(np.ones(len(ends_mm)), frame, frames)
    share = np.minimum(1.0, count / np.maximum(candidate_count, 1))
    posterior = np.broadcast_to(broadcast_groups(share, frame), len(ends_mm))

    def broadcast_shares(shares: tuple[float, ...]) -> np.ndarray:
        return np.broadcast_to(_normalise(shares), (*np.shape(candidate_count), len(shares)))

    return MixtureParameters(
        broadcast_shares(tuning.evidence.prior_tail),
        broadcast_shares(tuning.ends.prior_shares),
        fit_volume(ends_mm, posterior, tuning.evidence, frame, frames),
        np.log(np.maximum(share * candidate_count, 1.0)),
        broadcast_shares(tuning.sides.prior_shares),
    )


def log_position_density(
    ends_mm: Float[np.ndarray, "m 2 3"],
    volume: Volume,
    tuning: EvidenceTuning = DEFAULT.evidence,
    frame: Frame = None,
) -> Float[np.ndarray, "m"]:
    """Return the log density of lines at the position of each candidate, (m,).

    The density is per mm^3 of position and per steradian of direction. All directions of a line
    together are 2 pi steradian.
    """
    volume = Volume(*(broadcast_groups(field, frame) for field in volume))
    centred = ends_mm - np.expand_dims(volume.centre_mm, -2)
    square = np.zeros(len(ends_mm))
    for e in range(2):
        end = centred[:, e]
        square = np.maximum(square, (_multiply_rows(end, volume.precision) * end).sum(axis=1))
    # The corners of a box lie three standard deviations from its centre. Few lines lie outside.
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
    frame: Frame = None,
) -> Float[np.ndarray, "m"]:
    """Return the log odds of each candidate, one line against clutter, (m,).

    The result includes the prior and the evidence of position, ends and grey levels beside the
    segments. Competing candidates and junctions are not considered.
    """
    tail = np.log(np.exp(_tail_terms(chi_square, mixture.tail, tuning, frame)).sum(axis=1))
    ends = _log_mixture(end_log, broadcast_groups(mixture.ends, frame)).sum(axis=1)
    prior = broadcast_groups(mixture.log_count, frame) + log_position_density(
        ends_mm, mixture.volume, tuning, frame
    )
    sides = log_sides(side_log, mixture, frame)
    return prior + log_density + tail + ends + tuning.log_odds_offset + sides


def temper(
    posterior_log_odds: Float[np.ndarray, "m"],
    side_log: Float[np.ndarray, "m s"],
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Float[np.ndarray, "m"]:
    """Multiply log odds by a factor below 1 if the grey levels beside the segments are known.

    Other candidates keep their log odds.
    """
    tempered = tuning.temperature * posterior_log_odds
    return np.where(side_log.any(axis=1), tempered, posterior_log_odds)


def log_sides(
    side_log: Float[np.ndarray, "m s"], mixture: MixtureParameters, frame: Frame = None
) -> Float[np.ndarray, "m"]:
    """Log likelihood ratio of the grey levels beside the segments, (m,); 0 if they are unknown.

    The components of `side_evidence` have the weights `mixture.sides`.
    """
    if not side_log.any():
        return np.zeros(len(side_log))
    mixed = _log_mixture(side_log[:, None], broadcast_groups(mixture.sides, frame))[:, 0]
    return np.where(side_log.any(axis=1), mixed, 0.0)


def em_step(
    chi_square: Float[np.ndarray, "m"],
    end_log: Float[np.ndarray, "m 2 c"],
    ends_mm: Float[np.ndarray, "m 2 3"],
    side_log: Float[np.ndarray, "m s"],
    posterior: Float[np.ndarray, "m"],
    mixture: MixtureParameters,
    tuning: MatchTuning = DEFAULT,
    frame: Frame = None,
) -> MixtureParameters:
    """Run one step of expectation maximisation, and return the updated mixture parameters.

    `posterior` (m,) is the current probability of each candidate, given its competing candidates
    and junctions.
    """
    evidence, frames = tuning.evidence, np.size(mixture.log_count)
    rows = np.flatnonzero(posterior > evidence.negligible_posterior)
    weight, frame, side_log = posterior[rows], take_groups(frame, rows), side_log[rows]

    def learn_shares(
        log_terms: Float[np.ndarray, "n e k"], weight: np.ndarray, prior: np.ndarray
    ) -> np.ndarray:
        terms = np.exp(log_terms - log_terms.max(axis=2, keepdims=True))
        responsibility = (terms / terms.sum(axis=2, keepdims=True)).sum(axis=1)
        return _shares(group_sums(weight[:, None] * responsibility, frame, frames), prior, evidence)

    def log_shares(shares: np.ndarray) -> np.ndarray:
        return np.expand_dims(broadcast_groups(np.log(shares), frame), -2)

    weight_of_sides = weight * side_log.any(axis=1)
    prior_sides = _normalise(tuning.sides.prior_shares)
    tail = _tail_terms(chi_square[rows], mixture.tail, evidence, frame)
    return MixtureParameters(
        learn_shares(tail[:, None], weight, np.array(evidence.prior_tail)),
        learn_shares(
            end_log[rows] + log_shares(mixture.ends), weight, np.array(tuning.ends.prior_shares)
        ),
        fit_volume(ends_mm[rows], weight, evidence, frame, frames),
        np.log(np.maximum(group_sums(weight, frame, frames), 1.0)),
        learn_shares(side_log[:, None] + log_shares(mixture.sides), weight_of_sides, prior_sides),
    )


def fit_volume(
    ends_mm: Float[np.ndarray, "m 2 3"],
    posterior: Float[np.ndarray, "m"],
    tuning: EvidenceTuning = DEFAULT.evidence,
    frame: Frame = None,
    frames: int = 1,
) -> Volume:
    """Fit the box of `Volume` to the mean and covariance of the lines' midpoints.

    Each candidate has its posterior as weight. `frames` is the number of frames of the stack.
    """
    middles = (ends_mm[:, 0] + ends_mm[:, 1]) / 2
    count = np.expand_dims(group_sums(posterior, frame, frames) + 1e-9, -1)
    centre = group_sums(posterior[:, None] * middles, frame, frames) / count
    centred = middles - broadcast_groups(centre, frame)
    if frame is None:
        spread = (posterior[:, None] * centred).T @ centred / count[..., None]
    else:
        square = posterior[:, None, None] * centred[:, :, None] * centred[:, None, :]
        spread = group_sums(square, frame, frames) / count[..., None]
    variance, axes = np.linalg.eigh(spread)
    largest = variance.max(axis=-1, keepdims=True)
    variance = np.maximum(variance, tuning.min_thickness_share**2 * largest + 1e-30)
    # Each side of a box is sqrt(12) standard deviations.
    log_size = 0.5 * np.log(12 * variance).sum(axis=-1)
    return Volume(centre, (axes / variance[..., None, :]) @ axes.mT, log_size)


def _multiply_rows(
    rows: Float[np.ndarray, "m a"], matrix: Float[np.ndarray, "*m a b"]
) -> np.ndarray:
    """Multiply each row (a,) by one common matrix (a, b), or row k by matrix k of (m, a, b)."""
    if matrix.ndim == 2:
        return rows @ matrix
    return np.einsum("ma,mab->mb", rows, matrix)


def _log_mixture(
    log_terms: Float[np.ndarray, "m e c"], shares: Float[np.ndarray, "*m c"]
) -> Float[np.ndarray, "m e"]:
    highest = log_terms.max(axis=2)
    terms = np.exp(log_terms - highest[..., None])
    mixed = [_multiply_rows(terms[:, e], shares[..., None])[:, 0] for e in range(terms.shape[1])]
    return highest + np.log(np.stack(mixed, axis=1))


def _tail_terms(
    chi_square: Float[np.ndarray, "m"],
    shares: Float[np.ndarray, "*f k"],
    tuning: EvidenceTuning,
    frame: Frame,
) -> Float[np.ndarray, "m k"]:
    variance = np.array(tuning.tail_scales) ** 2
    height = broadcast_groups(np.log(shares / (2 * np.pi * variance)), frame)
    return height - chi_square[:, None] / (2 * variance)


def _shares(
    weights: Float[np.ndarray, "*f k"], prior: Float[np.ndarray, "k"], tuning: EvidenceTuning
) -> Float[np.ndarray, "*f k"]:
    # Dirichlet prior, which matters in scenes with few lines: prior shares count as observations.
    shares = weights + tuning.prior_observations * prior
    return np.maximum(shares / shares.sum(axis=-1, keepdims=True), tuning.min_share)


def _normalise(shares: tuple[float, ...]) -> np.ndarray:
    return np.array(shares) / np.sum(shares)


def probability(log_odds: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    """Convert log odds to probabilities, without overflow."""
    return scipy.special.expit(log_odds)
