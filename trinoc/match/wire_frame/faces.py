"""Planar faces: shortest loops of edges whose vertices lie in one plane, and the constraint to
it.
"""

from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.tuning.every_group import MatchTuning
from trinoc.match.wire_frame.adjustment import AdjustedGraph
from trinoc.numerics.small_least_squares import Residuals, gauss_newton, whitening
from trinoc.numerics.tails import chi_square_limit, chi_square_tail
from trinoc.numerics.vectors import complete_axes

if TYPE_CHECKING:
    import networkx

# numerical: number of Gauss-Newton steps for a plane.
STEPS = 2


class _Plane(NamedTuple):
    """Plane with unit normal and offset. A step turns the normal toward its two axes and shifts
    the plane.
    """

    normal: Float[np.ndarray, "3"]
    offset_mm: float

    def distances(
        self, points_mm: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k 3"]]:
        """Distances of points from the plane (k,), and their derivatives by a step (k, 3)."""
        in_plane = points_mm @ complete_axes(self.normal).T
        jacobian = np.column_stack([in_plane, -np.ones(len(points_mm))])
        return points_mm @ self.normal - self.offset_mm, jacobian

    def turn(self, step: Float[np.ndarray, "1 3"]) -> "_Plane":
        """Apply a step."""
        normal = self.normal + step[0, :2] @ complete_axes(self.normal)
        return _Plane(normal / np.linalg.norm(normal), self.offset_mm + float(step[0, 2]))


class Face(NamedTuple):
    """Loop of vertices and the plane through them.

    plane : unit normal, and offset in mm. The loop runs counter-clockwise about the normal.
    covariance : (4, 4) covariance of these.
    chi_square, degrees : misfit of the vertices, and its degrees of freedom.
    """

    loop: Int[np.ndarray, "k"]
    plane: Float[np.ndarray, "4"]
    covariance: Float[np.ndarray, "4 4"]
    chi_square: float
    degrees: int


def find_faces(
    adjusted: AdjustedGraph, edges: Int[np.ndarray, "e 2"], tuning: MatchTuning
) -> list[Face]:
    """Find all planar loops without a chord, starting from two edges of a vertex."""
    import networkx

    graph = networkx.Graph(edges.tolist())
    faces: dict[frozenset[int], Face] = {}
    for vertex in sorted(graph):
        for first, second in combinations(sorted(graph[vertex]), 2):
            is_near = _vertices_near_plane(adjusted, np.array([vertex, first, second]), tuning)
            if is_near is None:
                continue
            loop = _loop(graph, is_near, vertex, first, second)
            if loop is None or frozenset(loop) in faces:
                continue
            face = fit_plane(adjusted, np.array(loop))
            if _is_plane(adjusted, face, tuning):
                faces[frozenset(loop)] = face
    return list(faces.values())


def _vertices_near_plane(
    adjusted: AdjustedGraph, corner: Int[np.ndarray, "3"], tuning: MatchTuning
) -> Bool[np.ndarray, "n"] | None:
    """Mask of the vertices that may lie in the plane of three, (n,); None if these are nearly
    collinear.
    """
    points = adjusted.points_mm
    to_first, to_second = points[corner[1:]] - points[corner[0]]
    normal = np.cross(to_first, to_second)
    area = np.linalg.norm(normal)
    if area < tuning.junctions.smallest_sine * np.linalg.norm(to_first) * np.linalg.norm(to_second):
        return None
    normal = normal / area
    is_near = np.zeros(len(points), dtype=bool)
    part_vertices = np.flatnonzero(adjusted.part == adjusted.part[corner[0]])
    offset = points[part_vertices] - points[corner[0]]
    # A vertex in the plane is this weighted mean of the three, which have errors as well.
    share = offset @ np.linalg.pinv(np.stack([to_first, to_second]))
    weight = np.concatenate([1 - share.sum(axis=1, keepdims=True), share], axis=1)
    joint = _variance_along(normal, adjusted.joint(part_vertices))
    rows = np.searchsorted(part_vertices, corner)
    variance = (
        np.diagonal(joint)
        - 2 * np.einsum("nk,nk->n", weight, joint[:, rows])
        + np.einsum("nk,kl,nl->n", weight, joint[np.ix_(rows, rows)], weight)
    )
    square = (offset @ normal) ** 2 / np.maximum(variance, np.finfo(float).tiny)
    is_near[part_vertices] = square < chi_square_limit(tuning.collinear.significance, 1)
    is_near[corner] = True
    return is_near


def _loop(
    graph: "networkx.Graph", is_near: Bool[np.ndarray, "n"], vertex: int, first: int, second: int
) -> list[int] | None:
    """Shortest loop in the plane through both edges; None if there is none, or if it has a
    chord.
    """
    subgraph = graph.subgraph([v for v in graph if is_near[v] and v != vertex])
    if first not in subgraph or second not in subgraph:
        return None
    import networkx

    try:
        path = networkx.shortest_path(subgraph, first, second)
    except networkx.NetworkXNoPath:
        return None
    loop = [vertex, *path]
    return None if graph.subgraph(loop).number_of_edges() > len(loop) else loop


def fit_plane(
    adjusted: AdjustedGraph, loop: Int[np.ndarray, "k"], *, flattened: bool = False
) -> Face:
    """Maximum-likelihood plane of vertices under their joint covariance.

    With `flattened`, the vertices already lie in one plane and have equal weights.
    """
    points, joint = adjusted.points_mm[loop], adjusted.joint(loop)
    centre = points.mean(axis=0)
    normal = _best_normal(points - centre)
    area = np.cross(points - centre, np.roll(points, -1, axis=0) - centre).sum(axis=0)

    def residuals(plane: _Plane) -> Residuals:
        distance, jacobian = plane.distances(points - centre)
        if not flattened:
            whitener = whitening(_variance_along(plane.normal, joint))
            distance, jacobian = whitener @ distance, whitener @ jacobian
        return Residuals(distance[None, None], jacobian[None, None])

    plane, equations = gauss_newton(
        residuals,
        _Plane.turn,
        _Plane(normal if area @ normal > 0 else -normal, 0.0),
        # With equal weights, the initial plane is the solution.
        steps=0 if flattened else STEPS,
    )
    covariance, normal = equations.covariance()[0], plane.normal
    if flattened:
        gain = covariance @ plane.distances(points - centre)[1].T
        covariance = gain @ _variance_along(normal, joint) @ gain.T
    by_step = np.zeros((4, 3))
    by_step[:3, :2] = complete_axes(normal).T
    by_step[3] = [*(complete_axes(normal) @ centre), 1.0]
    covariance = by_step @ covariance @ by_step.T
    chi_square = 0.0 if flattened else float(equations.chi_square[0])
    return Face(
        loop,
        np.append(normal, normal @ centre + plane.offset_mm),
        (covariance + covariance.T) / 2,
        chi_square,
        len(loop) - 3,
    )


def _best_normal(points_mm: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "3"]:
    """Unit normal of the plane through the origin with the least squared distances to the
    points.
    """
    return np.linalg.svd(points_mm)[2][2]


def _is_plane(adjusted: AdjustedGraph, face: Face, tuning: MatchTuning) -> bool:
    """Test whether the vertices lie in the plane, and are precise enough for the test."""
    points = adjusted.points_mm[face.loop]
    variance = np.diagonal(_variance_along(face.plane[:3], adjusted.joint(face.loop)))
    size = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    if np.sqrt(variance.max()) > tuning.wireframe.max_plane_sigma_share * size:
        return False
    tail = chi_square_tail(face.chi_square, max(face.degrees, 1))
    return face.degrees == 0 or bool(tail >= tuning.collinear.significance)


def _variance_along(
    normal: Float[np.ndarray, "3"], joint: Float[np.ndarray, "k 3 k 3"]
) -> Float[np.ndarray, "k k"]:
    """Covariance of points along a normal, (k, k)."""
    return np.einsum("i,aibj,j->ab", normal, joint, normal)


# numerical: number of steps, because planes turn slightly as their vertices move.
FLATTEN_STEPS = 3


def flatten_faces(adjusted: AdjustedGraph, faces: list[Face]) -> AdjustedGraph:
    """Constrain the vertices of each face to a plane, with the resulting covariance."""
    points, covariance = adjusted.points_mm.copy(), list(adjusted.covariance_mm2)
    for part in sorted({int(adjusted.part[face.loop[0]]) for face in faces}):
        members = np.flatnonzero(adjusted.part == part)
        loops = [face.loop for face in faces if adjusted.part[face.loop[0]] == part]
        covariance_before = adjusted.covariance_mm2[part]
        start = adjusted.points_mm[members].reshape(-1)
        position = start
        for _ in range(FLATTEN_STEPS):
            points[members] = position.reshape(-1, 3)
            current = adjusted._replace(points_mm=points)
            rows = np.concatenate([_plane_constraints(current, loop, members) for loop in loops])
            if len(rows) == 0:
                break
            gain = (
                covariance_before
                @ rows.T
                @ np.linalg.pinv(rows @ covariance_before @ rows.T, hermitian=True)
            )
            position = start - gain @ (rows @ start)
            covariance[part] = covariance_before - gain @ rows @ covariance_before
        points[members] = position.reshape(-1, 3)
    return adjusted._replace(points_mm=points, covariance_mm2=tuple(covariance))


def _plane_constraints(
    adjusted: AdjustedGraph, loop: Int[np.ndarray, "k"], members: Int[np.ndarray, "m"]
) -> Float[np.ndarray, "c d"]:
    """Rows of k - 3 linear constraints that put k vertices into one plane, over all vertices of
    the part.
    """
    points = adjusted.points_mm[loop] - adjusted.points_mm[loop].mean(axis=0)
    normal = _best_normal(points)
    in_plane = points @ complete_axes(normal).T
    in_plane_functions = np.column_stack([in_plane, np.ones(len(loop))])
    null_space = np.linalg.svd(in_plane_functions.T)[2][3:]
    rows = np.zeros((len(null_space), len(members), 3))
    rows[:, np.searchsorted(members, loop)] = null_space[:, :, None] * normal
    return rows.reshape(len(null_space), 3 * len(members))
