"""Build the wire frame from matches: join lines, detect corners, adjust all vertices, find
faces.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from trinoc.geometry.rig import Rig
from trinoc.match import sentences
from trinoc.match.line_map.collinear_merge import join_collinear
from trinoc.match.line_map.corners import snap_corners
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tracks.matches import EVEN_POSTERIOR, Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.wire_frame.adjustment import AdjustedGraph, Graph, adjust_vertices, build_graph
from trinoc.match.wire_frame.faces import Face, find_faces, fit_plane, flatten_faces
from trinoc.match.wire_frame.frame import LetGo, Wireframe
from trinoc.numerics.joins import group_sums
from trinoc.numerics.precision import in_float64
from trinoc.numerics.tails import chi_square_tail

# numerical: smallest share of an end's variance that counts as redundant. It is below this if
# nothing else determines the vertex.
MIN_VARIANCE_SHARE = 1e-6


class EndFit(NamedTuple):
    """Chi-square (l, 2) of both ends of each line against their vertices, and degrees of freedom
    (l, 2).
    """

    square: Float[np.ndarray, "l 2"]
    degrees: Int[np.ndarray, "l 2"]


class SnoopingResult(NamedTuple):
    """Result of removing line ends that do not fit their vertex (data snooping).

    Attributes
    ----------
    graph : Graph
        Graph in which each removed end is a free end.
    adjusted : AdjustedGraph
        Adjustment of this graph.
    let_go : tuple of (line, end, chi-square, degrees of freedom)
        The removed ends.
    """

    graph: Graph
    adjusted: AdjustedGraph
    let_go: tuple[tuple[int, int, float, int], ...]


def end_fit(graph: Graph, adjusted: AdjustedGraph) -> EndFit:
    """Compute the chi-square of each line end against the vertex that all lines there determine."""
    is_shared = np.bincount(graph.vertex.reshape(-1))[graph.vertex] > 1
    line_covariance, axes = adjusted.across_mm2, adjusted.axes[:, None, :2]
    vertex_covariance = axes @ adjusted.vertex_covariances_mm2[graph.vertex] @ axes.mT
    variance, axis = np.linalg.eigh(line_covariance - vertex_covariance)
    is_checked = (
        variance > MIN_VARIANCE_SHARE * np.trace(line_covariance, axis1=2, axis2=3)[..., None]
    )
    is_checked &= is_shared[..., None]
    component = (adjusted.residual_mm[:, :, None, :2] @ axis)[:, :, 0]
    square = np.where(is_checked, component**2 / np.where(is_checked, variance, 1.0), 0.0).sum(
        axis=2
    )
    return EndFit(square, is_checked.sum(axis=2))


def snoop_ends(
    graph: Graph, posterior: Float[np.ndarray, "l"], significance: float
) -> SnoopingResult:
    """Remove line ends that do not fit their vertex, the worst first, until all ends fit.

    An end does not fit if its chi-square is improbable at the given significance. If two ends fit
    equally badly, as at a vertex of two lines, the end of the line with the lower posterior is
    removed.
    """
    let_go: list[tuple[int, int, float, int]] = []
    while True:
        adjusted = adjust_vertices(graph)
        fit = end_fit(graph, adjusted)
        tail = np.where(fit.degrees > 0, chi_square_tail(fit.square, fit.degrees), 1.0)
        if tail.size == 0 or tail.min() >= significance:
            return SnoopingResult(graph, adjusted, tuple(let_go))
        is_worst = fit.square >= 0.99 * fit.square[np.unravel_index(tail.argmin(), tail.shape)]
        is_worst &= tail < significance
        line, end = min(
            map(tuple, np.argwhere(is_worst).tolist()),
            key=lambda position: (posterior[position[0]], -fit.square[position], position),
        )
        let_go.append((line, end, float(fit.square[line, end]), int(fit.degrees[line, end])))
        vertex = graph.vertex.copy()
        # The other lines stay at the vertex.
        vertex[line, end] = graph.count
        graph = graph._replace(vertex=vertex)


class RefusedEnd(NamedTuple):
    """Free line end near a corner, whose line does not pass through the corner.

    Attributes
    ----------
    line, end : int
        Index of the line, and its end, 0 or 1.
    distance_mm : float
        Distance of the line from the corner.
    chi_square : float
        Chi-square of this distance, with 2 degrees of freedom.
    """

    line: int
    end: int
    distance_mm: float
    chi_square: float


def find_refused_ends(
    graph: Graph,
    adjusted: AdjustedGraph,
    px_per_mm: Float[np.ndarray, "l"],
    radius_px: float,
    significance: float,
) -> tuple[RefusedEnd, ...]:
    """List the free line ends near a corner whose line significantly misses the corner.

    Each end is compared with its nearest corner within `radius_px`.
    """
    vertex, vertex_covariances = graph.vertex, adjusted.vertex_covariances_mm2
    is_shared = np.bincount(vertex.reshape(-1), minlength=graph.count) > 1
    corners = np.flatnonzero(is_shared)
    if len(corners) == 0:
        return ()
    tree = KDTree(adjusted.points_mm[corners])
    refused = []
    for line, end in np.argwhere(~is_shared[vertex]).tolist():
        # The corner at the line's other end is excluded, so two neighbours are queried.
        distance, indices = map(np.asarray, tree.query(adjusted.points_mm[vertex[line, end]], k=2))
        near_corners = corners[indices[distance < radius_px / px_per_mm[line]]]
        candidates = near_corners[near_corners != vertex[line, 1 - end]]
        if len(candidates) == 0:
            continue
        axes = adjusted.axes[line, :2]
        offset = axes @ (adjusted.points_mm[candidates[0]] - graph.lines_mm[line, end])
        covariance = (
            adjusted.across_mm2[line, end] + axes @ vertex_covariances[candidates[0]] @ axes.T
        )
        square = float(offset @ np.linalg.solve(covariance, offset))
        if chi_square_tail(square, 2) < significance:
            refused.append(RefusedEnd(line, end, float(np.linalg.norm(offset)), square))
    return tuple(refused)


@in_float64
def wireframe(
    matches: Matches, rig: Rig, *, flat: bool = True, tuning: MatchTuning = DEFAULT
) -> Wireframe:
    """Build the wire frame of matches: corners, edges and planar faces as one consistent graph.

    Parameters
    ----------
    matches : Matches
        The tracks, with the covariance of their fragments.
    rig : Rig
        The cameras, which are assumed exact.
    flat : bool
        True to constrain the vertices of each face to its plane.
    tuning : MatchTuning
        Tuned constants; the groups of the line map and `wireframe` are used here.

    Returns
    -------
    Wireframe
        Vertices, edges and faces with their covariance.

    Raises
    ------
    InputError
        If the matches have no covariance of their fragments.

    Notes
    -----
    Collinear tracks are joined (`join_collinear`), and line ends that meet are joined to corners
    (`snap_corners`). All vertices are then estimated jointly, so that every edge passes through
    both of its vertices. Lines between the same two vertices are one edge.

    A line end that does not fit its corner at a significance of 0.001 becomes a free end, the worst
    end first. `let_go` lists these ends. It also lists free ends within 7 pixels of a corner whose
    line misses the corner. Other free ends are the positions where detectors stopped. Their
    standard deviation along the edge is 7 pixels or more.

    A face is a shortest loop of three or more edges whose vertices lie in one plane, at the same
    significance.
    """
    joined = join_collinear(matches, rig, tuning=tuning)
    corners = snap_corners(joined, tuning=tuning)
    graph = build_graph(joined, corners, tuning.corners.free_end_px)
    snooping = snoop_ends(graph, joined.posterior, tuning.collinear.significance)
    edges, edge_of_line = _edges(snooping.graph)
    edge_of_track = edge_of_line[joined.line_of_track]
    fit = end_fit(snooping.graph, snooping.adjusted)
    loops = find_faces(snooping.adjusted, edges, tuning)
    adjusted = flatten_faces(snooping.adjusted, loops) if flat else snooping.adjusted
    faces = [
        fit_plane(adjusted, face.loop, flattened=flat)._replace(chi_square=face.chi_square)
        for face in loops
    ]
    is_observed = _combine_members(
        np.logical_or, False, np.asarray(matches.index) >= 0, edge_of_track
    )
    is_vertex_observed = _combine_members(
        np.logical_or, False, np.repeat(is_observed, 2, axis=0), edges.reshape(-1)
    )
    faces, facing = _orient_faces(faces, is_vertex_observed, matches, rig)
    vertex_chi_square, vertex_degrees = _vertex_misfits(snooping)
    refused_ends = find_refused_ends(
        snooping.graph,
        snooping.adjusted,
        joined.px_per_mm,
        tuning.corners.free_end_px,
        tuning.collinear.significance,
    )
    return Wireframe(
        vertices_mm=adjusted.points_mm,
        corner=np.bincount(edges.reshape(-1), minlength=len(adjusted.points_mm)) > 1,
        vertex_chi_square=vertex_chi_square,
        vertex_degrees=vertex_degrees,
        part=adjusted.part,
        joint_covariance_mm2=adjusted.covariance_mm2,
        edges=edges,
        posterior=_combine_members(np.maximum, 0, joined.posterior, edge_of_line),
        views=is_observed.sum(axis=1),
        viewpoint_dependent=_combine_members(
            np.logical_and, True, _is_no_line(matches), edge_of_track
        ),
        chi_square=_combine_members(np.maximum, 0, fit.square.sum(axis=1), edge_of_line),
        degrees=_combine_members(np.maximum, 0, fit.degrees.sum(axis=1), edge_of_line),
        edge_of_track=edge_of_track,
        face=np.repeat(np.arange(len(faces)), [len(face.loop) for face in faces]),
        face_vertex=np.concatenate([*(face.loop for face in faces), np.zeros(0, dtype=np.int64)]),
        planes=np.array([face.plane for face in faces]).reshape(-1, 4),
        planes_covariance=np.array([face.covariance for face in faces]).reshape(-1, 4, 4),
        face_chi_square=np.array([face.chi_square for face in faces]),
        face_degrees=np.array([face.degrees for face in faces], dtype=np.int64),
        facing=facing,
        let_go=_describe_unfitted_ends(snooping, refused_ends, joined),
    )


def _edges(graph: Graph) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "l"]]:
    """Return the two vertices of each edge, and the edge of each line.

    Edges are sorted by the index of their first line.
    """
    pairs = np.sort(graph.vertex, axis=1)
    unique, first, inverse = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return unique[order].reshape(-1, 2), rank[inverse.reshape(-1)]


def _combine_members(
    combine: np.ufunc, start: float, values: np.ndarray, group: np.ndarray
) -> np.ndarray:
    """Combine the values of all members of each group with a ufunc, such as `np.maximum`.

    `group` is the group of each row of `values`, for example the edge of each line. `start` is the
    neutral element of the ufunc.
    """
    result = np.full((int(group.max(initial=-1)) + 1, *values.shape[1:]), start, values.dtype)
    combine.at(result, group, values)
    return result


def _is_no_line(matches: Matches) -> Bool[np.ndarray, "t"]:
    """Return the mask of the tracks that probably show no line in space, (t,)."""
    is_no_line = np.zeros(len(matches), dtype=bool)
    if matches.viewpoint_dependent is not None:
        is_no_line |= matches.viewpoint_dependent
    if "silhouette" in matches.marks:
        is_no_line |= matches.marks["silhouette"] > EVEN_POSTERIOR
    return is_no_line


def _vertex_misfits(
    snooping: SnoopingResult,
) -> tuple[Float[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Return chi-square and degrees of freedom of all line ends at each vertex, (n,) each."""
    vertex = snooping.graph.vertex.reshape(-1)
    residual = snooping.adjusted.residual_mm[:, :, :2, None]
    square = residual.mT @ np.linalg.solve(snooping.adjusted.across_mm2, residual)
    degree = np.bincount(vertex)
    return group_sums(square.reshape(-1), vertex, len(degree)), np.maximum(2 * degree - 3, 0)


