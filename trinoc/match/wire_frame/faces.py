"""Planar faces: shortest loops of edges whose vertices lie in one plane, and are held to it."""

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

# numerical: Gauss-Newton steps of a plane.
STEPS = 2


class _Plane(NamedTuple):
    """A unit normal and an offset; a step turns the normal toward its axes across and shifts."""

    normal: Float[np.ndarray, "3"]
    offset_mm: float

    def distances(
        self, points_mm: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k 3"]]:
        """(distances of points, their derivatives by a step)."""
        inside = points_mm @ complete_axes(self.normal).T
        jacobian = np.column_stack([inside, -np.ones(len(points_mm))])
        return points_mm @ self.normal - self.offset_mm, jacobian

    def turn(self, step: Float[np.ndarray, "1 3"]) -> "_Plane":
        """The plane after a step."""
        normal = self.normal + step[0, :2] @ complete_axes(self.normal)
        return _Plane(normal / np.linalg.norm(normal), self.offset_mm + float(step[0, 2]))


class Face(NamedTuple):
    """A loop of vertices, and the plane through them.

    plane : unit normal, and offset in mm; the loop runs counter-clockwise about the normal.
    covariance : (4, 4) of these. chi_square, degrees : of the vertices' distances from it.
    """

    loop: Int[np.ndarray, "k"]
    plane: Float[np.ndarray, "4"]
    covariance: Float[np.ndarray, "4 4"]
    chi_square: float
    degrees: int


def find_faces(
    answer: AdjustedGraph, edges: Int[np.ndarray, "e 2"], tuning: MatchTuning
) -> list[Face]:
    """Every loop without a chord that two edges of a vertex begin, in their plane."""
    import networkx

    net = networkx.Graph(edges.tolist())
    found: dict[frozenset[int], Face] = {}
    for at in sorted(net):
        for first, second in combinations(sorted(net[at]), 2):
            near = _in_plane(answer, np.array([at, first, second]), tuning)
            if near is None:
                continue
            loop = _loop(net, near, at, first, second)
            if loop is None or frozenset(loop) in found:
                continue
            face = fit_plane(answer, np.array(loop))
            if _is_plane(answer, face, tuning):
                found[frozenset(loop)] = face
    return list(found.values())


def _in_plane(
    answer: AdjustedGraph, corner: Int[np.ndarray, "3"], tuning: MatchTuning
) -> Bool[np.ndarray, "n"] | None:
    """Which vertices may lie in the plane of three; None where these are nearly in a row."""
    points = answer.points_mm
    to_first, to_second = points[corner[1:]] - points[corner[0]]
    normal = np.cross(to_first, to_second)
    size = np.linalg.norm(normal)
    if size < tuning.junctions.smallest_sine * np.linalg.norm(to_first) * np.linalg.norm(to_second):
        return None
    normal = normal / size
    near = np.zeros(len(points), dtype=bool)
    others = np.flatnonzero(answer.part == answer.part[corner[0]])
    offset = points[others] - points[corner[0]]
    # A vertex of the plane is this mean of the three, which err, too.
    share = offset @ np.linalg.pinv(np.stack([to_first, to_second]))
    weight = np.concatenate([1 - share.sum(axis=1, keepdims=True), share], axis=1)
    joint = _variance_along(normal, answer.joint(others))
    at = np.searchsorted(others, corner)
    variance = (
        np.diagonal(joint)
        - 2 * np.einsum("nk,nk->n", weight, joint[:, at])
        + np.einsum("nk,kl,nl->n", weight, joint[np.ix_(at, at)], weight)
    )
    square = (offset @ normal) ** 2 / np.maximum(variance, np.finfo(float).tiny)
    near[others] = square < chi_square_limit(tuning.collinear.significance, 1)
    near[corner] = True
    return near


def _loop(
    net: "networkx.Graph", near: Bool[np.ndarray, "n"], at: int, first: int, second: int
) -> list[int] | None:
    """The shortest loop in the plane through both edges, None where it has a chord."""
    within = net.subgraph([v for v in net if near[v] and v != at])
    if first not in within or second not in within:
        return None
    import networkx

    try:
        way = networkx.shortest_path(within, first, second)
    except networkx.NetworkXNoPath:
        return None
    loop = [at, *way]
    return None if net.subgraph(loop).number_of_edges() > len(loop) else loop


def fit_plane(
    answer: AdjustedGraph, loop: Int[np.ndarray, "k"], *, flattened: bool = False
) -> Face:
    """The likeliest plane of some vertices under their joint covariance.

    Of vertices that are held to one plane already, any three have the same: they count alike.
    """
    points, joint = answer.points_mm[loop], answer.joint(loop)
    centre = points.mean(axis=0)
    normal = _least_normal(points - centre)
    area = np.cross(points - centre, np.roll(points, -1, axis=0) - centre).sum(axis=0)

    def residuals(plane: _Plane) -> Residuals:
        distance, jacobian = plane.distances(points - centre)
        if not flattened:
            by = whitening(_variance_along(plane.normal, joint))
            distance, jacobian = by @ distance, by @ jacobian
        return Residuals(distance[None, None], jacobian[None, None])

    plane, equations = gauss_newton(
        residuals,
        _Plane.turn,
        _Plane(normal if area @ normal > 0 else -normal, 0.0),
        # Of vertices that count alike, the first plane is the likeliest.
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


def _least_normal(points_mm: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "3"]:
    """Unit normal of the plane through the origin that is nearest to points, all alike."""
    return np.linalg.svd(points_mm)[2][2]


def _is_plane(answer: AdjustedGraph, face: Face, tuning: MatchTuning) -> bool:
    """Whether the vertices lie in the plane, and are known well enough to tell."""
    points = answer.points_mm[face.loop]
    variance = np.diagonal(_variance_along(face.plane[:3], answer.joint(face.loop)))
    size = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    if np.sqrt(variance.max()) > tuning.wireframe.plane_doubt * size:
        return False
    tail = chi_square_tail(face.chi_square, max(face.degrees, 1))
    return face.degrees == 0 or bool(tail >= tuning.collinear.significance)


def _variance_along(
    normal: Float[np.ndarray, "3"], joint: Float[np.ndarray, "k 3 k 3"]
) -> Float[np.ndarray, "k k"]:
    """Covariance of points along a normal."""
    return np.einsum("i,aibj,j->ab", normal, joint, normal)


# numerical: planes turn a little as their vertices move.
FLATTEN_STEPS = 3


def flatten_faces(answer: AdjustedGraph, faces: list[Face]) -> AdjustedGraph:
    """The likeliest vertices of which those of each face lie in a plane, and their covariance."""
    points, covariance = answer.points_mm.copy(), list(answer.covariance_mm2)
    for part in sorted({int(answer.part[face.loop[0]]) for face in faces}):
        members = np.flatnonzero(answer.part == part)
        loops = [face.loop for face in faces if answer.part[face.loop[0]] == part]
        spread, start = answer.covariance_mm2[part], answer.points_mm[members].reshape(-1)
        place = start
        for _ in range(FLATTEN_STEPS):
            points[members] = place.reshape(-1, 3)
            here = answer._replace(points_mm=points)
            rows = np.concatenate([_rows(here, loop, members) for loop in loops])
            if len(rows) == 0:
                break
            gain = spread @ rows.T @ np.linalg.pinv(rows @ spread @ rows.T, hermitian=True)
            place = start - gain @ (rows @ start)
            covariance[part] = spread - gain @ rows @ spread
        points[members] = place.reshape(-1, 3)
    return answer._replace(points_mm=points, covariance_mm2=tuple(covariance))


def _rows(
    answer: AdjustedGraph, loop: Int[np.ndarray, "k"], members: Int[np.ndarray, "m"]
) -> Float[np.ndarray, "c d"]:
    """k - 3 numbers that vanish where k vertices lie in one plane, by all vertices of the part."""
    points = answer.points_mm[loop] - answer.points_mm[loop].mean(axis=0)
    normal = _least_normal(points)
    inside = points @ complete_axes(normal).T
    free = np.column_stack([inside, np.ones(len(loop))])
    null = np.linalg.svd(free.T)[2][3:]
    rows = np.zeros((len(null), len(members), 3))
    rows[:, np.searchsorted(members, loop)] = null[:, :, None] * normal
    return rows.reshape(len(null), 3 * len(members))
