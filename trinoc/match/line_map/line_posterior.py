"""Posterior of lines in space, given segments of which some have larger errors than stated.

The error of each segment has the stated standard deviation times an unknown factor, one of a few
values. If the factors are known, the line is a least-squares fit. The posterior of a line is the
mixture of these fits, weighted by the likelihood of the segments. If the views agree, the posterior
is hardly wider than one fit. If the views disagree, the posterior covers every view that may be
right. If only two views show a line, nothing indicates the factors, and the variance is the mean
one of all segments.
"""

from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.line_map.line_fit import LineFragments, line_residuals
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.line_map import CollinearTuning
from trinoc.numerics.vectors import complete_axes

# numerical: up to this number of segments, all combinations of factors are evaluated. Above it,
# only those that differ from the most likely one for at most two segments.
ALL_FACTORS_TO = 4
# numerical: above this number of segments, combinations differ for at most one segment.
PAIRS_TO = 16
# numerical: avoids the logarithm of 0.
MIN_POSTERIOR = 1e-6


class LinePosteriors(NamedTuple):
    """Posterior mean and covariance of lines, each represented by two points.

    Attributes
    ----------
    ends_mm : (e, 2, 3)
        The two points, moved only perpendicular to the line.
    covariance_mm2 : (e, 6, 6)
        Covariance of both points; the part along the line is 0.
    """

    ends_mm: Float[np.ndarray, "e 2 3"]
    covariance_mm2: Float[np.ndarray, "e 6 6"]


class _Equations(NamedTuple):
    """Normal equations of l lines with n segments each, separately for every segment.

    The four unknowns of a line are the offsets of its two points along two axes.

    Attributes
    ----------
    lines : (l,)
        Indices of the lines.
    information : (l, n, 4, 4)
        J' J of the whitened residuals of each segment.
    gradient : (l, n, 4)
        J' r of each segment.
    square : (l, n)
        r' r of each segment.
    """

    lines: Int[np.ndarray, "l"]
    information: Float[np.ndarray, "l n 4 4"]
    gradient: Float[np.ndarray, "l n 4"]
    square: Float[np.ndarray, "l n"]


class _Posterior(NamedTuple):
    """Posterior mean (l, 4) and covariance (l, 4, 4) of the four unknown offsets of each line."""

    offset: Float[np.ndarray, "l 4"]
    covariance: Float[np.ndarray, "l 4 4"]


def line_posteriors(
    fragments: list[LineFragments],
    ends_mm: Float[np.ndarray, "e 2 3"],
    posterior: Float[np.ndarray, "e"],
    tail: float = 0.0,
    tuning: CollinearTuning = DEFAULT.collinear,
) -> LinePosteriors:
    """Compute the posterior of each line from its segments and an initial line.

    Parameters
    ----------
    fragments : list of LineFragments
        Segments of each line.
    ends_mm : (e, 2, 3)
        Two points of each initial line.
    posterior : (e,)
        Probability that the match is right. A wrong match contains a segment of a neighbouring
        edge, whose error has the largest scale of the mixture.
    tail : float
        `Matches.noise_tail`: inequality of the tracks' errors, 0 for normal errors.
    tuning : CollinearTuning
        Tuned constants.
    """
    step = ends_mm[:, 1] - ends_mm[:, 0]
    axes = complete_axes(step / np.linalg.norm(step, axis=1, keepdims=True))
    equations = _equations(fragments, ends_mm, axes)
    # No match is surely wrong, so that every factor has a share.
    match_posterior = np.maximum(posterior, MIN_POSTERIOR)[:, None]
    scales, shares = np.array(tuning.error_scales), shares_of_tail(tail, tuning)
    shares_of_line = match_posterior * shares + (1 - match_posterior) * np.array([0.0, 0.0, 1.0])
    ends, covariance = ends_mm.copy(), np.zeros((len(ends_mm), 6, 6))
    for group in equations:
        offsets = _line_posterior(group, shares_of_line[group.lines], scales)
        across = axes[group.lines]
        ends[group.lines] += offsets.offset.reshape(-1, 2, 2) @ across
        spread = offsets.covariance.reshape(-1, 2, 2, 2, 2)
        spread = np.einsum("lai,leafb,lbj->leifj", across, spread, across)
        covariance[group.lines] = spread.reshape(-1, 6, 6)
    return LinePosteriors(ends, covariance)


def shares_of_tail(
    tail: float, tuning: CollinearTuning = DEFAULT.collinear
) -> Float[np.ndarray, "3"]:
    """Return the probability of each of the three error scales of a segment, (3,).

    `tail` is `Matches.noise_tail`, the inequality of the tracks' errors.
    """
    factor = np.clip(tail / tuning.error_tail, 1.0, tuning.max_share_factor)
    large_shares = factor * np.array(tuning.error_shares[1:])
    return np.concatenate([[1 - large_shares.sum()], large_shares])


