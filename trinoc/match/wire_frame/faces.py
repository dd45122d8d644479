"""Planar faces: shortest loops of edges whose vertices lie in one plane."""

from itertools import combinations
from typing import NamedTuple

import networkx
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.tuning import WireframeTuning
from trinoc.match.wire_frame.adjustment import Adjusted
from trinoc.numerics import chi_square_limit, chi_square_tail

# Gauss-Newton steps of a plane.
STEPS = 3


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


def faces_of(
    answer: Adjusted, edges: Int[np.ndarray, "e 2"], tuning: WireframeTuning
) -> list[Face]:
    """Every loop without a chord that two edges of a vertex begin, in their plane."""
    net = networkx.Graph(edges.tolist())
    found: dict[frozenset[int], Face] = {}
    for at in sorted(net):
        for first, second in combinations(sorted(net[at]), 2):
            near = _in_plane(answer, np.array([at, first, second]), tuning)
            if near is None:
                continue
            loop = _loop(net, near, at, first, second, tuning.most_edges)
            if loop is None or frozenset(loop) in found:
                continue
            face = plane_through(answer, np.array(loop))
            if _is_plane(answer, face, tuning):
                found[frozenset(loop)] = face
    return list(found.values())


def _in_plane(
    answer: Adjusted, corner: Int[np.ndarray, "3"], tuning: WireframeTuning
) -> Bool[np.ndarray, "n"] | None:
    """Which vertices may lie in the plane of three; None where these are nearly in a row."""
    points = answer.points_mm
    to_first, to_second = points[corner[1:]] - points[corner[0]]
    normal = np.cross(to_first, to_second)
    size = np.linalg.norm(normal)
    if size < tuning.smallest_sine * np.linalg.norm(to_first) * np.linalg.norm(to_second):
        return None
    normal = normal / size
    near = np.zeros(len(points), dtype=bool)
    others = np.flatnonzero(answer.part == answer.part[corner[0]])
    offset = points[others] - points[corner[0]]
    # A vertex of the plane is this mean of the three, which err, too.
    share = offset @ np.linalg.pinv(np.stack([to_first, to_second]))
    weight = np.concatenate([1 - share.sum(axis=1, keepdims=True), share], axis=1)
    joint = np.einsum("i,aibj,j->ab", normal, answer.joint(others), normal)
    at = np.searchsorted(others, corner)
    variance = (
        np.diagonal(joint)
        - 2 * np.einsum("nk,nk->n", weight, joint[:, at])
        + np.einsum("nk,kl,nl->n", weight, joint[np.ix_(at, at)], weight)
    )
    square = (offset @ normal) ** 2 / np.maximum(variance, np.finfo(float).tiny)
    near[others] = square < chi_square_limit(tuning.plane_significance, 1)
    near[corner] = True
    return near


def _loop(
    net: networkx.Graph, near: Bool[np.ndarray, "n"], at: int, first: int, second: int, most: int
) -> list[int] | None:
    """The shortest loop in the plane through both edges, None where it has a chord."""
    within = net.subgraph([v for v in net if near[v] and v != at])
    if first not in within or second not in within:
        return None
    try:
        way = networkx.shortest_path(within, first, second)
    except networkx.NetworkXNoPath:
        return None
    loop = [at, *way]
    if len(loop) > most or net.subgraph(loop).number_of_edges() > len(loop):
        return None
    return loop


def plane_through(answer: Adjusted, loop: Int[np.ndarray, "k"], *, flattened: bool = False) -> Face:
    """The likeliest plane of some vertices under their joint covariance.

    Of vertices that are held to one plane already, any three have the same: they count alike.
    """
    points, joint = answer.points_mm[loop], answer.joint(loop)
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre)[2][2]
    area = np.cross(points - centre, np.roll(points, -1, axis=0) - centre).sum(axis=0)
    normal = normal if area @ normal > 0 else -normal
    offset, square = 0.0, 0.0
    axes, spread, gain = (
        np.zeros((2, 3)),
        np.zeros((len(loop), len(loop))),
        np.zeros((3, len(loop))),
    )
    for _ in range(STEPS):
        axes = np.linalg.svd(normal[None])[2][1:]
        spread = np.einsum("i,aibj,j->ab", normal, joint, normal)
        weight = np.eye(len(loop)) if flattened else np.linalg.inv(spread)
        distance = (points - centre) @ normal - offset
        jacobian = np.column_stack([(points - centre) @ axes.T, -np.ones(len(loop))])
        gain = -np.linalg.solve(jacobian.T @ weight @ jacobian, jacobian.T @ weight)
        step = gain @ distance
        left = distance + jacobian @ step
        square = 0.0 if flattened else float(left @ weight @ left)
        normal = normal + step[:2] @ axes
        normal, offset = normal / np.linalg.norm(normal), offset + step[2]
    by_step = np.zeros((4, 3))
    by_step[:3, :2] = axes.T
    by_step[3] = [*(axes @ centre), 1.0]
    covariance = by_step @ gain @ spread @ gain.T @ by_step.T
    plane = np.append(normal, normal @ centre + offset)
    return Face(loop, plane, (covariance + covariance.T) / 2, square, len(loop) - 3)


def _is_plane(answer: Adjusted, face: Face, tuning: WireframeTuning) -> bool:
    """Whether the vertices lie in the plane, and are known well enough to tell."""
    points = answer.points_mm[face.loop]
    normal = face.plane[:3]
    joint = answer.joint(face.loop)
    sigma = np.sqrt(np.einsum("i,aiaj,j->a", normal, joint, normal).max())
    size = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    if sigma > tuning.plane_doubt * size:
        return False
    fits = face.degrees == 0 or (
        chi_square_tail(face.chi_square, face.degrees) >= tuning.plane_significance
    )
    return bool(fits)
