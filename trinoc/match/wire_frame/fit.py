"""How well each end of a line fits its vertex, and which is let go where one does not.

What an end says across its line is compared with the vertex under the covariance of their
difference, which is the line's own less that of the vertex: the line is in the vertex (Baarda's
data snooping). The worst goes first, and the rest is adjusted anew.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.wire_frame.adjustment import Adjusted, adjusted
from trinoc.match.wire_frame.graph import Graph, without_gaps
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


def snooped(graph: Graph, posterior: Float[np.ndarray, "l"], significance: float) -> Snooped:
    """Let ends go, the worst first, until all fit at this level.

    Where two fit equally badly, as at a vertex of two lines, the line of the lower posterior goes.
    """
    let_go: list[tuple[int, int, float, int]] = []
    while True:
        answer = adjusted(graph)
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
