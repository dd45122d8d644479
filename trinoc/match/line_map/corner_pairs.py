"""Which ends of lines meet in space, and which are near each other by chance."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from scipy.special import expit

from trinoc.match.line_map.density import line_density
from trinoc.match.line_map.lines import JoinedLines

# Ends meet when they lie within this of their corner, in pixels, along their lines.
REACH_PX = 15.0
# How far ends stop from their corner, in pixels, and how often each, before it is known.
GAPS_PX = np.array([1.0, 3.0, 8.0])
GAP_SHARES = np.array([0.6, 0.3, 0.1])
# sin of the least angle between lines that meet.
SMALLEST_ANGLE = 0.15
# How often an end is at a corner, before it is known: so many observations.
PRIOR_AT_JUNCTION, PRIOR_OBSERVATIONS, ROUNDS = 0.5, 10.0, 3
MAX_AT_JUNCTION = 0.95
# Ends meet where that is as likely as this, both lines' posteriors included.
MIN_POSTERIOR = 0.9


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
    ends: Ends, joined: JoinedLines
) -> tuple[Int[np.ndarray, "p 2"], Float[np.ndarray, "p"]]:
    """(pairs of ends that are likely to meet, their log odds)."""
    if len(joined) < 2:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    # Both may stop short of the corner.
    reach = 2 * REACH_PX / float(np.min(ends.px_per_mm))
    pairs = KDTree(ends.point_mm).query_pairs(reach, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // 2 != pairs[:, 1] // 2]
    m, n = np.sort(pairs, axis=1).T
    apart = ends.point_mm[n] - ends.point_mm[m]
    normal = np.cross(ends.way[m], ends.way[n])
    sine = np.linalg.norm(normal, axis=1)
    keep = sine > SMALLEST_ANGLE
    m, n, apart, normal, sine = m[keep], n[keep], apart[keep], normal[keep], sine[keep]
    unit = normal / sine[:, None]
    # Lengths from each end outwards to where the two lines pass each other.
    to_m = (np.cross(apart, ends.way[n]) * unit).sum(axis=1) / sine
    to_n = (np.cross(apart, ends.way[m]) * unit).sum(axis=1) / sine
    gap = np.stack([to_m * ends.px_per_mm[m], to_n * ends.px_per_mm[n]], axis=1)
    keep = (np.abs(gap) < REACH_PX).all(axis=1)
    m, n, sine, unit, gap = m[keep], n[keep], sine[keep], unit[keep], gap[keep]
    distance = (apart[keep] * unit).sum(axis=1)
    variance = sum(
        np.einsum("pi,pij,pj->p", unit, carried(ends, end, length[keep])[1][:, :3, :3], unit)
        for end, length in ((m, to_m), (n, to_n))
    )
    scale = ends.px_per_mm[m] * ends.px_per_mm[n]
    square = (gap**2).sum(axis=1)[:, None] / GAPS_PX**2
    stop = np.exp(-0.5 * square) / (2 * np.pi * GAPS_PX**2) * scale[:, None]
    density = len(ends.point_mm) / line_density(joined.lines_mm).volume
    passing = -0.5 * (np.log(2 * np.pi * variance) + distance**2 / variance)
    odds = _learned_odds(m, n, passing - np.log(sine * density), stop, len(ends.point_mm))
    right = joined.posterior[m // 2] * joined.posterior[n // 2]
    sure = expit(odds) * right >= MIN_POSTERIOR
    return np.stack([m, n], axis=1)[sure], odds[sure]


def _learned_odds(
    m: Int[np.ndarray, "p"],
    n: Int[np.ndarray, "p"],
    passing: Float[np.ndarray, "p"],
    stop: Float[np.ndarray, "p k"],
    count: int,
) -> Float[np.ndarray, "p"]:
    """Log odds that ends m and n, of `count` in all, meet; how often ends do, and how far they
    stop from their corners, is learned from these themselves.

    `passing` is the log evidence of how near the lines pass each other, `stop` the density of
    where both ends stop, for each of GAPS_PX.
    """
    joined, shares = PRIOR_AT_JUNCTION, GAP_SHARES
    for _ in range(ROUNDS):
        stops = stop @ shares
        odds = passing + np.log(stops) + np.log(joined / (1 - joined))
        likely = expit(odds)
        # Of an end, the likeliest meeting counts.
        best = np.zeros(count)
        np.maximum.at(best, m, likely)
        np.maximum.at(best, n, likely)
        joined = min(
            (best.sum() + PRIOR_OBSERVATIONS * PRIOR_AT_JUNCTION) / (count + PRIOR_OBSERVATIONS),
            MAX_AT_JUNCTION,
        )
        kinds = likely @ (stop * shares / stops[:, None]) + PRIOR_OBSERVATIONS * GAP_SHARES
        shares = kinds / kinds.sum()
    return passing + np.log(stop @ shares) + np.log(joined / (1 - joined))


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
