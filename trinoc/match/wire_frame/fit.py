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

from trinoc.match.wire_frame.adjustment import Adjusted, Graph, adjust_vertices
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
    shared = np.bincount(graph.vertex.reshape(-1))[graph.vertex] > 1
    own, axes = answer.across_mm2, answer.axes[:, None, :2]
    known = axes @ answer.each_mm2[graph.vertex] @ axes.mT
    value, way = np.linalg.eigh(own - known)
    left = value > LEAST_SHARE * np.trace(own, axis1=2, axis2=3)[..., None]
    left &= shared[..., None]
    part = (answer.residual_mm[:, :, None, :2] @ way)[:, :, 0]
    square = np.where(left, part**2 / np.where(left, value, 1.0), 0.0).sum(axis=2)
    return EndFit(square, left.sum(axis=2))


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
        line, end = min(
            map(tuple, np.argwhere(worst).tolist()),
            key=lambda at: (posterior[at[0]], -fit.square[at], at),
        )
        let_go.append((line, end, float(fit.square[line, end]), int(fit.degrees[line, end])))
        vertex = graph.vertex.copy()
        # Others stay at the vertex that it leaves.
        vertex[line, end] = graph.count
        graph = graph._replace(vertex=vertex)


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
    vertex, each = graph.vertex, answer.each_mm2
    shared = np.bincount(vertex.reshape(-1), minlength=graph.count) > 1
    corners = np.flatnonzero(shared)
    if len(corners) == 0:
        return ()
    near = KDTree(answer.points_mm[corners])
    found = []
    for line, end in np.argwhere(~shared[vertex]).tolist():
        # The corner at the line's other end is no candidate; the next one may be.
        apart, numbers = map(np.asarray, near.query(answer.points_mm[vertex[line, end]], k=2))
        close = corners[numbers[apart < reach_px / px_per_mm[line]]]
        at = close[close != vertex[line, 1 - end]]
        if len(at) == 0:
            continue
        axes = answer.axes[line, :2]
        offset = axes @ (answer.points_mm[at[0]] - graph.lines_mm[line, end])
        spread = answer.across_mm2[line, end] + axes @ each[at[0]] @ axes.T
        square = float(offset @ np.linalg.solve(spread, offset))
        if chi_square_tail(square, 2) < significance:
            found.append(Refused(line, end, float(np.linalg.norm(offset)), square))
    return tuple(found)
