"""Which ends of lines are which vertex, and which lines are one edge."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.line_map import Corners, JoinedLines


class Graph(NamedTuple):
    """Lines between vertices; lines between the same two are one edge.

    lines_mm, covariance_mm2 : the lines as they were measured.
    along_mm : standard deviation of both ends along each line: a detector stops where it does.
    vertex : of both ends of each line, or -1 where the line was let go.
    """

    lines_mm: Float[np.ndarray, "l 2 3"]
    covariance_mm2: Float[np.ndarray, "l 6 6"]
    along_mm: Float[np.ndarray, "l 2"]
    vertex: Int[np.ndarray, "l 2"]

    @property
    def count(self) -> int:
        """Number of vertices."""
        return int(self.vertex.max(initial=-1)) + 1


def graph_of(joined: JoinedLines, corners: Corners, free_end_px: float) -> Graph:
    """A vertex for each corner, and one for each end that is at none."""
    count = len(joined)
    vertex = np.full((count, 2), -1)
    vertex[corners.line, corners.end] = corners.corner
    free = np.flatnonzero(vertex.reshape(-1) < 0)
    vertex.reshape(-1)[free] = len(corners) + np.arange(len(free))
    way = joined.lines_mm[:, 1] - joined.lines_mm[:, 0]
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    blocks = joined.covariance_mm2.reshape(-1, 2, 3, 2, 3)
    variance = np.einsum("ni,neiej,nj->ne", way, blocks, way)
    stops = (free_end_px / joined.px_per_mm)[:, None]
    return Graph(joined.lines_mm, joined.covariance_mm2, np.sqrt(variance + stops**2), vertex)


def without_gaps(vertex: Int[np.ndarray, "l 2"]) -> Int[np.ndarray, "l 2"]:
    """The same graph with its vertices numbered from 0 on, in their order."""
    used, number = np.unique(vertex[vertex >= 0], return_inverse=True)
    renumbered = np.full_like(vertex, -1)
    renumbered[vertex >= 0] = number
    assert len(used) == renumbered.max(initial=-1) + 1
    return renumbered