def _orient_faces(
    faces: list[Face], views: Bool[np.ndarray, "n v"], matches: Matches, rig: Rig
) -> tuple[list[Face], Bool[np.ndarray, "f"]]:
    """Turn the normal of each face toward the side with most of the cameras that show the face.

    Returns the faces, and the mask of the faces with all of these cameras on one side. `views`
    marks the views that show each vertex.
    """
    centres = np.stack([np.asarray(rig[name].centre_world_mm) for name in matches.views])
    oriented, is_facing = [], []
    for face in faces:
        sides = np.sign(centres @ face.plane[:3] - face.plane[3])[views[face.loop].any(axis=0)]
        if sides.sum() < 0:
            face = face._replace(loop=face.loop[::-1], plane=-face.plane)
        oriented.append(face)
        is_facing.append(abs(sides.sum()) == len(sides))
    return oriented, np.array(is_facing, dtype=bool)


def _describe_unfitted_ends(
    snooping: SnoopingResult, refused: tuple[RefusedEnd, ...], joined: JoinedLines
) -> LetGo:
    """Build the table of the line ends that do not fit, with the reason of each.

    An end that was removed and is also near another corner is listed once, as removed.
    """
    reasons = {
        (end.line, end.end): sentences.end_misses_near_corner(end.distance_mm, end.chi_square)
        for end in refused
    }
    for line, end, square, degrees in snooping.let_go:
        reasons[line, end] = sentences.end_leaves_corner(square, degrees)
    ends = np.array(sorted(reasons), dtype=np.int64).reshape(-1, 2)
    return LetGo(
        np.array([joined.tracks_of(line)[0] for line in ends[:, 0]], dtype=np.int64),
        joined.lines_mm[ends[:, 0], ends[:, 1]],
        np.array([reasons[line, end] for line, end in ends.tolist()], dtype=np.str_),
    )
