"""How well each end of a line fits its vertex, and which is let go where one does not.

What an end says across its line is compared with the vertex under the covariance of their
difference, which is the line's own less that of the vertex: the line is in the vertex (Baarda's
data snooping). The worst goes first, and the rest is adjusted anew. Free ends that stop beside a
corner which their line does not run through are named, and not held.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.wire_frame.adjustment import Adjusted, Graph, adjust_vertices, without_gaps
from trinoc.numerics import chi_square_tail

# Of the variance of an end: less than this share is left where nothing else knows the vertex.
LEAST_SHARE = 1e-6


class EndFit(NamedTuple):
    """Of both ends of each line of an adjustment: chi-square, and its degrees of freedom."""

    square: Float[np.ndarray, "l 2"]
    degrees: Int[np.ndarray, "l 2"]


class Snooped(NamedTuple):
    """The graph that fits, its adjustment, and the ends let go: line, end, chi-square, degrees."""

    graph: Graph
    answer: Adjusted
    let_go: tuple[tuple[int, int, float, int], ...]


def end_fit(graph: Graph, answer: Adjusted) -> EndFit:
    """Each end against the vertex that all lines together give."""
    square = np.zeros((len(answer.lines), 2))
    degrees = np.zeros((len(answer.lines), 2), dtype=np.int64)
    vertex = graph.vertex[answer.lines]
    shared = np.bincount(vertex.reshape(-1), minlength=graph.count)[vertex] > 1
    for row in range(len(answer.lines)):
        for end in np.flatnonzero(shared[row]).tolist():
            across = slice(3 * end, 3 * end + 2)
            known = answer.joint(vertex[row, end : end + 1])[0, :, 0]
            axes = answer.axes[row, :2]
            own = answer.own_mm2[row, across, across]
            value, way = np.linalg.eigh(own - axes @ known @ axes.T)
            left = value > LEAST_SHARE * np.trace(own)
            part = (way.T @ answer.residual_mm[row, across])[left]
            square[row, end] = (part**2 / value[left]).sum()
            degrees[row, end] = int(left.sum())
    return EndFit(square, degrees)


def snoop_ends(graph: Graph, posterior: Float[np.ndarray, "l"], significance: float) -> Snooped:
    """Let ends go, the worst first, until all fit at this level.

    Where two fit equally badly, as at a vertex of two lines, the line of the lower posterior goes.
    """
    let_go: list[tuple[int, int, float, int]] = []
    while True:
        answer = adjust_vertices(graph)
        fit = end_fit(graph, answer)
        tail = np.where(fit.degrees > 0, chi_square_tail(fit.square, fit.degrees), 1.0)
        if tail.size == 0 or tail.min() >= significance:
            return Snooped(graph, answer, tuple(let_go))
        worst = fit.square >= 0.99 * fit.square[np.unravel_index(tail.argmin(), tail.shape)]
        worst &= tail < significance
        rows, ends = np.nonzero(worst)
        row, end = min(
            zip(rows.tolist(), ends.tolist(), strict=True),
            key=lambda at: (posterior[answer.lines[at[0]]], -fit.square[at], at),
        )
        line = int(answer.lines[row])
        let_go.append((line, end, float(fit.square[row, end]), int(fit.degrees[row, end])))
        vertex = graph.vertex.copy()
        vertex[line, end] = graph.count
        graph = graph._replace(vertex=without_gaps(vertex))


class Refused(NamedTuple):
    """An end of a line, how far the line passes its corner, and the chi-square of that (2)."""

    line: int
    end: int
    distance_mm: float
    chi_square: float


def refused_ends(
    graph: Graph,
    answer: Adjusted,
    px_per_mm: Float[np.ndarray, "l"],
    reach_px: float,
    significance: float,
) -> tuple[Refused, ...]:
    """Of each free end, the nearest corner within reach, where its line misses that for sure."""
    vertex = graph.vertex[answer.lines]
    shared = np.bincount(vertex.reshape(-1), minlength=graph.count) > 1
    corners = np.flatnonzero(shared)
    if len(corners) == 0:
        return ()
    near = KDTree(answer.points_mm[corners])
    found = []
    for row, line in enumerate(answer.lines.tolist()):
        for end in np.flatnonzero(~shared[vertex[row]]).tolist():
            own, other = vertex[row, end], vertex[row, 1 - end]
            # The corner at the line's other end is no candidate; the next one may be.
            apart, numbers = map(np.asarray, near.query(answer.points_mm[own], k=2))
            close = numbers[apart < reach_px / px_per_mm[line]]
            at = [corner for corner in corners[close].tolist() if corner != other]
            if not at:
                continue
            axes, across = answer.axes[row, :2], slice(3 * end, 3 * end + 2)
            offset = axes @ (answer.points_mm[at[0]] - graph.lines_mm[line, end])
            spread = answer.own_mm2[row, across, across]
            spread = spread + axes @ answer.joint(np.array([at[0]]))[0, :, 0] @ axes.T
            square = float(offset @ np.linalg.solve(spread, offset))
            if chi_square_tail(square, 2) < significance:
                found.append(Refused(line, end, float(np.linalg.norm(offset)), square))
    return tuple(found)
