"""A wire frame beside a known shape: corners and edges found, missing and extra."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from trinoc.evaluation.alignment import RigidMotion
from trinoc.evaluation.distances import lengths_near
from trinoc.evaluation.known_shape import KnownShape
from trinoc.match import Wireframe
from trinoc.numerics import chi_square_limit

# Ends of known edges nearer than this share of the shape's size are one corner.
_SAME_PLACE = 1e-6
# Known edges that differ by less, as a sine, continue each other: their common end is no corner.
_STRAIGHT = 0.01
# A wanted part that begins this near to an edge's end, as a share of it, reaches its corner.
_AT_END = 1e-3
# An edge counts as found where half of its wanted length is, as for lengths.
LEAST_COVERED = 0.5
_STEP_MM = 0.25
THREE_SIGMA = 0.9973


class WireframeScore(NamedTuple):
    """Corners and edges found, within the largest tolerance.

    Fields
    ------
    edges_wanted, edges_found : known edges with a wanted part, and those of which half of it or
        more was found. edges_extra : edges of the wire frame that lie on no known one.
    corners_mm : (w, 3) the known corners that were wanted.
    vertex : (w,) the corner of the wire frame found for each, -1 where it is missing.
    corners_extra : corners of the wire frame that belong to no known one, wanted or not.
    error_mm : (p,) distances of all that do.
    square : (p,) the same in units of their covariance, squared: three degrees of freedom.
    faces : number of faces.
    """

    edges_wanted: int
    edges_found: int
    edges_extra: int
    corners_mm: Float[np.ndarray, "w 3"]
    vertex: Int[np.ndarray, "w"]
    corners_extra: int
    error_mm: Float[np.ndarray, "p"]
    square: Float[np.ndarray, "p"]
    faces: int

    def record(self) -> dict[str, Any]:
        """All numbers by name; NaN where there is none."""
        found = int((self.vertex >= 0).sum())
        return {
            "edges_wanted": self.edges_wanted,
            "edges_found": self.edges_found,
            "edges_missing": self.edges_wanted - self.edges_found,
            "edges_extra": self.edges_extra,
            "corners_wanted": len(self.vertex),
            "corners_found": found,
            "corners_missing": len(self.vertex) - found,
            "corners_extra": self.corners_extra,
            "corner_error_median_mm": _of(np.median, self.error_mm),
            "share_of_corners_within_95": self._share_within(0.95),
            "share_of_corners_within_3_sigma": self._share_within(THREE_SIGMA),
            "faces": self.faces,
        }

    def _share_within(self, share: float) -> float:
        return _of(np.mean, self.square <= chi_square_limit(1 - share, 3))


def score_wireframe(
    frame: Wireframe,
    edge_of: Int[np.ndarray, "e"],
    shape: KnownShape,
    reach_mm: float,
    motion: RigidMotion | None = None,
) -> WireframeScore:
    """Compare a wire frame whose edges lie on the known edges `edge_of`, -1 where on none."""
    known = known_corners(shape)
    vertices, spread = frame.vertices_mm, frame.vertices_covariance_mm2
    if motion is not None:
        vertices = motion.of_points(vertices)
        spread = motion.rotation @ spread @ motion.rotation.T
    corners = np.flatnonzero(frame.corner)
    ours, theirs = _paired(vertices[corners], known.corners_mm, reach_mm)
    vertex = np.full(len(known.corners_mm), -1)
    vertex[theirs] = corners[ours]
    error = vertices[corners[ours]] - known.corners_mm[theirs]
    square = np.einsum(
        "pi,pij,pj->p", error, np.linalg.inv(spread[corners[ours]]), error, optimize=True
    )
    wanted, found = _edges_found(frame, edge_of, shape, reach_mm, motion)
    return WireframeScore(
        wanted,
        found,
        int((edge_of < 0).sum()),
        known.corners_mm[known.wanted],
        vertex[known.wanted],
        len(corners) - len(ours),
        np.linalg.norm(error, axis=1),
        square,
        len(frame.planes),
    )


class KnownCorners(NamedTuple):
    """Where known edges meet, and whether two or more wanted parts reach the place."""

    corners_mm: Float[np.ndarray, "c 3"]
    wanted: Bool[np.ndarray, "c"]


def known_corners(shape: KnownShape) -> KnownCorners:
    """The places where two known edges or more end that do not continue each other."""
    ends = shape.edges_mm.reshape(-1, 3)
    if len(ends) == 0:
        return KnownCorners(np.zeros((0, 3)), np.zeros(0, dtype=bool))
    size = float(np.linalg.norm(np.ptp(ends, axis=0)))
    pairs = KDTree(ends).query_pairs(_SAME_PLACE * size, output_type="ndarray")
    ties = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(ends), len(ends)))
    count, place = connected_components(ties, directed=False)
    out = shape.edges_mm[:, 1] - shape.edges_mm[:, 0]
    way = out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), np.finfo(float).tiny)
    wanted = np.zeros(len(ends), dtype=bool)
    extent = np.sort(shape.wanted_extent, axis=1)
    wanted[2 * shape.wanted_edge[extent[:, 0] <= _AT_END]] = True
    wanted[2 * shape.wanted_edge[extent[:, 1] >= 1 - _AT_END] + 1] = True
    found, asked = [], []
    for number in range(count):
        at = np.flatnonzero(place == number)
        if _turns(way[at // 2]):
            found.append(ends[at].mean(axis=0))
            asked.append(_turns(way[at[wanted[at]] // 2]))
    return KnownCorners(np.array(found).reshape(-1, 3), np.array(asked, dtype=bool))


def _turns(way: Float[np.ndarray, "k 3"]) -> bool:
    """Whether two directions or more differ."""
    return len(way) > 1 and bool((np.linalg.norm(np.cross(way, way[0]), axis=1) > _STRAIGHT).any())


def _paired(
    found_mm: Float[np.ndarray, "n 3"], known_mm: Float[np.ndarray, "c 3"], reach_mm: float
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Which is which, one to one: as many as lie within reach, at the least distance in all."""
    apart = np.linalg.norm(found_mm[:, None] - known_mm, axis=2)
    # Beyond reach all are equally far, so that none is given up for one that is out of reach.
    far = reach_mm * (len(found_mm) + len(known_mm) + 1)
    ours, theirs = linear_sum_assignment(np.where(apart <= reach_mm, apart, far))
    near = apart[ours, theirs] <= reach_mm
    return ours[near], theirs[near]


def _edges_found(
    frame: Wireframe,
    edge_of: Int[np.ndarray, "e"],
    shape: KnownShape,
    reach_mm: float,
    motion: RigidMotion | None,
) -> tuple[int, int]:
    """(known edges with a wanted part, those of which half of it has an edge of their own near)."""
    lines = frame.lines_mm if motion is None else motion.of_points(frame.lines_mm)
    wanted, parts = np.unique(shape.wanted_edge), shape.wanted_mm
    found = 0
    for edge in wanted.tolist():
        near = lengths_near(parts[shape.wanted_edge == edge], lines[edge_of == edge], _STEP_MM)
        found += near.share_within(reach_mm) >= LEAST_COVERED
    return len(wanted), found


def _of(statistic: Any, values: np.ndarray) -> float:
    return float(statistic(values)) if len(values) else float("nan")
