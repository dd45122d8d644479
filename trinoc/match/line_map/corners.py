"""Corners: common points of line ends that meet in space, and the lines snapped to them.

Two ends meet if this is more likely than chance. Lines of a scene pass each other at random
distances. Lines of a corner pass each other within their covariances, and their ends stop short
of the corner, or run past it, by some pixels. A corner is the most likely common point of its
lines. The lines are then constrained to pass through their corners, jointly for all lines that
are connected.
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

# numerical: rounds of estimating the shares until convergence.
_ROUNDS = 3


class Corners(Value):
    """Points in space at which ends of lines meet, and the lines snapped to these points.

    `corner`, `line` and `end` form one table with a row for each line end at a corner.

    Attributes
    ----------
    points_mm : (j, 3)
        Common point of the lines of each corner, world frame.
    covariance_mm2 : (j, 3, 3)
        Covariance of each point.
    chi_square, degrees : (j,)
        Misfit of the lines to one point, and its degrees of freedom, 2 k - 3 for k lines.
    corner, line, end : (m,)
        Index of the corner, index of the line, and its end at the corner, 0 or 1.
    lines_mm : (e, 2, 3)
        Ends of all lines, world frame. An end at a corner has the position of the corner.
    lines_covariance_mm2 : (e, 6, 6)
        Covariance of both ends of each line, given that the lines meet.
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
    """Table of line ends: rows 2 k and 2 k + 1 are the two ends of line k.

    Attributes
    ----------
    point_mm : (n, 3)
        Position of the end.
    direction : (n, 3)
        Unit vector along the line, from the other end to this end.
    lines_mm : (n, 2, 3)
        Both ends of the line, this end first.
    lines_covariance : (n, 6, 6)
        Covariance of both ends, in the same sequence, mm^2.
    px_per_mm : (n,)
        Image displacement per mm in space at the line.
    """

    point_mm: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    lines_mm: Float[np.ndarray, "n 2 3"]
    lines_covariance: Float[np.ndarray, "n 6 6"]
    px_per_mm: Float[np.ndarray, "n"]


def line_ends(joined: JoinedLines) -> Ends:
    """Build the table of all line ends."""
    lines, covariance = joined.lines_mm, joined.covariance_mm2
    lines_from_end = np.stack([lines, lines[:, ::-1]], axis=1).reshape(-1, 2, 3)
    reversed_covariance = covariance.reshape(-1, 2, 3, 2, 3)[:, ::-1, :, ::-1].reshape(-1, 6, 6)
    lines_covariance = np.stack([covariance, reversed_covariance], axis=1).reshape(-1, 6, 6)
    direction = lines_from_end[:, 0] - lines_from_end[:, 1]
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return Ends(
        lines_from_end[:, 0],
        direction,
        lines_from_end,
        lines_covariance,
        np.repeat(joined.px_per_mm, 2),
    )


