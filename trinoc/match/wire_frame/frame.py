"""The wire frame: vertices, edges and planar faces with their covariance."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.geometry.features import Feature, Wires
from trinoc.geometry.line_lengths import line_sigmas
from trinoc.numerics.tables import (
    COVARIANCE,
    FINITE,
    IN_SCENE,
    PROBABILITY,
    Column,
    ColumnCheck,
    Content,
    Table,
    check_number,
    is_covariance,
)

# numerical: a number of views.
TWO_VIEWS = 2


class LetGo(Table):
    """What did not fit.

    Fields
    ------
    track : (k,) the first track of the line.
    place_mm : (k, 3) where, in the world frame.
    reason : (k,) why, in a sentence.
    """

    SIDES: ClassVar[Mapping[str, str]] = {"k": "rows of what was let go"}

    track: Int[np.ndarray, "k"]
    place_mm: Annotated[Float[np.ndarray, "k 3"], Column(parts=("x_mm", "y_mm", "z_mm"))]
    reason: Shaped[np.ndarray, "k"]


def _sizes_of_parts(table: Content) -> list[int]:
    """The numbers of vertices that each part has, in rows of its covariance."""
    part = table.values["part"]
    return [] if (part < 0).any() else (3 * np.bincount(part)).tolist()


class Wireframe(Feature):
    """A graph in space: edges are straight from vertex to vertex, faces are loops of edges.

    Vertices, edges and faces are numbered from 0. `face` and `face_vertex` are one table with a
    row for each vertex of each face, in order round it.

    Fields
    ------
    vertices_mm : (n, 3) corners, and free ends where an edge's evidence stops.
    corner : (n,) whether two edges or more meet there; False for a free end.
    vertex_chi_square, vertex_degrees : (n,) how well the edges pass through one point.
    part : (n,) which vertices hang together, and are known together.
    joint_covariance_mm2 : for each part, (3 k, 3 k) of its vertices in their order.
    edges : (e, 2) the two vertices of each edge, the lower number first.
    posterior : (e,) probability that the best match on it is right.
    views : (e,) number of views that see it; an edge of two is checked by no third.
    viewpoint_dependent : (e,) whether all of its tracks are likely to be no line in space, by the
        matches' column of this name or as outlines of round bodies (the mark "silhouette").
    chi_square, degrees : (e,) how well its lines fit what else is known of its vertices; 0
        degrees where nothing else is.
    edge_of_track : (t,) the edge that each track of the matches is on, -1 where let go.
    face, face_vertex : (m,) number of the face, and of the vertex.
    planes : (f, 4) unit normal and offset in mm of each face, normal . x = offset. The vertices
        run counter-clockwise about the normal.
    planes_covariance : (f, 4, 4) of these.
    face_chi_square, face_degrees : (f,) how well the vertices lie in one plane.
    facing : (f,) whether all cameras that see its edges lie on the normal's side; where not, the
        normal points to most of them.
    let_go : what did not fit, and why.
    """

    KIND: ClassVar[str] = "wireframe"
    IN_WORDS: ClassVar[str] = "a wire frame"
    SIDES: ClassVar[Mapping[str, str]] = {
        "e": "edges",
        "n": "vertices",
        "t": "tracks",
        "m": "rows of faces",
        "f": "faces",
    }
    DERIVED: ClassVar[Mapping[str, Sequence[str]]] = {
        "length_mm": (),
        "length_sigma_mm": (),
        "corners": ("corner_1", "corner_2"),
        "lines_mm": ("x1_mm", "y1_mm", "z1_mm", "x2_mm", "y2_mm", "z2_mm"),
    }

    vertices_mm: Annotated[Float[np.ndarray, "n 3"], Column(IN_SCENE)]
    corner: Bool[np.ndarray, "n"]
    vertex_chi_square: Float[np.ndarray, "n"]
    vertex_degrees: Int[np.ndarray, "n"]
    part: Annotated[
        Int[np.ndarray, "n"],
        Column(
            ColumnCheck("is no part", lambda part, _: part >= 0),
            ColumnCheck(
                "leaves a part without a vertex",
                lambda part, _: (np.bincount(part) > 0).all(),
            ),
        ),
    ]
    joint_covariance_mm2: Annotated[
        tuple[Float[np.ndarray, "_ _"], ...],
        Column(
            ColumnCheck(
                "is no covariance",
                lambda blocks, _: [bool(is_covariance(block[None])[0]) for block in blocks],
            ),
            blocks=_sizes_of_parts,
        ),
    ]
    edges: Annotated[
        Int[np.ndarray, "e 2"],
        Column(
            check_number("n", "names a vertex that is not there"), parts=("vertex_1", "vertex_2")
        ),
    ]
    posterior: Annotated[Float[np.ndarray, "e"], Column(PROBABILITY)]
    views: Int[np.ndarray, "e"]
    viewpoint_dependent: Bool[np.ndarray, "e"]
    chi_square: Float[np.ndarray, "e"]
    degrees: Int[np.ndarray, "e"]
    edge_of_track: Annotated[
        Int[np.ndarray, "t"],
        Column(check_number("e", "names an edge that is not there", smallest=-1)),
    ]
    face: Annotated[
        Int[np.ndarray, "m"], Column(check_number("f", "names a face that is not there"))
    ]
    face_vertex: Annotated[Int[np.ndarray, "m"], Column(check_number("n", "names no vertex"))]
    planes: Annotated[Float[np.ndarray, "f 4"], Column(FINITE)]
    planes_covariance: Annotated[Float[np.ndarray, "f 4 4"], Column(COVARIANCE)]
    face_chi_square: Float[np.ndarray, "f"]
    face_degrees: Int[np.ndarray, "f"]
    facing: Bool[np.ndarray, "f"]
    let_go: Annotated[LetGo, Column(prefix="let_go_")]

    @property
    def checked(self) -> Bool[np.ndarray, "e"]:
        """(e,) whether three views or more see the edge."""
        return self.views > TWO_VIEWS

    @property
    def lines_mm(self) -> Float[np.ndarray, "e 2 3"]:
        """(e, 2, 3) both ends of each edge."""
        return self.vertices_mm[self.edges].reshape(-1, 2, 3)

    @property
    def corners(self) -> Bool[np.ndarray, "e 2"]:
        """(e, 2) whether each edge ends in a corner."""
        return self.corner[self.edges]

    @property
    def length_mm(self) -> Float[np.ndarray, "e"]:
        """(e,) length of each edge."""
        return line_sigmas(self.lines_mm, self.covariance_mm2).length_mm

    @property
    def length_sigma_mm(self) -> Float[np.ndarray, "e"]:
        """(e,) standard deviation of each length."""
        return line_sigmas(self.lines_mm, self.covariance_mm2).length_sigma_mm

    def summary(self) -> str:
        """Numbers of edges, corners, free ends and faces."""
        corners, unchecked = int(self.corner.sum()), int((~self.checked).sum())
        return (
            f"{len(self)} edges, {unchecked} of them seen by two views only; {corners} corners, "
            f"{len(self.corner) - corners} free ends, {len(self.planes)} planar faces."
        )

    def record(self) -> dict[str, Any]:
        """The same numbers, and what was let go."""
        corners = int(self.corner.sum())
        let_go = zip(self.let_go.track.tolist(), self.let_go.reason.tolist(), strict=True)
        return {
            "edges": len(self),
            "edges_of_two_views": int((~self.checked).sum()),
            "corners": corners,
            "free_ends": len(self.corner) - corners,
            "faces": len(self.planes),
            "let_go": [{"track": track, "reason": reason} for track, reason in let_go],
        }

    def wires(self) -> Wires:
        """The edges, and the faces as loops."""
        return Wires(self.vertices_mm, self.edges, np.arange(len(self)), self.faces)

    @property
    def covariance_mm2(self) -> Float[np.ndarray, "e 6 6"]:
        """(e, 6, 6) of both ends of each edge together."""
        found = [self.covariance_of(pair) for pair in self.edges]
        return np.array(found).reshape(-1, 6, 6)

    @property
    def vertices_covariance_mm2(self) -> Float[np.ndarray, "n 3 3"]:
        """(n, 3, 3) of each vertex."""
        found = [self.covariance_of([vertex]) for vertex in range(len(self.vertices_mm))]
        return np.array(found).reshape(-1, 3, 3)

    @property
    def faces(self) -> list[Int[np.ndarray, "_"]]:
        """The vertices of each face, in order round it."""
        return [self.face_vertex[self.face == face] for face in range(len(self.planes))]

    @property
    def face_posterior(self) -> Float[np.ndarray, "f"]:
        """(f,) the least posterior of the edges round each face."""
        of_pair = {tuple(pair): p for pair, p in zip(self.edges.tolist(), self.posterior.tolist())}
        return np.array(
            [
                min(
                    of_pair[min(a, b), max(a, b)]
                    for a, b in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True)
                )
                for loop in self.faces
            ]
        )

    def tracks_of(self, edge: int | np.integer) -> Int[np.ndarray, "_"]:
        """The tracks of the matches that are on an edge."""
        return np.flatnonzero(self.edge_of_track == edge)

    def edges_at(self, vertex: int | np.integer) -> Int[np.ndarray, "_"]:
        """The edges that meet in a vertex."""
        return np.flatnonzero((self.edges == vertex).any(axis=1))

    def covariance_of(
        self, vertices: Sequence[int] | Int[np.ndarray, "k"]
    ) -> Float[np.ndarray, "m m"]:
        """The joint covariance in mm^2 of some vertices, three rows for each in turn."""
        chosen = np.asarray(vertices, dtype=np.int64)
        spread = np.zeros((len(chosen), 3, len(chosen), 3))
        for part in np.unique(self.part[chosen]).tolist():
            rows = np.flatnonzero(self.part[chosen] == part)
            at = np.searchsorted(np.flatnonzero(self.part == part), chosen[rows])
            blocks = self.joint_covariance_mm2[part]
            blocks = blocks.reshape(len(blocks) // 3, 3, -1, 3)[at][:, :, at]
            spread[rows[:, None], :, rows[None]] = blocks.transpose(0, 2, 1, 3)
        return spread.reshape(3 * len(chosen), 3 * len(chosen))
