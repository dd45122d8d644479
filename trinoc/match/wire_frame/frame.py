"""Result type of the wire frame: vertices, edges and planar faces with their covariance."""

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
    check_index,
    is_covariance,
)

# numerical: number of views.
TWO_VIEWS = 2


class LetGo(Table):
    """Line ends that do not fit the wire frame.

    Attributes
    ----------
    track : (k,)
        First track of the line.
    place_mm : (k, 3)
        Position of the line end, world frame.
    reason : (k,)
        Reason, as a sentence.
    """

    SIDES: ClassVar[Mapping[str, str]] = {"k": "rows of what was let go"}

    track: Int[np.ndarray, "k"]
    place_mm: Annotated[Float[np.ndarray, "k 3"], Column(parts=("x_mm", "y_mm", "z_mm"))]
    reason: Shaped[np.ndarray, "k"]


def _sizes_of_parts(table: Content) -> list[int]:
    """Return the size of the covariance of each connected part: three rows for each vertex."""
    part = table.values["part"]
    return [] if (part < 0).any() else (3 * np.bincount(part)).tolist()


class Wireframe(Feature):
    """Graph in space: straight edges between vertices, and faces that are loops of edges.

    Vertices, edges and faces are numbered from 0. `face` and `face_vertex` form one table with a
    row for each vertex of each face, in sequence along the loop.

    Attributes
    ----------
    vertices_mm : (n, 3)
        Positions of the vertices, world frame: corners, and free ends where the observed part of an
        edge ends.
    corner : (n,)
        True if two or more edges meet at the vertex, False for a free end.
    vertex_chi_square, vertex_degrees : (n,)
        Misfit of the edges to one point, and its degrees of freedom.
    part : (n,)
        Connected part of the graph that each vertex belongs to. Vertices of different parts are
        independent.
    joint_covariance_mm2 : tuple of (3 k, 3 k)
        For each part, joint covariance of its k vertices.
    edges : (e, 2)
        The two vertices of each edge, the smaller index first.
    posterior : (e,)
        Probability that the best match of the edge is right.
    views : (e,)
        Number of views that show the edge. An edge in two views is not confirmed by a third view.
    viewpoint_dependent : (e,)
        True if all tracks of the edge probably show no line in space: by
        `Matches.viewpoint_dependent` or by the mark "silhouette".
    chi_square, degrees : (e,)
        Misfit of the edge's lines to the rest of the graph, and its degrees of freedom; 0 degrees
        if only these lines determine the vertices.
    edge_of_track : (t,)
        Edge of each track of the matches, -1 if the track was removed.
    face, face_vertex : (m,)
        Index of the face, and index of the vertex.
    planes : (f, 4)
        Unit normal and offset in mm of each face: normal . x = offset. The vertices run
        counter-clockwise about the normal.
    planes_covariance : (f, 4, 4)
        Covariance of `planes`.
    face_chi_square, face_degrees : (f,)
        Misfit of the vertices to one plane, and its degrees of freedom.
    facing : (f,)
        True if all cameras that show the face's edges lie on the side of the normal. Otherwise most
        of them do.
    let_go : LetGo
        Line ends that do not fit, with reasons.
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
            check_index("n", "names a vertex that is not there"), parts=("vertex_1", "vertex_2")
        ),
    ]
    posterior: Annotated[Float[np.ndarray, "e"], Column(PROBABILITY)]
    views: Int[np.ndarray, "e"]
    viewpoint_dependent: Bool[np.ndarray, "e"]
    chi_square: Float[np.ndarray, "e"]
    degrees: Int[np.ndarray, "e"]
    edge_of_track: Annotated[
        Int[np.ndarray, "t"],
        Column(check_index("e", "names an edge that is not there", smallest=-1)),
    ]
    face: Annotated[
        Int[np.ndarray, "m"], Column(check_index("f", "names a face that is not there"))
    ]
    face_vertex: Annotated[Int[np.ndarray, "m"], Column(check_index("n", "names no vertex"))]
    planes: Annotated[Float[np.ndarray, "f 4"], Column(FINITE)]
    planes_covariance: Annotated[Float[np.ndarray, "f 4 4"], Column(COVARIANCE)]
    face_chi_square: Float[np.ndarray, "f"]
    face_degrees: Int[np.ndarray, "f"]
    facing: Bool[np.ndarray, "f"]
    let_go: Annotated[LetGo, Column(prefix="let_go_")]

    @property
    def checked(self) -> Bool[np.ndarray, "e"]:
        """Mask of the edges that three or more views show, (e,)."""
        return self.views > TWO_VIEWS

    @property
    def lines_mm(self) -> Float[np.ndarray, "e 2 3"]:
        """Both ends of each edge, (e, 2, 3) mm, world frame."""
        return self.vertices_mm[self.edges].reshape(-1, 2, 3)

    @property
    def corners(self) -> Bool[np.ndarray, "e 2"]:
        """Mask of the edge ends that are corners, (e, 2)."""
        return self.corner[self.edges]

    @property
    def length_mm(self) -> Float[np.ndarray, "e"]:
        """Length of each edge, (e,) mm."""
        return line_sigmas(self.lines_mm, self.covariance_mm2).length_mm

    @property
    def length_sigma_mm(self) -> Float[np.ndarray, "e"]:
        """Standard deviation of each length, (e,) mm."""
        return line_sigmas(self.lines_mm, self.covariance_mm2).length_sigma_mm

    def summary(self) -> str:
        """Return the numbers of edges, corners, free ends and faces as a sentence."""
        corners, unchecked = int(self.corner.sum()), int((~self.checked).sum())
        return (
            f"{len(self)} edges, {unchecked} of them seen by two views only; {corners} corners, "
            f"{len(self.corner) - corners} free ends, {len(self.planes)} planar faces."
        )

    def record(self) -> dict[str, Any]:
        """Return the numbers of edges, corners, free ends and faces, and the line ends that do not
        fit.
        """
        corners = int(self.corner.sum())
        unfitted_ends = zip(self.let_go.track.tolist(), self.let_go.reason.tolist(), strict=True)
        return {
            "edges": len(self),
            "edges_of_two_views": int((~self.checked).sum()),
            "corners": corners,
            "free_ends": len(self.corner) - corners,
            "faces": len(self.planes),
            "let_go": [{"track": track, "reason": reason} for track, reason in unfitted_ends],
        }

    def wires(self) -> Wires:
        """Return the edges as lines and the faces as loops, for drawing."""
        return Wires(self.vertices_mm, self.edges, np.arange(len(self)), self.faces)

    @property
    def covariance_mm2(self) -> Float[np.ndarray, "e 6 6"]:
        """Joint covariance of both ends of each edge, (e, 6, 6) mm^2."""
        covariances = [self.covariance_of(pair) for pair in self.edges]
        return np.array(covariances).reshape(-1, 6, 6)

    @property
    def vertices_covariance_mm2(self) -> Float[np.ndarray, "n 3 3"]:
        """Covariance of each vertex, (n, 3, 3) mm^2."""
        covariances = [self.covariance_of([vertex]) for vertex in range(len(self.vertices_mm))]
        return np.array(covariances).reshape(-1, 3, 3)

    @property
    def faces(self) -> list[Int[np.ndarray, "_"]]:
        """Indices of the vertices of each face, in sequence along its loop."""
        return [self.face_vertex[self.face == face] for face in range(len(self.planes))]

    @property
    def face_posterior(self) -> Float[np.ndarray, "f"]:
        """Smallest posterior of the edges of each face, (f,)."""
        posterior_of_edge = {
            tuple(pair): p for pair, p in zip(self.edges.tolist(), self.posterior.tolist())
        }
        return np.array(
            [
                min(
                    posterior_of_edge[min(a, b), max(a, b)]
                    for a, b in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True)
                )
                for loop in self.faces
            ]
        )

    def tracks_of(self, edge: int | np.integer) -> Int[np.ndarray, "_"]:
        """Return the indices of the tracks on an edge."""
        return np.flatnonzero(self.edge_of_track == edge)

    def edges_at(self, vertex: int | np.integer) -> Int[np.ndarray, "_"]:
        """Return the indices of the edges that meet at a vertex."""
        return np.flatnonzero((self.edges == vertex).any(axis=1))

    def covariance_of(
        self, vertices: Sequence[int] | Int[np.ndarray, "k"]
    ) -> Float[np.ndarray, "m m"]:
        """Return the joint covariance of k vertices, (3 k, 3 k) mm^2, with three rows for each
        vertex.
        """
        selected = np.asarray(vertices, dtype=np.int64)
        covariance = np.zeros((len(selected), 3, len(selected), 3))
        for part in np.unique(self.part[selected]).tolist():
            rows = np.flatnonzero(self.part[selected] == part)
            columns = np.searchsorted(np.flatnonzero(self.part == part), selected[rows])
            blocks = self.joint_covariance_mm2[part]
            blocks = blocks.reshape(len(blocks) // 3, 3, -1, 3)[columns][:, :, columns]
            covariance[rows[:, None], :, rows[None]] = blocks.transpose(0, 2, 1, 3)
        return covariance.reshape(3 * len(selected), 3 * len(selected))
