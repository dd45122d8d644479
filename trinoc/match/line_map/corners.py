"""Ends of lines that meet in space, snapped to their common points.

Two ends meet where that is likelier than chance: lines of a scene pass each other at random, and
those of a corner as near as their covariances say, with ends that stop short of it or run past
by some pixels. A corner is the likeliest point of all its lines. The lines are then held to
their corners by least squares under the constraint, all that hang together at once.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from scipy.special import expit, log_expit, logit

from trinoc.match.evidence.junction_geometry import closest_approach, log_gap_density
from trinoc.match.line_map.collinearity import line_density
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.joins import group_labels
from trinoc.numerics.small_least_squares import Residuals, gauss_newton, whitening
from trinoc.numerics.tables import take_rows
from trinoc.numerics.tails import chi_square_tail
from trinoc.numerics.values import Value
from trinoc.numerics.vectors import complete_axes

# numerical: rounds in which shares are learned, which converge.
_ROUNDS = 3


class Corners(Value):
    """Where lines meet, and the lines carried there.

    `corner`, `line` and `end` are one table with a row for each end at each corner.

    Fields
    ------
    points_mm : (j, 3) the likeliest point common to the lines that meet.
    covariance_mm2 : (j, 3, 3) of it.
    chi_square, degrees : (j,) how well the lines pass through one point, and the degrees of
        freedom, 2 k - 3 for k lines.
    corner, line, end : (m,) number of the corner, of the line, and its end, 0 or 1.
    lines_mm : (e, 2, 3) all lines, those that meet with their ends at the corners.
    lines_covariance_mm2 : (e, 6, 6) of these ends, given that they meet.
    """

    points_mm: Float[np.ndarray, "j 3"]
    covariance_mm2: Float[np.ndarray, "j 3 3"]
    chi_square: Float[np.ndarray, "j"]
    degrees: Int[np.ndarray, "j"]
    corner: Int[np.ndarray, "m"]
    line: Int[np.ndarray, "m"]
    end: Int[np.ndarray, "m"]
    lines_mm: Float[np.ndarray, "e 2 3"]
    lines_covariance_mm2: Float[np.ndarray, "e 6 6"]

    def __len__(self) -> int:
        return len(self.points_mm)


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


def line_ends(joined: JoinedLines) -> Ends:
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
    pass_by = closest_approach(ends.point_mm[m], ends.way[m], ends.point_mm[n], ends.way[n])
    near = (np.abs(pass_by.gap_mm * px_per_mm) < rules.reach_px).all(axis=1)
    keep = (pass_by.sine > rules.smallest_sine) & near
    m, n, px_per_mm = m[keep], n[keep], px_per_mm[keep]
    distance, unit, sine, gap_mm = take_rows(pass_by, keep)
    variance = sum(
        np.einsum("pi,pij,pj->p", unit, move_ends(ends, end, length)[1][:, :3, :3], unit)
        for end, length in ((m, gap_mm[:, 0]), (n, gap_mm[:, 1]))
    )
    stop = np.exp(log_gap_density(gap_mm * px_per_mm, px_per_mm, np.array(rules.gaps_px)))
    count = len(ends.point_mm)
    density = count / line_density(joined.lines_mm, tuning.evidence).volume
    log_passing = -0.5 * (np.log(2 * np.pi * variance) + distance**2 / variance)
    odds = _learn_odds(m, n, log_passing - np.log(sine * density), stop, count, tuning)
    likely = log_likely(odds, joined.posterior[m // 2] * joined.posterior[n // 2])
    sure = likely >= np.log(tuning.collinear.min_posterior)
    return np.stack([m, n], axis=1)[sure], likely[sure]


def log_likely(
    odds: Float[np.ndarray, "p"], right: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """Log probability that ends meet and their lines are right, `right` before they met.

    Lines of wrong matches meet others by chance only, so that what speaks for a corner speaks for
    its lines. It is tempered, as the wrong ones of one place have segments in common.
    """
    return log_expit(odds) + log_expit(odds / 2 + logit(right))


def _learn_odds(
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
    weight = tuning.evidence.prior_observations
    joined, shares = prior, prior_gaps
    for _ in range(_ROUNDS):
        stops = stop @ shares
        odds = log_passing + np.log(stops) + np.log(joined / (1 - joined))
        likely = expit(odds)
        # Of an end, the likeliest meeting counts.
        best = np.zeros(count)
        np.maximum.at(best, m, likely)
        np.maximum.at(best, n, likely)
        joined = (best.sum() + weight * prior) / (count + weight)
        kinds = likely @ (stop * shares / stops[:, None]) + weight * prior_gaps
        shares = kinds / kinds.sum()
    return log_passing + np.log(stop @ shares) + np.log(joined / (1 - joined))


def move_ends(
    ends: Ends, chosen: Int[np.ndarray, "k"], outward_mm: Float[np.ndarray, "k"]
) -> tuple[Float[np.ndarray, "k 2 3"], Float[np.ndarray, "k 6 6"]]:
    """Lines whose chosen ends are moved along them, first, and covariance."""
    own = ends.own_mm[chosen]
    share = outward_mm / np.linalg.norm(own[:, 0] - own[:, 1], axis=1)
    weight = np.zeros((len(chosen), 2, 2))
    weight[:, 0, 0], weight[:, 0, 1], weight[:, 1, 1] = 1 + share, -share, 1.0
    spread = np.einsum("kef,ij->keifj", weight, np.eye(3)).reshape(-1, 6, 6)
    return weight @ own, spread @ ends.own_covariance[chosen] @ spread.mT


class _Corner(NamedTuple):
    """Ends (2 line + 0 or 1) that meet, their common point, and how well it fits."""

    ends: tuple[int, ...]
    point_mm: Float[np.ndarray, "3"]
    chi_square: float


def snap_corners(joined: JoinedLines, *, tuning: MatchTuning = DEFAULT) -> Corners:
    """The corners at which ends of lines meet, and the lines with their ends there.

    Ends meet where that is at least 0.9 likely, against ends that are near by chance and with
    the posteriors of both lines, for which their meeting speaks, and where all lines of the
    corner pass through one point at a level of 0.001. Of an end, the place across its line counts
    with its covariance; along it, a standard deviation of 7 pixels is added, since a detector
    stops where it does. An end
    on the middle of another line (a T) is not a corner here. Lines are taken to err
    independently of each other, though some share a segment.
    """
    ends = line_ends(joined)
    corners = _agglomerate(ends, *corner_candidates(ends, joined, tuning), tuning)
    return _hold_to_corners(joined, ends, corners, tuning.corners.free_end_px)


def _agglomerate(
    ends: Ends, pairs: Int[np.ndarray, "p 2"], likely: Float[np.ndarray, "p"], tuning: MatchTuning
) -> list[_Corner]:
    """Corners from pairs of ends, the likeliest first."""
    corner_of: dict[int, _Corner] = {}
    for one, other in pairs[np.lexsort((*pairs.T, -likely))].tolist():
        first = corner_of.get(one, _Corner((one,), ends.point_mm[one], 0.0))
        second = corner_of.get(other, _Corner((other,), ends.point_mm[other], 0.0))
        together = tuple(sorted({*first.ends, *second.ends}))
        if first is second or len({end // 2 for end in together}) < len(together):
            continue
        corner = _common_point(ends, together, tuning)
        if corner is not None:
            corner_of.update(dict.fromkeys(together, corner))
    return sorted({corner.ends: corner for corner in corner_of.values()}.values(), key=_first_end)


def _first_end(corner: _Corner) -> int:
    return corner.ends[0]


def _common_point(ends: Ends, together: tuple[int, ...], tuning: MatchTuning) -> _Corner | None:
    """The likeliest point of some ends' lines, None where they have none."""
    chosen = np.array(together)
    starts, way = ends.point_mm[chosen], ends.way[chosen]
    axes = complete_axes(way)

    def outward_mm(point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "k"]:
        return ((point - starts) * way).sum(axis=1)

    def residuals(point: Float[np.ndarray, "3"]) -> Residuals:
        # Abreast of the point, where each line has a covariance of its own.
        lines, covariance = move_ends(ends, chosen, outward_mm(point))
        across = whitening(axes @ covariance[:, :3, :3] @ axes.mT) @ axes
        offset = (point - lines[:, 0])[..., None]
        return Residuals((across @ offset)[None, ..., 0], across[None])

    point, equations = gauss_newton(
        residuals, lambda point, step: point + step[0], starts.mean(axis=0), steps=2
    )
    square = float(equations.chi_square[0])
    fits = chi_square_tail(square, 2 * len(chosen) - 3) >= tuning.collinear.significance
    near = np.abs(outward_mm(point)) * ends.px_per_mm[chosen] < tuning.junctions.reach_px
    return _Corner(together, point, square) if fits and near.all() else None