def corner_candidates(
    ends: Ends, joined: JoinedLines, tuning: MatchTuning = DEFAULT
) -> tuple[Int[np.ndarray, "p 2"], Float[np.ndarray, "p"]]:
    """Return the pairs of line ends that probably meet, (p, 2), and their log probabilities."""
    if len(joined) < 2:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    junction_tuning = tuning.junctions
    # Both ends may stop short of the corner.
    radius_mm = 2 * junction_tuning.search_radius_px / float(np.min(ends.px_per_mm))
    pairs = KDTree(ends.point_mm).query_pairs(radius_mm, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // 2 != pairs[:, 1] // 2]
    m, n = np.sort(pairs, axis=1).T
    px_per_mm = np.stack([ends.px_per_mm[m], ends.px_per_mm[n]], axis=1)
    approach = closest_approach(
        ends.point_mm[m], ends.direction[m], ends.point_mm[n], ends.direction[n]
    )
    is_near = (np.abs(approach.gap_mm * px_per_mm) < junction_tuning.search_radius_px).all(axis=1)
    is_possible = (approach.sine > junction_tuning.smallest_sine) & is_near
    m, n, px_per_mm = m[is_possible], n[is_possible], px_per_mm[is_possible]
    distance, normal, sine, gap_mm = take_rows(approach, is_possible)
    variance = sum(
        np.einsum("pi,pij,pj->p", normal, move_ends(ends, end, length)[1][:, :3, :3], normal)
        for end, length in ((m, gap_mm[:, 0]), (n, gap_mm[:, 1]))
    )
    gap_density = np.exp(
        log_gap_density(gap_mm * px_per_mm, px_per_mm, np.array(junction_tuning.gaps_px))
    )
    count = len(ends.point_mm)
    density = count / line_density(joined.lines_mm, tuning.evidence).volume
    log_passing = -0.5 * (np.log(2 * np.pi * variance) + distance**2 / variance)
    odds = _meeting_log_odds(m, n, log_passing - np.log(sine * density), gap_density, count, tuning)
    log_probability = log_corner_probability(
        odds, joined.posterior[m // 2] * joined.posterior[n // 2]
    )
    is_likely = log_probability >= np.log(tuning.collinear.min_posterior)
    return np.stack([m, n], axis=1)[is_likely], log_probability[is_likely]


def log_corner_probability(
    odds: Float[np.ndarray, "p"], lines_posterior: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """Log probability that two line ends meet and both lines are right, (p,).

    `odds` are the log odds that the ends meet. `lines_posterior` is the probability that both lines
    are right, before the meeting is considered. Wrong lines meet others only by chance, so a
    meeting is evidence for both lines. Half of `odds` is used as this evidence, because wrong lines
    at one position often share segments.
    """
    return log_expit(odds) + log_expit(odds / 2 + logit(lines_posterior))


def _meeting_log_odds(
    m: Int[np.ndarray, "p"],
    n: Int[np.ndarray, "p"],
    log_passing: Float[np.ndarray, "p"],
    gap_density: Float[np.ndarray, "p k"],
    count: int,
    tuning: MatchTuning,
) -> Float[np.ndarray, "p"]:
    """Log odds that the line ends m and n of each pair meet, (p,).

    The share of ends that meet and the distribution of their gaps are estimated from all pairs.

    Parameters
    ----------
    m, n : (p,)
        Rows of the two ends in `Ends`.
    log_passing : (p,)
        Log likelihood ratio of the distance between the two lines: they meet, against unrelated
        lines.
    gap_density : (p, k)
        Density of the gaps between ends and meeting point, for each gap scale.
    count : int
        Number of line ends in the table.
    tuning : MatchTuning
        Tuned constants.
    """
    prior, prior_gaps = tuning.junctions.prior_junction_share, np.array(tuning.junctions.prior_gaps)
    weight = tuning.evidence.prior_observations
    meeting_share, shares = prior, prior_gaps
    for _ in range(_ROUNDS):
        mixed_density = gap_density @ shares
        odds = log_passing + np.log(mixed_density) + np.log(meeting_share / (1 - meeting_share))
        probability = expit(odds)
        # Only the most likely meeting of each end counts.
        best_meeting = np.zeros(count)
        np.maximum.at(best_meeting, m, probability)
        np.maximum.at(best_meeting, n, probability)
        meeting_share = (best_meeting.sum() + weight * prior) / (count + weight)
        gap_weights = (
            probability @ (gap_density * shares / mixed_density[:, None]) + weight * prior_gaps
        )
        shares = gap_weights / gap_weights.sum()
    return log_passing + np.log(gap_density @ shares) + np.log(meeting_share / (1 - meeting_share))


def move_ends(
    ends: Ends, rows: Int[np.ndarray, "k"], outward_mm: Float[np.ndarray, "k"]
) -> tuple[Float[np.ndarray, "k 2 3"], Float[np.ndarray, "k 6 6"]]:
    """Move the line ends of the given rows outward along their lines by `outward_mm`.

    Returns both ends of each line, the moved end first, and their covariance.
    """
    lines = ends.lines_mm[rows]
    share = outward_mm / np.linalg.norm(lines[:, 0] - lines[:, 1], axis=1)
    weight = np.zeros((len(rows), 2, 2))
    weight[:, 0, 0], weight[:, 0, 1], weight[:, 1, 1] = 1 + share, -share, 1.0
    spread = np.einsum("kef,ij->keifj", weight, np.eye(3)).reshape(-1, 6, 6)
    return weight @ lines, spread @ ends.lines_covariance[rows] @ spread.mT


class _Corner(NamedTuple):
    """Line ends that meet (rows of `Ends`), their common point, and the chi-square of its fit."""

    ends: tuple[int, ...]
    point_mm: Float[np.ndarray, "3"]
    chi_square: float


def snap_corners(joined: JoinedLines, *, tuning: MatchTuning = DEFAULT) -> Corners:
    """Detect the corners at which ends of lines meet, and move the ends to the corners.

    Parameters
    ----------
    joined : JoinedLines
        Result of `join_collinear`.
    tuning : MatchTuning
        Tuned constants; the groups `corners`, `junctions` and `collinear` are used here.

    Returns
    -------
    Corners
        The corners, and all lines after the adjustment.

    Notes
    -----
    Two ends are joined if they meet with a probability of at least 0.9. The alternative is that two
    unrelated ends are near each other by chance. The probability includes the posteriors of both
    lines. All lines of a corner must pass through one point at a significance of 0.001.

    Across a line, the position of an end has its covariance. Along the line, a standard deviation
    of 7 px is added, because the detector may stop early. A T junction, the end of one line on the
    middle of another, is not a corner. The errors of the lines are assumed independent, although
    some lines share a segment.
    """
    ends = line_ends(joined)
    corners = _agglomerate(ends, *corner_candidates(ends, joined, tuning), tuning)
    return _snap_lines(joined, ends, corners, tuning.corners.free_end_px)


def _agglomerate(
    ends: Ends,
    pairs: Int[np.ndarray, "p 2"],
    log_probability: Float[np.ndarray, "p"],
    tuning: MatchTuning,
) -> list[_Corner]:
    """Join pairs of line ends to corners, the most probable pair first."""
    corner_of: dict[int, _Corner] = {}
    for first_row, second_row in pairs[np.lexsort((*pairs.T, -log_probability))].tolist():
        first = corner_of.get(first_row, _Corner((first_row,), ends.point_mm[first_row], 0.0))
        second = corner_of.get(second_row, _Corner((second_row,), ends.point_mm[second_row], 0.0))
        member_ends = tuple(sorted({*first.ends, *second.ends}))
        if first is second or len({end // 2 for end in member_ends}) < len(member_ends):
            continue
        corner = _common_point(ends, member_ends, tuning)
        if corner is not None:
            corner_of.update(dict.fromkeys(member_ends, corner))
    return sorted({corner.ends: corner for corner in corner_of.values()}.values(), key=_first_end)


def _first_end(corner: _Corner) -> int:
    return corner.ends[0]


def _common_point(ends: Ends, member_ends: tuple[int, ...], tuning: MatchTuning) -> _Corner | None:
    """Fit the common point of the lines of some ends; None if the lines do not meet in one point.

    `member_ends` are rows of `Ends`.
    """
    rows = np.array(member_ends)
    starts, direction = ends.point_mm[rows], ends.direction[rows]
    axes = complete_axes(direction)

    def outward_mm(point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "k"]:
        return ((point - starts) * direction).sum(axis=1)

    def residuals(point: Float[np.ndarray, "3"]) -> Residuals:
        # The covariance of each line at its nearest position to the point.
        lines, covariance = move_ends(ends, rows, outward_mm(point))
        across = whitening(axes @ covariance[:, :3, :3] @ axes.mT) @ axes
        offset = (point - lines[:, 0])[..., None]
        return Residuals((across @ offset)[None, ..., 0], across[None])

    point, equations = gauss_newton(
        residuals, lambda point, step: point + step[0], starts.mean(axis=0), steps=2
    )
    chi_square = float(equations.chi_square[0])
    is_consistent = chi_square_tail(chi_square, 2 * len(rows) - 3) >= tuning.collinear.significance
    is_near = np.abs(outward_mm(point)) * ends.px_per_mm[rows] < tuning.junctions.search_radius_px
    return _Corner(member_ends, point, chi_square) if is_consistent and is_near.all() else None


def _snap_lines(
    joined: JoinedLines, ends: Ends, corners: list[_Corner], free_end_px: float
) -> Corners:
    """Adjust the lines so that the ends at each corner coincide, by constrained least squares.

    `free_end_px` is the standard deviation of where a detector ends an edge, along the edge.
    """
    lines, covariance = joined.lines_mm.copy(), joined.covariance_mm2.copy()
    rows = [(c, end) for c, corner in enumerate(corners) for end in corner.ends]
    corner_ends = np.array(rows, dtype=np.int64).reshape(-1, 2)
    for c, end in rows:
        _move_end_to_point(lines, covariance, ends, end, corners[c].point_mm, free_end_px)
    # Connected lines: they share a corner, directly or through other corners.
    earliest = np.array([corner.ends[0] // 2 for corner in corners], dtype=np.int64)
    label = group_labels(len(lines), earliest[corner_ends[:, 0]], corner_ends[:, 1] // 2)
    points, point_covariance = np.zeros((len(corners), 3)), np.zeros((len(corners), 3, 3))
    corner_label = label[earliest]
    for group in np.unique(corner_label).tolist():
        members = np.flatnonzero(label == group)
        corner_rows = np.flatnonzero(corner_label == group)
        _constrain(lines, covariance, members, [corners[c].ends for c in corner_rows])
        for c in corner_rows.tolist():
            line, end = divmod(corners[c].ends[0], 2)
            block = slice(3 * end, 3 * end + 3)
            points[c], point_covariance[c] = lines[line, end], covariance[line, block, block]
    return Corners(
        points,
        point_covariance,
        np.array([corner.chi_square for corner in corners]),
        np.array([2 * len(corner.ends) - 3 for corner in corners], dtype=np.int64),
        corner_ends[:, 0],
        corner_ends[:, 1] // 2,
        corner_ends[:, 1] % 2,
        lines,
        covariance,
    )


def _move_end_to_point(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    ends: Ends,
    end: int,
    point_mm: Float[np.ndarray, "3"],
    free_end_px: float,
) -> None:
    """Move one end along its line to the position nearest to a point, in place.

    The variance of `free_end_px` along the line is added to the covariance of the end. `end` is a
    row of `ends`.
    """
    line, side = divmod(end, 2)
    step = lines_mm[line, side] - lines_mm[line, 1 - side]
    share = float((point_mm - lines_mm[line, side]) @ ends.direction[end] / np.linalg.norm(step))
    weight = np.eye(2)
    weight[side] = np.array([-share, 1 + share])[:: 1 if side else -1]
    spread = np.kron(weight, np.eye(3))
    lines_mm[line] = weight @ lines_mm[line]
    covariance_mm2[line] = spread @ covariance_mm2[line] @ spread.T
    block = slice(3 * side, 3 * side + 3)
    allowance = (free_end_px / ends.px_per_mm[end]) ** 2
    covariance_mm2[line, block, block] += allowance * np.outer(
        ends.direction[end], ends.direction[end]
    )


def _constrain(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    members: Int[np.ndarray, "k"],
    corners: list[tuple[int, ...]],
) -> None:
    """Adjust the lines `members` so that the ends of each corner coincide, in place.

    With the constraint A x = 0 and the covariance S, the adjusted ends are x - S A' (A S A')^-1 A
    x.
    """
    row_of_line = {int(line): k for k, line in enumerate(members)}
    equal_ends = [(ends[0], second) for ends in corners for second in ends[1:]]
    rows = np.zeros((len(equal_ends), 2 * len(members)))
    for row, (first, second) in enumerate(equal_ends):
        rows[row, 2 * row_of_line[first // 2] + first % 2] = 1.0
        rows[row, 2 * row_of_line[second // 2] + second % 2] = -1.0
    constraint = np.kron(rows, np.eye(3)).reshape(len(equal_ends) * 3, len(members), 6)
    cross_covariance = np.einsum("rki,kij->rkj", constraint, covariance_mm2[members])
    flat_shape = (len(equal_ends) * 3, len(members) * 6)
    innovation = cross_covariance.reshape(flat_shape) @ constraint.reshape(flat_shape).T
    try:
        gain = np.linalg.solve(innovation, cross_covariance.reshape(flat_shape))
    except np.linalg.LinAlgError:
        # Redundant constraints: all solutions move the lines in the same way.
        gain = np.linalg.pinv(innovation, hermitian=True) @ cross_covariance.reshape(flat_shape)
    gain = gain.reshape(cross_covariance.shape)
    discrepancy = np.einsum("rki,ki->r", constraint, lines_mm[members].reshape(-1, 6))
    lines_mm[members] -= np.einsum("rki,r->ki", gain, discrepancy).reshape(-1, 2, 3)
    covariance_mm2[members] -= np.einsum("rki,rkj->kij", cross_covariance, gain)