def _equations(
    fragments: list[LineFragments], ends_mm: Float[np.ndarray, "e 2 3"], axes: np.ndarray
) -> list[_Equations]:
    """Build the normal equations of all lines.

    Lines with equally few segments are processed together. Each line with more than ALL_FACTORS_TO
    segments is processed alone.
    """
    counts = np.array([len(line_fragments.ends_px) for line_fragments in fragments], dtype=np.int64)
    groups = [np.flatnonzero(counts == count) for count in np.unique(counts)]
    small_groups = [group for group in groups if counts[group[0]] <= ALL_FACTORS_TO]
    large_lines = np.flatnonzero(counts > ALL_FACTORS_TO)[:, None]
    equations = []
    for lines in (*small_groups, *large_lines):
        parts = [line_residuals(fragments[line], ends_mm[line], axes[line]) for line in lines]
        residual = np.concatenate([part.residual for part in parts])
        jacobian = np.concatenate([part.jacobian for part in parts])
        gradient = (jacobian.mT @ residual[..., None])[..., 0]
        square = (residual**2).sum(axis=2)
        equations.append(_Equations(lines, jacobian.mT @ jacobian, gradient, square))
    return equations


def _line_posterior(
    equations: _Equations, shares: Float[np.ndarray, "l 3"], scales: Float[np.ndarray, "3"]
) -> _Posterior:
    """Compute the mean and covariance of the mixture over the probable error scales of all
    segments.

    `shares` are the probabilities of the three error `scales`, for each line.
    """
    factors = _likely_factors(equations, shares, scales)
    log_weight, offset, covariance = _fit_combinations(equations, factors, shares, scales)
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    mean = np.einsum("lk,lka->la", weight, offset)
    spread = np.einsum("lk,lkab->lab", weight, covariance)
    deviation = offset - mean[:, None]
    spread += (weight[..., None] * deviation).mT @ deviation
    return _Posterior(mean, spread)


def _fit_combinations(
    equations: _Equations,
    factors: Int[np.ndarray, "k n"],
    shares: Float[np.ndarray, "l 3"],
    scales: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "l k"], Float[np.ndarray, "l k 4"], Float[np.ndarray, "l k 4 4"]]:
    """Fit each line for every combination of error scales of its n segments.

    `factors` (k, n) are k combinations, as indices of `scales`. Returns (log likelihood with the
    line integrated out, offsets, covariance).
    """
    scale = scales[factors]
    weight = scale**-2
    covariance = np.linalg.inv(np.einsum("kn,lnab->lkab", weight, equations.information))
    gradient = weight @ equations.gradient
    offset = -(covariance @ gradient[..., None])[..., 0]
    square = equations.square @ weight.T + (gradient * offset).sum(axis=2)
    density = np.log(shares)[:, factors].sum(axis=2) - 2 * np.log(scale).sum(axis=1)
    log_weight = density - square / 2 + np.linalg.slogdet(covariance)[1] / 2
    return log_weight, offset, covariance


def _likely_factors(
    equations: _Equations, shares: Float[np.ndarray, "l 3"], scales: Float[np.ndarray, "3"]
) -> Int[np.ndarray, "k n"]:
    """Return the combinations of error scales to evaluate, (k, n) indices of `scales`.

    For few segments, all combinations are returned. For many segments, the most probable
    combination is returned, with all combinations that differ for one or two segments.
    """
    count, kinds = equations.square.shape[1], len(scales)
    if count <= ALL_FACTORS_TO:
        return np.array(list(product(range(kinds), repeat=count)))
    current = np.zeros(count, dtype=np.int64)
    while True:
        neighbours = _neighbouring_factors(current, kinds)
        best = neighbours[np.argmax(_fit_combinations(equations, neighbours, shares, scales)[0][0])]
        if (best == current).all():
            return neighbours
        current = best


def _neighbouring_factors(current: Int[np.ndarray, "n"], kinds: int) -> Int[np.ndarray, "k n"]:
    """Return the combination of error scales `current`, and its neighbours.

    A neighbour has other error scales for one or two segments. For many segments, only neighbours
    that differ for one segment are returned. `kinds` is the number of error scales.
    """
    count = len(current)
    changed_sets = [(), *((i,) for i in range(count))]
    if count <= PAIRS_TO:
        changed_sets += combinations(range(count), 2)
    factor_rows = []
    for changed in changed_sets:
        alternatives = [[kind for kind in range(kinds) if kind != current[i]] for i in changed]
        for values in product(*alternatives):
            changed_factors = current.copy()
            changed_factors[list(changed)] = values
            factor_rows.append(changed_factors)
    return np.array(factor_rows)
