"""Lines between vertices, and the least squares that puts every line through both of its own.

A line is observed across itself, at both ends with their covariance, and along itself where it
stops, which is known to some pixels. Where the vertices lie abreast of other places of the line,
its covariance is carried there. Vertices that no chain of edges ties together are independent, so
that the covariance is a block for each part of the graph.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from trinoc.match.line_map.corners import Corners
from trinoc.match.line_map.lines import JoinedLines
from trinoc.numerics.joins import group_sums
from trinoc.numerics.small_least_squares import Residuals, normal_equations, whitening
from trinoc.numerics.vectors import complete_axes


class Graph(NamedTuple):
    """Lines between vertices; lines between the same two are one edge.

    lines_mm, covariance_mm2 : the lines as they were measured.
    along_mm : standard deviation of both ends along each line: a detector stops where it does.
    vertex : of both ends of each line.
    """

    lines_mm: Float[np.ndarray, "l 2 3"]
    covariance_mm2: Float[np.ndarray, "l 6 6"]
    along_mm: Float[np.ndarray, "l 2"]
    vertex: Int[np.ndarray, "l 2"]

    @property
    def count(self) -> int:
        """Number of vertices."""
        return int(self.vertex.max(initial=-1)) + 1


def build_graph(joined: JoinedLines, corners: Corners, free_end_px: float) -> Graph:
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


# numerical: the covariance of a line depends on where along it its vertices lie.
STEPS = 3


class AdjustedGraph(NamedTuple):
    """Vertices, and what each line says of its two.

    points_mm : (n, 3). part : (n,). covariance_mm2 : for each part, of its vertices in their
    order. axes : (l, 3, 3) rows: two across each line, then along it. residual_mm : (l, 2, 3) both
    vertices less where the line has them, in its axes; own_mm2 : (l, 2, 3, 2, 3) what of this the
    line itself leaves open.
    """

    points_mm: Float[np.ndarray, "n 3"]
    part: Int[np.ndarray, "n"]
    covariance_mm2: tuple[Float[np.ndarray, "_ _"], ...]
    axes: Float[np.ndarray, "l 3 3"]
    residual_mm: Float[np.ndarray, "l 2 3"]
    own_mm2: Float[np.ndarray, "l 2 3 2 3"]

    def joint(self, vertices: Int[np.ndarray, "k"]) -> Float[np.ndarray, "k 3 k 3"]:
        """Covariance of some vertices of one part."""
        part = int(self.part[vertices[0]])
        at = np.searchsorted(np.flatnonzero(self.part == part), vertices)
        blocks = self.covariance_mm2[part]
        blocks = blocks.reshape(len(blocks) // 3, 3, -1, 3)
        return blocks[at][:, :, at]

    @property
    def each_mm2(self) -> Float[np.ndarray, "n 3 3"]:
        """Covariance of each vertex."""
        found = np.empty((len(self.part), 3, 3))
        for part, joint in enumerate(self.covariance_mm2):
            blocks = joint.reshape(len(joint) // 3, 3, -1, 3)
            found[self.part == part] = np.einsum("iaib->iab", blocks)
        return found

    @property
    def across_mm2(self) -> Float[np.ndarray, "l 2 2 2"]:
        """What each line leaves open across itself, at both ends."""
        return np.einsum("leaeb->leab", self.own_mm2)[:, :, :2, :2]


def adjust_vertices(graph: Graph) -> AdjustedGraph:
    """The likeliest vertices."""
    vertex, count = graph.vertex, graph.count
    axes = line_axes(graph.lines_mm)
    ties = sparse.csr_matrix((np.ones(len(vertex)), vertex.T), shape=(count, count))
    parts, part = connected_components(ties, directed=False)
    number = np.bincount(vertex.reshape(-1), minlength=count)
    points = group_sums(graph.lines_mm.reshape(-1, 3), vertex.reshape(-1), count) / number[:, None]
    jacobian = np.zeros((len(vertex), 6, 6))
    jacobian[:, :3, :3] = jacobian[:, 3:, 3:] = axes
    rows = (3 * vertex[:, :, None] + np.arange(3)).reshape(-1, 6)
    covariance: list[np.ndarray] = []
    residual, own = _vertex_observations(graph, axes, points)
    for _ in range(STEPS):
        # Each line is a problem of its two vertices; the graph adds them up.
        by = whitening(own.reshape(-1, 6, 6))
        observed = Residuals((by @ residual.reshape(-1, 6, 1)).mT, (by @ jacobian)[:, None])
        each = normal_equations(observed)
        information = _assemble_sparse(each.information, rows, 3 * count)
        gradient = np.bincount(rows.reshape(-1), each.gradient.reshape(-1), 3 * count)
        covariance = []
        for of in (np.flatnonzero(part == k) for k in range(parts)):
            at = (3 * of[:, None] + np.arange(3)).reshape(-1)
            covariance.append(np.linalg.inv(information[at][:, at].toarray()))
            points[of] -= (covariance[-1] @ gradient[at]).reshape(-1, 3)
        residual, own = _vertex_observations(graph, axes, points)
    return AdjustedGraph(points, part.astype(np.int64), tuple(covariance), axes, residual, own)


def line_axes(ends_mm: Float[np.ndarray, "l 2 3"]) -> Float[np.ndarray, "l 3 3"]:
    """Two directions across each line, and the one along it."""
    way = ends_mm[:, 1] - ends_mm[:, 0]
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    return np.concatenate([complete_axes(way), way[:, None]], axis=1)


def _vertex_observations(
    graph: Graph, axes: Float[np.ndarray, "l 3 3"], points_mm: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "l 2 3"], Float[np.ndarray, "l 2 3 2 3"]]:
    """(both vertices less where each line has them, in its axes; covariance of the latter)."""
    ends = graph.lines_mm
    residual = np.einsum("lai,lei->lea", axes, points_mm[graph.vertex] - ends)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    share = residual[:, :, 2] / length[:, None] + np.array([0.0, 1.0])
    carry = np.stack([1 - share, share], axis=2)
    across, blocks = axes[:, :2], graph.covariance_mm2.reshape(-1, 2, 3, 2, 3)
    measured = np.einsum("lai,lfigj,lbj->lfagb", across, blocks, across)
    own = np.zeros((len(ends), 2, 3, 2, 3))
    own[:, :, :2, :, :2] = np.einsum("lef,lfagb,lhg->leahb", carry, measured, carry)
    for end in (0, 1):
        own[:, end, 2, end, 2] = graph.along_mm[:, end] ** 2
    return residual, own


def _assemble_sparse(
    blocks: Float[np.ndarray, "l 6 6"], rows: Int[np.ndarray, "l 6"], size: int
) -> sparse.csr_matrix:
    row = np.broadcast_to(rows[:, :, None], blocks.shape).reshape(-1)
    column = np.broadcast_to(rows[:, None], blocks.shape).reshape(-1)
    return sparse.csr_matrix((blocks.reshape(-1), (row, column)), shape=(size, size))
