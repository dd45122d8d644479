"""Ends of lines that meet in space, snapped to their common points.

Two ends meet where that is likelier than chance: lines of a scene pass each other at random, and
those of a corner as near as their covariances say, with ends that stop short of it or run past
by some pixels. A corner is the likeliest point of all its lines. The lines are then held to
their corners by least squares under the constraint, all that hang together at once.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.line_map.corner_pairs import Ends, carried, corner_candidates, ends_of
from trinoc.match.line_map.corners import Corners
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tuning import DEFAULT, MatchTuning
from trinoc.numerics import chi_square_tail, group_labels


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
    ends = ends_of(joined)
    corners = _agglomerated(ends, *corner_candidates(ends, joined, tuning), tuning)
    return _held(joined, ends, corners, tuning.corners.free_end_px)


def _agglomerated(
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
    point = ends.point_mm[chosen].mean(axis=0)
    # The lines' covariances depend on where along them the point is.
    for _ in range(2):
        outward = ((point - ends.point_mm[chosen]) * ends.way[chosen]).sum(axis=1)
        lines, covariance = carried(ends, chosen, outward)
        precision = _across_precision(ends.way[chosen], covariance[:, :3, :3])
        pull = (precision @ lines[:, 0, :, None])[..., 0]
        point = np.linalg.solve(precision.sum(axis=0), pull.sum(axis=0))
    outward = ((point - ends.point_mm[chosen]) * ends.way[chosen]).sum(axis=1)
    error = point - lines[:, 0]
    square = float(np.einsum("ki,kij,kj->", error, precision, error))
    fits = chi_square_tail(square, 2 * len(chosen) - 3) >= tuning.corners.significance
    near = (np.abs(outward) * ends.px_per_mm[chosen] < tuning.junctions.reach_px).all()
    return _Corner(together, point, square) if fits and near else None


def _across_precision(
    way: Float[np.ndarray, "k 3"], covariance: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, "k 3 3"]:
    """What lines say about a point: nothing along them."""
    across = np.eye(3) - way[:, :, None] * way[:, None]
    # With the line's own direction made sure in its own place, the rest can be inverted.
    along = way[:, :, None] * way[:, None]
    size = np.trace(covariance, axis1=1, axis2=2)[:, None, None]
    inverse = np.linalg.inv(across @ covariance @ across + size * along)
    return inverse - along / size


def _held(joined: JoinedLines, ends: Ends, corners: list[_Corner], free_end_px: float) -> Corners:
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
