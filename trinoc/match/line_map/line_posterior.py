"""Where lines are, given segments of which some err by more than they say.

Each segment errs by one of a few factors times what it states, and which is not known. Given the
factors, a line is a least squares fit; its posterior is the mixture of these fits, each as likely
as it makes the segments. Where views agree it is hardly wider than the fit. Where they disagree it
reaches as far as any of them may be right, and where only two views show a line, nothing tells:
then it has the variance that segments have on the average.
"""

from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.line_map.line_fit import LineFragments, line_residuals
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.line_map import CollinearTuning
from trinoc.numerics.vectors import complete_axes

# numerical: of lines of more segments than this, factors are tried that differ from the likeliest
# in two.
ALL_FACTORS_TO = 4
# numerical: see above.
PAIRS_TO = 16
# numerical: a guard of the logarithm.
LEAST_POSTERIOR = 1e-6


class LinePosteriors(NamedTuple):
    """Mean and covariance across of lines at the places they were asked for.

    ends_mm : moved across only. covariance_mm2 : of the ends, nothing along the line.
    """

    ends_mm: Float[np.ndarray, "e 2 3"]
    covariance_mm2: Float[np.ndarray, "e 6 6"]


class _Equations(NamedTuple):
    """Of lines of as many segments each, every segment's part: of the information, of the
    gradient, and its square. `lines` : which lines they are."""

    lines: Int[np.ndarray, "l"]
    information: Float[np.ndarray, "l n 4 4"]
    gradient: Float[np.ndarray, "l n 4"]
    square: Float[np.ndarray, "l n"]


class _Answer(NamedTuple):
    """Of each line: mean and covariance of its four offsets."""

    offset: Float[np.ndarray, "l 4"]
    covariance: Float[np.ndarray, "l 4 4"]


def line_posteriors(
    shown: list[LineFragments],
    ends_mm: Float[np.ndarray, "e 2 3"],
    posterior: Float[np.ndarray, "e"],
    tail: float = 0.0,
    tuning: CollinearTuning = DEFAULT.collinear,
) -> LinePosteriors:
    """Lines near their ends, each with the segments that show it and the posterior of the match;
    `tail` is the `noise_tail` of the matches.

    Where a match is wrong, a segment of it is of another edge beside: it errs by the widest.
    """
    way = ends_mm[:, 1] - ends_mm[:, 0]
    axes = complete_axes(way / np.linalg.norm(way, axis=1, keepdims=True))
    equations = _equations(shown, ends_mm, axes)
    # None is surely wrong: every factor keeps a share.
    right = np.maximum(posterior, LEAST_POSTERIOR)[:, None]
    scales, shares = np.array(tuning.error_scales), shares_of_tail(tail, tuning)
    of_line = right * shares + (1 - right) * np.array([0.0, 0.0, 1.0])
    ends, covariance = ends_mm.copy(), np.zeros((len(ends_mm), 6, 6))
    for group in equations:
        answer = _answer(group, of_line[group.lines], scales)
        across = axes[group.lines]
        ends[group.lines] += answer.offset.reshape(-1, 2, 2) @ across
        spread = answer.covariance.reshape(-1, 2, 2, 2, 2)
        spread = np.einsum("lai,leafb,lbj->leifj", across, spread, across)
        covariance[group.lines] = spread.reshape(-1, 6, 6)
    return LinePosteriors(ends, covariance)


def shares_of_tail(
    tail: float, tuning: CollinearTuning = DEFAULT.collinear
) -> Float[np.ndarray, "3"]:
    """How often segments err by each factor."""
    more = np.clip(tail / tuning.error_tail, 1.0, tuning.most_error_shares)
    larger = more * np.array(tuning.error_shares[1:])
    return np.concatenate([[1 - larger.sum()], larger])


def _equations(
    shown: list[LineFragments], ends_mm: Float[np.ndarray, "e 2 3"], axes: np.ndarray
) -> list[_Equations]:
    """All lines of two segments, all of three, and so on; those of many one by one."""
    counts = np.array([len(each.ends_px) for each in shown], dtype=np.int64)
    groups = [np.flatnonzero(counts == count) for count in np.unique(counts)]
    few = [group for group in groups if counts[group[0]] <= ALL_FACTORS_TO]
    many = np.flatnonzero(counts > ALL_FACTORS_TO)[:, None]
    found = []
    for lines in (*few, *many):
        parts = [line_residuals(shown[line], ends_mm[line], axes[line]) for line in lines]
        residual = np.concatenate([part.residual for part in parts])
        jacobian = np.concatenate([part.jacobian for part in parts])
        gradient = (jacobian.mT @ residual[..., None])[..., 0]
        square = (residual**2).sum(axis=2)
        found.append(_Equations(lines, jacobian.mT @ jacobian, gradient, square))
    return found


def _answer(
    equations: _Equations, shares: Float[np.ndarray, "l 3"], scales: Float[np.ndarray, "3"]
) -> _Answer:
    """The mixture over factors, as its mean and covariance."""
    factors = _likely_factors(equations, shares, scales)
    log_weight, offset, covariance = _fits(equations, factors, shares, scales)
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    mean = np.einsum("lk,lka->la", weight, offset)
    spread = np.einsum("lk,lkab->lab", weight, covariance)
    apart = offset - mean[:, None]
    spread += (weight[..., None] * apart).mT @ apart
    return _Answer(mean, spread)


def _fits(
    equations: _Equations,
    factors: Int[np.ndarray, "k n"],
    shares: Float[np.ndarray, "l 3"],
    scales: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "l k"], Float[np.ndarray, "l k 4"], Float[np.ndarray, "l k 4 4"]]:
    """(log likelihood, the line integrated out; best offsets; their covariance) for factors."""
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
    """All combinations of few segments; of the many of one line, the likeliest and its like."""
    count, kinds = equations.square.shape[1], len(scales)
    if count <= ALL_FACTORS_TO:
        return np.array(list(product(range(kinds), repeat=count)))
    here = np.zeros(count, dtype=np.int64)
    while True:
        around = _neighbouring_factors(here, kinds)
        best = around[np.argmax(_fits(equations, around, shares, scales)[0][0])]
        if (best == here).all():
            return around
        here = best


def _neighbouring_factors(here: Int[np.ndarray, "n"], kinds: int) -> Int[np.ndarray, "k n"]:
    """These factors, and those that differ in one place or two."""
    count = len(here)
    places = [(), *((i,) for i in range(count))]
    if count <= PAIRS_TO:
        places += combinations(range(count), 2)
    found = []
    for chosen in places:
        others = [[kind for kind in range(kinds) if kind != here[i]] for i in chosen]
        for values in product(*others):
            there = here.copy()
            there[list(chosen)] = values
            found.append(there)
    return np.array(found)
