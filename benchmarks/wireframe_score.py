"""Score of a wire frame against a known shape: corners and edges found, missing and extra."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from trinoc.evaluation.distances import measure_near_lengths
from trinoc.evaluation.known_shape import KnownShape
from trinoc.evaluation.lines_on_edges import edge_of_lines
from trinoc.match.wire_frame.frame import Wireframe

# Ends of known edges nearer than this share of the shape's size are one corner.
_SAME_PLACE = 1e-6
# Known edges that differ by less, as a sine, continue each other: their common end is no corner.
_STRAIGHT = 0.01
# A wanted part that begins this near to an edge's end, as a share of it, reaches its corner.
_AT_END = 1e-3
# An edge counts as found where half of its wanted length is, as for lengths.
LEAST_COVERED = 0.5
_STEP_MM = 0.25


class WireframeScore(NamedTuple):
    """Corners and edges found, within the largest tolerance.

    Fields
    ------
    edges_wanted, edges_found : known edges with a wanted part, and those of which half of it or
        more was found. edges_extra : edges of the wire frame that lie on no known one.
    corners_wanted, corners_found : known corners that two wanted parts reach, and those for which
        the wire frame has one. corners_extra : its corners that belong to no known one at all.
    error_mm : (p,) distances of all that do.
    square : (p,) the same in units of their covariance, squared: three degrees of freedom.
    faces : number of faces.
    """

    edges_wanted: int
    edges_found: int
    edges_extra: int
    corners_wanted: int
    corners_found: int
    corners_extra: int
    error_mm: Float[np.ndarray, "p"]
    square: Float[np.ndarray, "p"]
    faces: int

    def counts(self) -> dict[str, int]:
        """The counts by name."""
        counts = self._asdict()
        del counts["error_mm"], counts["square"]
        return counts


def score_wireframe(frame: Wireframe, shape: KnownShape, reach_mm: float) -> WireframeScore:
    """Compare a wire frame with a known shape."""
    lines_mm = frame.lines_mm
    edge_of = edge_of_lines(lines_mm, shape.edges_mm, reach_mm)
    true_corners = known_corners(shape)
    vertices, spread = frame.vertices_mm, frame.vertices_covariance_mm2
    corners = np.flatnonzero(frame.corner)
    ours, theirs = _pair_corners(vertices[corners], true_corners.corners_mm, reach_mm)
    error = vertices[corners[ours]] - true_corners.corners_mm[theirs]
    square = np.einsum(
        "pi,pij,pj->p", error, np.linalg.inv(spread[corners[ours]]), error, optimize=True
    )
    wanted, parts = np.unique(shape.wanted_edge), shape.wanted_mm
    lengths = [
        measure_near_lengths(parts[shape.wanted_edge == edge], lines_mm[edge_of == edge], _STEP_MM)
        for edge in wanted
    ]
    return WireframeScore(
        edges_wanted=len(wanted),
        edges_found=sum(length.share_within(reach_mm) >= LEAST_COVERED for length in lengths),
        edges_extra=int((edge_of < 0).sum()),
        corners_wanted=int(true_corners.wanted.sum()),
        corners_found=int(true_corners.wanted[theirs].sum()),
        corners_extra=len(corners) - len(ours),
        error_mm=np.linalg.norm(error, axis=1),
        square=square,
        faces=len(frame.planes),
    )


class KnownCorners(NamedTuple):
    """Corners of known edges, and whether two or more wanted parts reach each corner."""

    corners_mm: Float[np.ndarray, "c 3"]
    wanted: Bool[np.ndarray, "c"]


def known_corners(shape: KnownShape) -> KnownCorners:
    """The corners at which two known edges or more end that do not continue each other."""
    ends = shape.edges_mm.reshape(-1, 3)
    if len(ends) == 0:
        return KnownCorners(np.zeros((0, 3)), np.zeros(0, dtype=bool))
    size = float(np.linalg.norm(np.ptp(ends, axis=0)))
    pairs = KDTree(ends).query_pairs(_SAME_PLACE * size, output_type="ndarray")
    ties = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(ends), len(ends)))
    count, component = connected_components(ties, directed=False)
    out = shape.edges_mm[:, 1] - shape.edges_mm[:, 0]
    directions = out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), np.finfo(float).tiny)
    wanted = np.zeros(len(ends), dtype=bool)
    extent = np.sort(shape.wanted_extent, axis=1)
    wanted[2 * shape.wanted_edge[extent[:, 0] <= _AT_END]] = True
    wanted[2 * shape.wanted_edge[extent[:, 1] >= 1 - _AT_END] + 1] = True
    corners, is_wanted = [], []
    for number in range(count):
        members = np.flatnonzero(component == number)
        if _turns(directions[members // 2]):
            corners.append(ends[members].mean(axis=0))
            is_wanted.append(_turns(directions[members[wanted[members]] // 2]))
    return KnownCorners(np.array(corners).reshape(-1, 3), np.array(is_wanted, dtype=bool))


def _turns(directions: Float[np.ndarray, "k 3"]) -> bool:
    """True if two directions or more differ."""
    return len(directions) > 1 and bool(
        (np.linalg.norm(np.cross(directions, directions[0]), axis=1) > _STRAIGHT).any()
    )


def _pair_corners(
    found_mm: Float[np.ndarray, "n 3"], known_mm: Float[np.ndarray, "c 3"], reach_mm: float
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Pair corners one to one: as many as lie within reach, at the least total distance."""
    distances = np.linalg.norm(found_mm[:, None] - known_mm, axis=2)
    # Beyond reach all are equally far, so that none is given up for one that is out of reach.
    far = reach_mm * (len(found_mm) + len(known_mm) + 1)
    ours, theirs = linear_sum_assignment(np.where(distances <= reach_mm, distances, far))
    in_reach = distances[ours, theirs] <= reach_mm
    return ours[in_reach], theirs[in_reach]
