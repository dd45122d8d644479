"""Least-squares adjustment of the vertices of a graph, so that every line passes through both of
its vertices.

A line is observed across itself at both ends, with covariance. It is also observed along itself,
with a sigma of some pixels for the position where the detector stopped. If a vertex lies at
another position of the line, the covariance is extrapolated to it. Vertices without a chain of
edges between them are independent, so the covariance has one block per connected part of the
graph.
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
    """Measured lines in space that meet at vertices. Lines between the same two vertices are one
    edge.

    Attributes
    ----------
    lines_mm, covariance_mm2 : (l, 2, 3) and (l, 6, 6)
        Ends of the measured lines, world frame, and their covariance.
    along_mm : (l, 2)
        Standard deviation of both ends along the line. It allows for a detector that stops early.
    vertex : (l, 2)
        Vertex at both ends of each line.
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
    """Build the graph with one vertex for each corner and for each line end without a corner.

    `free_end_px` is the standard deviation of where a detector ends an edge, along the edge.
    """
    count = len(joined)
    vertex = np.full((count, 2), -1)
    vertex[corners.line, corners.end] = corners.corner
    free_ends = np.flatnonzero(vertex.reshape(-1) < 0)
    vertex.reshape(-1)[free_ends] = len(corners) + np.arange(len(free_ends))
    direction = joined.lines_mm[:, 1] - joined.lines_mm[:, 0]
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    blocks = joined.covariance_mm2.reshape(-1, 2, 3, 2, 3)
    variance = np.einsum("ni,neiej,nj->ne", direction, blocks, direction)
    stop_sigma = (free_end_px / joined.px_per_mm)[:, None]
    return Graph(joined.lines_mm, joined.covariance_mm2, np.sqrt(variance + stop_sigma**2), vertex)


# numerical: number of steps. The covariance of a line depends on the positions of its vertices.
STEPS = 3