def _hold_to_corners(
    joined: JoinedLines, ends: Ends, corners: list[_Corner], free_end_px: float
) -> Corners:
    """Lines whose ends at a corner are one point: least squares under that constraint."""
    lines, covariance = joined.lines_mm.copy(), joined.covariance_mm2.copy()
    rows = [(number, end) for number, corner in enumerate(corners) for end in corner.ends]
    table = np.array(rows, dtype=np.int64).reshape(-1, 2)
    for number, end in rows:
        _bring(lines, covariance, ends, end, corners[number].point_mm, free_end_px)
    # Lines that hang together: those of one corner, directly or through other corners.
    earliest = np.array([corner.ends[0] // 2 for corner in corners], dtype=np.int64)
    label = group_labels(len(lines), earliest[table[:, 0]], table[:, 1] // 2)
    points, spread = np.zeros((len(corners), 3)), np.zeros((len(corners), 3, 3))
    of_corner = label[earliest]
    for part in np.unique(of_corner).tolist():
        members = np.flatnonzero(label == part)
        chosen = np.flatnonzero(of_corner == part)
        _constrain(lines, covariance, members, [corners[c].ends for c in chosen])
        for c in chosen.tolist():
            line, end = divmod(corners[c].ends[0], 2)
            block = slice(3 * end, 3 * end + 3)
            points[c], spread[c] = lines[line, end], covariance[line, block, block]
    return Corners(
        points,
        spread,
        np.array([corner.chi_square for corner in corners]),
        np.array([2 * len(corner.ends) - 3 for corner in corners], dtype=np.int64),
        table[:, 0],
        table[:, 1] // 2,
        table[:, 1] % 2,
        lines,
        covariance,
    )


def _bring(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    ends: Ends,
    end: int,
    point_mm: Float[np.ndarray, "3"],
    free_end_px: float,
) -> None:
    """Carry one end along its line abreast of a point; along the line it is hardly known."""
    line, side = divmod(end, 2)
    own = lines_mm[line, side] - lines_mm[line, 1 - side]
    share = float((point_mm - lines_mm[line, side]) @ ends.way[end] / np.linalg.norm(own))
    weight = np.eye(2)
    weight[side] = np.array([-share, 1 + share])[:: 1 if side else -1]
    spread = np.kron(weight, np.eye(3))
    lines_mm[line] = weight @ lines_mm[line]
    covariance_mm2[line] = spread @ covariance_mm2[line] @ spread.T
    block = slice(3 * side, 3 * side + 3)
    allowance = (free_end_px / ends.px_per_mm[end]) ** 2
    covariance_mm2[line, block, block] += allowance * np.outer(ends.way[end], ends.way[end])


def _constrain(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    members: Int[np.ndarray, "k"],
    corners: list[tuple[int, ...]],
) -> None:
    """x - S A' (A S A')^-1 A x, and the covariance of that, where A x = 0 says that ends meet."""
    at = {int(line): k for k, line in enumerate(members)}
    equal = [(ends[0], other) for ends in corners for other in ends[1:]]
    rows = np.zeros((len(equal), 2 * len(members)))
    for row, (one, other) in enumerate(equal):
        rows[row, 2 * at[one // 2] + one % 2] = 1.0
        rows[row, 2 * at[other // 2] + other % 2] = -1.0
    constraint = np.kron(rows, np.eye(3)).reshape(len(equal) * 3, len(members), 6)
    spread = np.einsum("rki,kij->rkj", constraint, covariance_mm2[members])
    flat = (len(equal) * 3, len(members) * 6)
    between = spread.reshape(flat) @ constraint.reshape(flat).T
    try:
        gain = np.linalg.solve(between, spread.reshape(flat))
    except np.linalg.LinAlgError:
        # Loops of ends that say the same twice: any solution moves the lines alike.
        gain = np.linalg.pinv(between, hermitian=True) @ spread.reshape(flat)
    gain = gain.reshape(spread.shape)
    wrong = np.einsum("rki,ki->r", constraint, lines_mm[members].reshape(-1, 6))
    lines_mm[members] -= np.einsum("rki,r->ki", gain, wrong).reshape(-1, 2, 3)
    covariance_mm2[members] -= np.einsum("rki,rkj->kij", spread, gain)
