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
    """Plane normal . x = offset_mm, with a unit normal.

    A step has three parameters: turn of the normal toward the two axes `complete_axes(normal)`
    (rad), and change of the offset (mm).
    """

    normal: Float[np.ndarray, "3"]
    offset_mm: float

    def distances(
        self, points_mm: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k 3"]]:
        """Return the signed distances of points from the plane, (k,), and their derivatives (k, 3).

        The derivatives are by the parameters of a step.
        """
        in_plane = points_mm @ complete_axes(self.normal).T
        jacobian = np.column_stack([in_plane, -np.ones(len(points_mm))])
        return points_mm @ self.normal - self.offset_mm, jacobian

    def turn(self, step: Float[np.ndarray, "1 3"]) -> "_Plane":
        """Return the plane after a step."""
        normal = self.normal + step[0, :2] @ complete_axes(self.normal)
        return _Plane(normal / np.linalg.norm(normal), self.offset_mm + float(step[0, 2]))


class Face(NamedTuple):
    """Planar face: a loop of vertices and the plane through them.

    Attributes
    ----------
    loop : (k,)
        Indices of the vertices, counter-clockwise about the normal.
    plane : (4,)
        Unit normal, and offset in mm: normal . x = offset.
    covariance : (4, 4)
        Covariance of `plane`.
    chi_square, degrees : float and int
        Misfit of the vertices to the plane, and its degrees of freedom.
    """

    loop: Int[np.ndarray, "k"]
    plane: Float[np.ndarray, "4"]
    covariance: Float[np.ndarray, "4 4"]
    chi_square: float
    degrees: int


def find_faces(
    adjusted: AdjustedGraph, edges: Int[np.ndarray, "e 2"], tuning: MatchTuning
) -> list[Face]:
    """Find the faces: shortest loops of edges whose vertices lie in one plane.

    The search starts from every pair of edges at a vertex. Loops with a chord, an edge between two
    vertices that are not neighbours on the loop, are rejected.
    """
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
    """Return the mask of the vertices that may lie in the plane through three vertices, (n,).

    The result is None if the three vertices `corner` are nearly collinear.
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
    """Return the shortest loop through `first`, `vertex` and `second` that uses only vertices near
    a plane.

    `is_near` marks these vertices. The result is None if there is no loop or if it has a chord.
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
    """Fit a plane to the vertices of a loop, weighted by their joint covariance.

    With `flattened`, the vertices already lie in one plane, so only the covariance of the plane is
    computed.
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
    """Return the unit normal of the plane through the origin that fits the points best, (3,)."""
    return np.linalg.svd(points_mm)[2][2]


def _is_plane(adjusted: AdjustedGraph, face: Face, tuning: MatchTuning) -> bool:
    """True if the vertices lie in the plane of the face, and are precise enough for this test."""
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
    """Return the covariance of the points' coordinates along a normal, (k, k)."""
    return np.einsum("i,aibj,j->ab", normal, joint, normal)


# numerical: number of steps, because planes turn slightly as their vertices move.
FLATTEN_STEPS = 3


def flatten_faces(adjusted: AdjustedGraph, faces: list[Face]) -> AdjustedGraph:
    """Move the vertices so that those of each face lie in one plane, by constrained least squares.

    The covariances of the vertices are updated.
    """
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
    """Return k - 3 linear constraints that put the k vertices of a loop into one plane.

    The rows refer to the coordinates of all vertices `members` of the connected part.
    """
    points = adjusted.points_mm[loop] - adjusted.points_mm[loop].mean(axis=0)
    normal = _best_normal(points)
    in_plane = points @ complete_axes(normal).T
    in_plane_functions = np.column_stack([in_plane, np.ones(len(loop))])
    null_space = np.linalg.svd(in_plane_functions.T)[2][3:]
    rows = np.zeros((len(null_space), len(members), 3))
    rows[:, np.searchsorted(members, loop)] = null_space[:, :, None] * normal
    return rows.reshape(len(null_space), 3 * len(members))
