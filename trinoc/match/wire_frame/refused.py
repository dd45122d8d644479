"""Free ends that stop beside a corner which their line does not run through: named, not held."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from trinoc.match.wire_frame.adjustment import Adjusted
from trinoc.match.wire_frame.graph import Graph
from trinoc.numerics import chi_square_tail


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
