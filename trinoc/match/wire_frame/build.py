"""From matches to the wire frame: lines joined, corners found, all made consistent."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from trinoc.geometry.rig import Rig
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

# numerical: of the variance of an end: less than this share is left where nothing else knows the
# vertex.
LEAST_SHARE = 1e-6


class EndFit(NamedTuple):
    """Of both ends of each line of an adjustment: chi-square, and its degrees of freedom."""

    square: Float[np.ndarray, "l 2"]
    degrees: Int[np.ndarray, "l 2"]


class SnoopingResult(NamedTuple):
    """The graph that fits, its adjustment, and the ends let go: line, end, chi-square, degrees."""

    graph: Graph
    answer: AdjustedGraph
    let_go: tuple[tuple[int, int, float, int], ...]


def end_fit(graph: Graph, answer: AdjustedGraph) -> EndFit:
    """Each end against the vertex that all lines together give."""
    shared = np.bincount(graph.vertex.reshape(-1))[graph.vertex] > 1
    own, axes = answer.across_mm2, answer.axes[:, None, :2]
    known = axes @ answer.each_mm2[graph.vertex] @ axes.mT
    value, way = np.linalg.eigh(own - known)
    left = value > LEAST_SHARE * np.trace(own, axis1=2, axis2=3)[..., None]
    left &= shared[..., None]
    part = (answer.residual_mm[:, :, None, :2] @ way)[:, :, 0]
    square = np.where(left, part**2 / np.where(left, value, 1.0), 0.0).sum(axis=2)
    return EndFit(square, left.sum(axis=2))


def snoop_ends(
    graph: Graph, posterior: Float[np.ndarray, "l"], significance: float
) -> SnoopingResult:
    """Let ends go, the worst first, until all fit at this level.

    Where two fit equally badly, as at a vertex of two lines, the line of the lower posterior goes.
    """
    let_go: list[tuple[int, int, float, int]] = []
    while True:
        answer = adjust_vertices(graph)
        fit = end_fit(graph, answer)
        tail = np.where(fit.degrees > 0, chi_square_tail(fit.square, fit.degrees), 1.0)
        if tail.size == 0 or tail.min() >= significance:
            return SnoopingResult(graph, answer, tuple(let_go))
        worst = fit.square >= 0.99 * fit.square[np.unravel_index(tail.argmin(), tail.shape)]
        worst &= tail < significance
        line, end = min(
            map(tuple, np.argwhere(worst).tolist()),
            key=lambda at: (posterior[at[0]], -fit.square[at], at),
        )
        let_go.append((line, end, float(fit.square[line, end]), int(fit.degrees[line, end])))
        vertex = graph.vertex.copy()
        # Others stay at the vertex that it leaves.
        vertex[line, end] = graph.count
        graph = graph._replace(vertex=vertex)


class RefusedEnd(NamedTuple):
    """An end of a line, how far the line passes its corner, and the chi-square of that (2)."""

    line: int
    end: int
    distance_mm: float
    chi_square: float


def find_refused_ends(
    graph: Graph,
    answer: AdjustedGraph,
    px_per_mm: Float[np.ndarray, "l"],
    reach_px: float,
    significance: float,
) -> tuple[RefusedEnd, ...]:
    """Of each free end, the nearest corner within reach, where its line misses that for sure."""
    vertex, each = graph.vertex, answer.each_mm2
    shared = np.bincount(vertex.reshape(-1), minlength=graph.count) > 1
    corners = np.flatnonzero(shared)
    if len(corners) == 0:
        return ()
    near = KDTree(answer.points_mm[corners])
    found = []
    for line, end in np.argwhere(~shared[vertex]).tolist():
        # The corner at the line's other end is no candidate; the next one may be.
        apart, numbers = map(np.asarray, near.query(answer.points_mm[vertex[line, end]], k=2))
        close = corners[numbers[apart < reach_px / px_per_mm[line]]]
        at = close[close != vertex[line, 1 - end]]
        if len(at) == 0:
            continue
        axes = answer.axes[line, :2]
        offset = axes @ (answer.points_mm[at[0]] - graph.lines_mm[line, end])
        spread = answer.across_mm2[line, end] + axes @ each[at[0]] @ axes.T
        square = float(offset @ np.linalg.solve(spread, offset))
        if chi_square_tail(square, 2) < significance:
            found.append(RefusedEnd(line, end, float(np.linalg.norm(offset)), square))
    return tuple(found)


# More likely than not.


@in_float64
def wireframe(
    matches: Matches, rig: Rig, *, flat: bool = True, tuning: MatchTuning = DEFAULT
) -> Wireframe:
    """The corners, edges and planar faces that the matches show, as one consistent graph.

    Collinear tracks are joined (`join_collinear`), ends that meet are corners (`snap_corners`).
    Then all vertices are estimated at once: every edge runs through both of its vertices, and its
    line was measured with the covariance of its segments. An end that does not fit its corner at a
    level of 0.001 is let go, the worst first, and stays as a free end. It is named in `let_go`, as
    is an end that stops beside a corner, within 7 pixels, but does not run through it. Lines
    between the same two vertices are one edge. A face is a shortest loop of three edges or more
    whose vertices lie in one plane at that level, too; with `flat` they are then held to it.

    Free ends are where detectors stopped: along its edge each has a standard deviation of 7 pixels
    and more. The cameras count as exact. Raises InputError where the covariance of the fragments
    is not known.
    """
    joined = join_collinear(matches, rig, tuning=tuning)
    corners = snap_corners(joined, tuning=tuning)
    graph = build_graph(joined, corners, tuning.corners.free_end_px)
    found = snoop_ends(graph, joined.posterior, tuning.collinear.significance)
    edges, edge_of_line = _edges(found.graph)
    edge_of_track = edge_of_line[joined.line_of_track]
    fit = end_fit(found.graph, found.answer)
    loops = find_faces(found.answer, edges, tuning)
    answer = flatten_faces(found.answer, loops) if flat else found.answer
    faces = [
        fit_plane(answer, face.loop, flattened=flat)._replace(chi_square=face.chi_square)
        for face in loops
    ]
    seen = _combine_members(np.logical_or, False, np.asarray(matches.index) >= 0, edge_of_track)
    seen_at = _combine_members(np.logical_or, False, np.repeat(seen, 2, axis=0), edges.reshape(-1))
    faces, facing = _orient_faces(faces, seen_at, matches, rig)
    square, degrees = _of_vertices(found)
    refused = find_refused_ends(
        found.graph,
        found.answer,
        joined.px_per_mm,
        tuning.corners.free_end_px,
        tuning.collinear.significance,
    )
    return Wireframe(
        vertices_mm=answer.points_mm,
        corner=np.bincount(edges.reshape(-1), minlength=len(answer.points_mm)) > 1,
        vertex_chi_square=square,
        vertex_degrees=degrees,
        part=answer.part,
        joint_covariance_mm2=answer.covariance_mm2,
        edges=edges,
        posterior=_combine_members(np.maximum, 0, joined.posterior, edge_of_line),
        views=seen.sum(axis=1),
        viewpoint_dependent=_combine_members(
            np.logical_and, True, _no_line(matches), edge_of_track
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
        let_go=_describe_refusals(found, refused, joined),
    )


def _edges(graph: Graph) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "l"]]:
    """(the vertices of each edge, in the order of its first line; the edge of each line)."""
    pairs = np.sort(graph.vertex, axis=1)
    unique, first, inverse = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return unique[order].reshape(-1, 2), rank[inverse.reshape(-1)]


def _combine_members(
    combine: np.ufunc, start: float, values: np.ndarray, of: np.ndarray
) -> np.ndarray:
    """The values of each edge's lines or tracks combined, from the start that changes none."""
    result = np.full((int(of.max(initial=-1)) + 1, *values.shape[1:]), start, values.dtype)
    combine.at(result, of, values)
    return result


