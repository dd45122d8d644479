"""Which ends of lines meet in space, and which are near each other by chance."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from scipy.special import expit, log_expit, logit

from trinoc.match.evidence import log_gap_density, passing
from trinoc.match.line_map.density import line_density
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tuning import DEFAULT, MatchTuning
from trinoc.numerics import take_rows


class Ends(NamedTuple):
    """Ends of all lines, two per line.

    way : unit vectors out of the line. own_mm : the whole line of each, this end first;
        own_covariance : of those. px_per_mm : of the pictures.
    """

    point_mm: Float[np.ndarray, "n 3"]
    way: Float[np.ndarray, "n 3"]
    own_mm: Float[np.ndarray, "n 2 3"]
    own_covariance: Float[np.ndarray, "n 6 6"]
    px_per_mm: Float[np.ndarray, "n"]


def ends_of(joined: JoinedLines) -> Ends:
    """Both ends of every line, the first one first."""
    lines, covariance = joined.lines_mm, joined.covariance_mm2
    own = np.stack([lines, lines[:, ::-1]], axis=1).reshape(-1, 2, 3)
    turned = covariance.reshape(-1, 2, 3, 2, 3)[:, ::-1, :, ::-1].reshape(-1, 6, 6)
    own_covariance = np.stack([covariance, turned], axis=1).reshape(-1, 6, 6)
    way = own[:, 0] - own[:, 1]
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    return Ends(own[:, 0], way, own, own_covariance, np.repeat(joined.px_per_mm, 2))


def corner_candidates(
    ends: Ends, joined: JoinedLines, tuning: MatchTuning = DEFAULT
) -> tuple[Int[np.ndarray, "p 2"], Float[np.ndarray, "p"]]:
    """(pairs of ends that are likely to meet, log probability of each)."""
    if len(joined) < 2:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    rules = tuning.junctions
    # Both may stop short of the corner.
    reach = 2 * rules.reach_px / float(np.min(ends.px_per_mm))
    pairs = KDTree(ends.point_mm).query_pairs(reach, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // 2 != pairs[:, 1] // 2]
    m, n = np.sort(pairs, axis=1).T
    px_per_mm = np.stack([ends.px_per_mm[m], ends.px_per_mm[n]], axis=1)
    pass_by = passing(ends.point_mm[m], ends.way[m], ends.point_mm[n], ends.way[n])
    near = (np.abs(pass_by.gap_mm * px_per_mm) < rules.reach_px).all(axis=1)
    keep = (pass_by.sine > rules.smallest_sine) & near
    m, n, px_per_mm = m[keep], n[keep], px_per_mm[keep]
    distance, unit, sine, gap_mm = take_rows(pass_by, keep)
    variance = sum(
        np.einsum("pi,pij,pj->p", unit, carried(ends, end, length)[1][:, :3, :3], unit)
        for end, length in ((m, gap_mm[:, 0]), (n, gap_mm[:, 1]))
    )
    stop = np.exp(log_gap_density(gap_mm * px_per_mm, px_per_mm, np.array(rules.gaps_px)))
    count = len(ends.point_mm)
    density = count / line_density(joined.lines_mm, tuning.evidence).volume
    log_passing = -0.5 * (np.log(2 * np.pi * variance) + distance**2 / variance)
    odds = _learned_odds(m, n, log_passing - np.log(sine * density), stop, count, tuning)
    likely = log_likely(odds, joined.posterior[m // 2] * joined.posterior[n // 2])
    sure = likely >= np.log(tuning.corners.min_posterior)
    return np.stack([m, n], axis=1)[sure], likely[sure]


def log_likely(
    odds: Float[np.ndarray, "p"], right: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """Log probability that ends meet and their lines are right, `right` before they met.

    Lines of wrong matches meet others by chance only, so that what speaks for a corner speaks for
    its lines. It is tempered, as the wrong ones of one place have segments in common.
    """
    return log_expit(odds) + log_expit(odds / 2 + logit(right))


def _learned_odds(
    m: Int[np.ndarray, "p"],
    n: Int[np.ndarray, "p"],
    log_passing: Float[np.ndarray, "p"],
    stop: Float[np.ndarray, "p k"],
    count: int,
    tuning: MatchTuning,
) -> Float[np.ndarray, "p"]:
    """Log odds that ends m and n, of `count` in all, meet; how often ends do, and how far they
    stop from their corners, is learned from these themselves.

    `log_passing` is the evidence of how near the lines pass each other, `stop` the density of
    where both ends stop, for each scale of gaps.
    """
    prior, prior_gaps = tuning.junctions.prior_at_junction, np.array(tuning.junctions.prior_gaps)
    weight = tuning.corners.prior_observations
    joined, shares = prior, prior_gaps
    for _ in range(tuning.corners.rounds):
        stops = stop @ shares
        odds = log_passing + np.log(stops) + np.log(joined / (1 - joined))
        likely = expit(odds)
        # Of an end, the likeliest meeting counts.
        best = np.zeros(count)
        np.maximum.at(best, m, likely)
        np.maximum.at(best, n, likely)
        joined = min((best.sum() + weight * prior) / (count + weight), tuning.corners.max_at_corner)
        kinds = likely @ (stop * shares / stops[:, None]) + weight * prior_gaps
        shares = kinds / kinds.sum()
    return log_passing + np.log(stop @ shares) + np.log(joined / (1 - joined))


def carried(
    ends: Ends, chosen: Int[np.ndarray, "k"], outward_mm: Float[np.ndarray, "k"]
) -> tuple[Float[np.ndarray, "k 2 3"], Float[np.ndarray, "k 6 6"]]:
    """Lines whose chosen ends are moved along them, first, and covariance."""
    own = ends.own_mm[chosen]
    share = outward_mm / np.linalg.norm(own[:, 0] - own[:, 1], axis=1)
    weight = np.zeros((len(chosen), 2, 2))
    weight[:, 0, 0], weight[:, 0, 1], weight[:, 1, 1] = 1 + share, -share, 1.0
    spread = np.einsum("kef,ij->keifj", weight, np.eye(3)).reshape(-1, 6, 6)
    return weight @ own, spread @ ends.own_covariance[chosen] @ spread.mT
