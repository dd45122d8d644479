"""Prior log odds of a triple from its log likelihood ratios: the mixtures, fitted by EM.

Triples of a stack of frames have the parameters of their own `frame`: then all parameters have an
axis of frames in front."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import expit

from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.evidence import EvidenceTuning
from trinoc.numerics.joins import broadcast_groups, group_sums, take_groups

Frame = Int[np.ndarray, "m"] | None


class Volume(NamedTuple):
    """Where lines are: uniform in a box about a centre, with a thin tail outside it.

    precision : inverse of the covariance of places, 1/mm^2. log_size : of the box, mm^3.
    """

    centre_mm: Float[np.ndarray, "*f 3"]
    precision: Float[np.ndarray, "*f 3 3"]
    log_size: Float[np.ndarray, "*f"] | float


class MixtureParameters(NamedTuple):
    """The mixture parameters, estimated from the images at hand.

    tail : share of each of the tail's scales. ends : share of each end component.
    volume : where lines are. log_count : log of their number. sides : share of each component
    of the levels beside them.
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
    """Before the first EM step: `count` lines among candidates that are all equally likely."""
    frames = np.size(count)
    number = group_sums(np.ones(len(ends_mm)), frame, frames)
    share = np.minimum(1.0, count / np.maximum(number, 1))
    posterior = np.broadcast_to(broadcast_groups(share, frame), len(ends_mm))

    def of_all(shares: tuple[float, ...]) -> np.ndarray:
        return np.broadcast_to(_normalise(shares), (*np.shape(number), len(shares)))

    return MixtureParameters(
        of_all(tuning.evidence.prior_tail),
        of_all(tuning.ends.prior_shares),
        fit_volume(ends_mm, posterior, tuning.evidence, frame, frames),
        np.log(np.maximum(share * number, 1.0)),
        of_all(tuning.sides.prior_shares),
    )


def log_place(
    ends_mm: Float[np.ndarray, "m 2 3"],
    volume: Volume,
    tuning: EvidenceTuning = DEFAULT.evidence,
    frame: Frame = None,
) -> Float[np.ndarray, "m"]:
    """Log density of a line at each place, per volume (mm^3) and direction (of 2 pi)."""
    volume = Volume(*(broadcast_groups(field, frame) for field in volume))
    centred = ends_mm - np.expand_dims(volume.centre_mm, -2)
    square = np.zeros(len(ends_mm))
    for e in range(2):
        own = centred[:, e]
        square = np.maximum(square, (_times(own, volume.precision) * own).sum(axis=1))
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
    frame: Frame = None,
) -> Float[np.ndarray, "m"]:
    """Log odds that each triple is one line rather than three segments of clutter."""
    tail = np.log(np.exp(_tail_terms(chi_square, mixture.tail, tuning, frame)).sum(axis=1))
    ends = _log_mixture(end_log, broadcast_groups(mixture.ends, frame)).sum(axis=1)
    prior = broadcast_groups(mixture.log_count, frame) + log_place(
        ends_mm, mixture.volume, tuning, frame
    )
    sides = log_sides(side_log, mixture, frame)
    return prior + log_density + tail + ends + tuning.log_odds_offset + sides


def temper(
    posterior_log_odds: Float[np.ndarray, "m"],
    side_log: Float[np.ndarray, "m s"],
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Float[np.ndarray, "m"]:
    """Tempered log odds: times the temperature where side intensities are known."""
    tempered = tuning.temperature * posterior_log_odds
    return np.where(side_log.any(axis=1), tempered, posterior_log_odds)


def log_sides(
    side_log: Float[np.ndarray, "m s"], mixture: MixtureParameters, frame: Frame = None
) -> Float[np.ndarray, "m"]:
    """Evidence of the levels beside the members, zero where they are not known."""
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
    """One round of expectation maximisation, given the current posterior of each triple."""
    evidence, frames = tuning.evidence, np.size(mixture.log_count)
    likely = np.flatnonzero(posterior > evidence.negligible)
    weight, frame, side_log = posterior[likely], take_groups(frame, likely), side_log[likely]

    def learn_shares(
        log_terms: Float[np.ndarray, "n e k"], weight: np.ndarray, prior: np.ndarray
    ) -> np.ndarray:
        terms = np.exp(log_terms - log_terms.max(axis=2, keepdims=True))
        responsibility = (terms / terms.sum(axis=2, keepdims=True)).sum(axis=1)
        return _shares(group_sums(weight[:, None] * responsibility, frame, frames), prior, evidence)

    def log_shares(shares: np.ndarray) -> np.ndarray:
        return np.expand_dims(broadcast_groups(np.log(shares), frame), -2)

    sides_known = weight * side_log.any(axis=1)
    prior_sides = _normalise(tuning.sides.prior_shares)
    tail = _tail_terms(chi_square[likely], mixture.tail, evidence, frame)
    return MixtureParameters(
        learn_shares(tail[:, None], weight, np.array(evidence.prior_tail)),
        learn_shares(
            end_log[likely] + log_shares(mixture.ends), weight, np.array(tuning.ends.prior_shares)
        ),
        fit_volume(ends_mm[likely], weight, evidence, frame, frames),
        np.log(np.maximum(group_sums(weight, frame, frames), 1.0)),
        learn_shares(side_log[:, None] + log_shares(mixture.sides), sides_known, prior_sides),
    )


def fit_volume(
    ends_mm: Float[np.ndarray, "m 2 3"],
    posterior: Float[np.ndarray, "m"],
    tuning: EvidenceTuning = DEFAULT.evidence,
    frame: Frame = None,
    frames: int = 1,
) -> Volume:
    """The box that has the spread of the lines' middles."""
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
    variance = np.maximum(variance, tuning.thinnest**2 * largest + 1e-30)
    # Of a box, each side is sqrt(12) standard deviations.
    log_size = 0.5 * np.log(12 * variance).sum(axis=-1)
    return Volume(centre, (axes / variance[..., None, :]) @ axes.mT, log_size)


def _times(rows: Float[np.ndarray, "m a"], matrix: Float[np.ndarray, "*m a b"]) -> np.ndarray:
    """Each row times the matrix of all, or its own: one product, or sums of columns, and not as
    many small products."""
    if matrix.ndim == 2:
        return rows @ matrix
    return np.einsum("ma,mab->mb", rows, matrix)


def _log_mixture(
    log_terms: Float[np.ndarray, "m e c"], shares: Float[np.ndarray, "*m c"]
) -> Float[np.ndarray, "m e"]:
    highest = log_terms.max(axis=2)
    terms = np.exp(log_terms - highest[..., None])
    mixed = [_times(terms[:, e], shares[..., None])[:, 0] for e in range(terms.shape[1])]
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
    # The prior shares count as observations: a Dirichlet prior, for scenes of few lines.
    shares = weights + tuning.prior_observations * prior
    return np.maximum(shares / shares.sum(axis=-1, keepdims=True), tuning.min_share)


def _normalise(shares: tuple[float, ...]) -> np.ndarray:
    return np.array(shares) / np.sum(shares)


def probability(log_odds: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    """Odds to probability, without overflow."""
    return expit(log_odds)