def _no_line(matches: Matches) -> Bool[np.ndarray, "t"]:
    """Which tracks are likely to be no line in space."""
    no_line = np.zeros(len(matches), dtype=bool)
    if matches.viewpoint_dependent is not None:
        no_line |= matches.viewpoint_dependent
    if "silhouette" in matches.marks:
        no_line |= matches.marks["silhouette"] > EVEN_POSTERIOR
    return no_line


def _of_vertices(found: SnoopingResult) -> tuple[Float[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Chi-square of what lines say across themselves at each vertex, and degrees of freedom."""
    vertex, residual = found.graph.vertex.reshape(-1), found.answer.residual_mm[:, :, :2, None]
    square = residual.mT @ np.linalg.solve(found.answer.across_mm2, residual)
    number = np.bincount(vertex)
    return group_sums(square.reshape(-1), vertex, len(number)), np.maximum(2 * number - 3, 0)


def _orient_faces(
    faces: list[Face], views: Bool[np.ndarray, "n v"], matches: Matches, rig: Rig
) -> tuple[list[Face], Bool[np.ndarray, "f"]]:
    """(faces whose normals point to most cameras that see them, whether all lie there)."""
    centres = np.stack([np.asarray(rig[name].centre_world_mm) for name in matches.views])
    turned, facing = [], []
    for face in faces:
        sides = np.sign(centres @ face.plane[:3] - face.plane[3])[views[face.loop].any(axis=0)]
        if sides.sum() < 0:
            face = face._replace(loop=face.loop[::-1], plane=-face.plane)
        turned.append(face)
        facing.append(abs(sides.sum()) == len(sides))
    return turned, np.array(facing, dtype=bool)


def _describe_refusals(
    found: SnoopingResult, refused: tuple[RefusedEnd, ...], joined: JoinedLines
) -> LetGo:
    """What was let go, in words: an end once, and that it left its corner rather than why not."""
    words = {
        (each.line, each.end): f"ends beside a corner that it passes at {each.distance_mm:.2f} mm: "
        f"chi-square {each.chi_square:.0f} with 2 degrees of freedom; not held to it"
        for each in refused
    }
    for line, end, square, degrees in found.let_go:
        words[line, end] = (
            f"does not run through the corner that it ends at: chi-square {square:.0f} with "
            f"{degrees} degrees of freedom; its end is free"
        )
    ends = np.array(sorted(words), dtype=np.int64).reshape(-1, 2)
    return LetGo(
        np.array([joined.tracks_of(line)[0] for line in ends[:, 0]], dtype=np.int64),
        joined.lines_mm[ends[:, 0], ends[:, 1]],
        np.array([words[line, end] for line, end in ends.tolist()], dtype=np.str_),
    )