class AdjustedGraph(NamedTuple):
    """Result of the adjustment of a graph: vertex positions and residuals.

    Attributes
    ----------
    points_mm : (n, 3)
        Positions of the vertices, world frame.
    part : (n,)
        Connected part of the graph that each vertex belongs to.
    covariance_mm2 : tuple of (3 k, 3 k)
        For each part, joint covariance of its k vertices.
    axes : (l, 3, 3)
        For each line, two unit vectors across it and one along it, as rows.
    residual_mm : (l, 2, 3)
        Vertex minus measured end of the line, in the axes of the line.
    observation_covariance_mm2 : (l, 2, 3, 2, 3)
        Covariance of the measured ends, in the axes of the line.
    """

    points_mm: Float[np.ndarray, "n 3"]
    part: Int[np.ndarray, "n"]
    covariance_mm2: tuple[Float[np.ndarray, "_ _"], ...]
    axes: Float[np.ndarray, "l 3 3"]
    residual_mm: Float[np.ndarray, "l 2 3"]
    observation_covariance_mm2: Float[np.ndarray, "l 2 3 2 3"]

    def joint(self, vertices: Int[np.ndarray, "k"]) -> Float[np.ndarray, "k 3 k 3"]:
        """Return the joint covariance of some vertices of one connected part, (k, 3, k, 3) mm^2."""
        part = int(self.part[vertices[0]])
        rows = np.searchsorted(np.flatnonzero(self.part == part), vertices)
        blocks = self.covariance_mm2[part]
        blocks = blocks.reshape(len(blocks) // 3, 3, -1, 3)
        return blocks[rows][:, :, rows]

    @property
    def vertex_covariances_mm2(self) -> Float[np.ndarray, "n 3 3"]:
        """Covariance of each vertex, (n, 3, 3)."""
        covariances = np.empty((len(self.part), 3, 3))
        for part, joint in enumerate(self.covariance_mm2):
            blocks = joint.reshape(len(joint) // 3, 3, -1, 3)
            covariances[self.part == part] = np.einsum("iaib->iab", blocks)
        return covariances

    @property
    def across_mm2(self) -> Float[np.ndarray, "l 2 2 2"]:
        """Covariance of both measured ends of each line across the line, (l, 2, 2, 2)."""
        return np.einsum("leaeb->leab", self.observation_covariance_mm2)[:, :, :2, :2]


def adjust_vertices(graph: Graph) -> AdjustedGraph:
    """Estimate the vertices by least squares, so that every line passes through both of its
    vertices.
    """
    vertex, count = graph.vertex, graph.count
    axes = line_axes(graph.lines_mm)
    adjacency = sparse.csr_matrix((np.ones(len(vertex)), vertex.T), shape=(count, count))
    parts, part = connected_components(adjacency, directed=False)
    degree = np.bincount(vertex.reshape(-1), minlength=count)
    points = group_sums(graph.lines_mm.reshape(-1, 3), vertex.reshape(-1), count) / degree[:, None]
    jacobian = np.zeros((len(vertex), 6, 6))
    jacobian[:, :3, :3] = jacobian[:, 3:, 3:] = axes
    rows = (3 * vertex[:, :, None] + np.arange(3)).reshape(-1, 6)
    covariance: list[np.ndarray] = []
    residual, observation_covariance = _vertex_observations(graph, axes, points)
    for _ in range(STEPS):
        # Each line gives normal equations of its two vertices, which are then summed.
        whitener = whitening(observation_covariance.reshape(-1, 6, 6))
        whitened = Residuals(
            (whitener @ residual.reshape(-1, 6, 1)).mT, (whitener @ jacobian)[:, None]
        )
        equations = normal_equations(whitened)
        information = _assemble_sparse(equations.information, rows, 3 * count)
        gradient = np.bincount(rows.reshape(-1), equations.gradient.reshape(-1), 3 * count)
        covariance = []
        for vertices in (np.flatnonzero(part == k) for k in range(parts)):
            parameter_rows = (3 * vertices[:, None] + np.arange(3)).reshape(-1)
            covariance.append(
                np.linalg.inv(information[parameter_rows][:, parameter_rows].toarray())
            )
            points[vertices] -= (covariance[-1] @ gradient[parameter_rows]).reshape(-1, 3)
        residual, observation_covariance = _vertex_observations(graph, axes, points)
    return AdjustedGraph(
        points, part.astype(np.int64), tuple(covariance), axes, residual, observation_covariance
    )


def line_axes(ends_mm: Float[np.ndarray, "l 2 3"]) -> Float[np.ndarray, "l 3 3"]:
    """Return two unit vectors across each line, then the one along the line, as rows (l, 3, 3)."""
    direction = ends_mm[:, 1] - ends_mm[:, 0]
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return np.concatenate([complete_axes(direction), direction[:, None]], axis=1)


def _vertex_observations(
    graph: Graph, axes: Float[np.ndarray, "l 3 3"], points_mm: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "l 2 3"], Float[np.ndarray, "l 2 3 2 3"]]:
    """Return the residuals of both vertices of each line, and the covariance of the measured ends.

    Both are in the axes of the line. The covariance is extrapolated along the line to the positions
    of the vertices.
    """
    ends = graph.lines_mm
    residual = np.einsum("lai,lei->lea", axes, points_mm[graph.vertex] - ends)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    share = residual[:, :, 2] / length[:, None] + np.array([0.0, 1.0])
    extrapolation = np.stack([1 - share, share], axis=2)
    across, blocks = axes[:, :2], graph.covariance_mm2.reshape(-1, 2, 3, 2, 3)
    measured = np.einsum("lai,lfigj,lbj->lfagb", across, blocks, across)
    covariance = np.zeros((len(ends), 2, 3, 2, 3))
    covariance[:, :, :2, :, :2] = np.einsum(
        "lef,lfagb,lhg->leahb", extrapolation, measured, extrapolation
    )
    for end in (0, 1):
        covariance[:, end, 2, end, 2] = graph.along_mm[:, end] ** 2
    return residual, covariance


def _assemble_sparse(
    blocks: Float[np.ndarray, "l 6 6"], rows: Int[np.ndarray, "l 6"], size: int
) -> sparse.csr_matrix:
    row = np.broadcast_to(rows[:, :, None], blocks.shape).reshape(-1)
    column = np.broadcast_to(rows[:, None], blocks.shape).reshape(-1)
    return sparse.csr_matrix((blocks.reshape(-1), (row, column)), shape=(size, size))
