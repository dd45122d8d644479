"""Wire frame files: every field of `Wireframe` as an npz."""

import dataclasses
import os

import numpy as np

from trinoc.io.array_checks import LARGEST_MM, ArrayFields, is_covariance
from trinoc.io.arrays_npz import read_arrays, write_arrays
from trinoc.match import LetGo, Wireframe

FORMAT, VERSION = "trinoc-wireframe", 1
_JOINT, _LET_GO = "joint_covariance_mm2", "let_go"


def save_wireframe(frame: Wireframe, path: str | os.PathLike[str]) -> None:
    """Write a wire frame as npz, whole or not at all."""
    names = [field.name for field in dataclasses.fields(frame)]
    arrays = {
        name: value
        for name in names
        if name not in (_JOINT, _LET_GO) and (value := getattr(frame, name)) is not None
    }
    blocks = [np.asarray(block).reshape(-1) for block in frame.joint_covariance_mm2]
    arrays[_JOINT] = np.concatenate([*blocks, np.zeros(0)])
    arrays["let_go_track"] = np.array([each.track for each in frame.let_go], dtype=np.int64)
    places = [each.place_mm for each in frame.let_go]
    arrays["let_go_place_mm"] = np.array(places, dtype=np.float64).reshape(-1, 3)
    reasons = [each.reason for each in frame.let_go]
    arrays["let_go_reason"] = np.array(reasons, dtype=np.str_) if reasons else np.array([], "<U1")
    write_arrays(path, FORMAT, VERSION, arrays)


def load_wireframe(path: str | os.PathLike[str]) -> Wireframe:
    """Read a wire frame that `save` wrote.

    Raises InputError for another file, and, with the field and the first row, for what no wire
    frame can have: vertices that do not exist, places that are not finite, covariances that are
    none, probabilities outside [0, 1].
    """
    fields = ArrayFields(read_arrays(path, FORMAT, VERSION), path)
    vertices = fields.take("vertices_mm", "f", (None, 3), "vertices")
    count = len(vertices)
    fields.expect(
        "vertices_mm", np.abs(vertices) < LARGEST_MM, "is not finite or beyond all scenes"
    )
    edges = fields.take("edges", "i", (None, 2), "edges")
    fields.expect("edges", (edges >= 0) & (edges < count), "names a vertex that is not there")
    planes = fields.take("planes", "f", (None, 4), "faces")
    fields.expect("planes", np.isfinite(planes), "is not finite")
    face = fields.take("face", "i", (None,), "rows of faces")
    fields.expect("face", (face >= 0) & (face < len(planes)), "names a face that is not there")
    of_face = fields.take("face_vertex", "i", face.shape, f"{len(face)} rows of faces")
    fields.expect("face_vertex", (of_face >= 0) & (of_face < count), "names no vertex")
    edge_of_track = fields.take("edge_of_track", "i", (None,), "tracks")
    known = (edge_of_track >= -1) & (edge_of_track < len(edges))
    fields.expect("edge_of_track", known, "names an edge that is not there")

    def of_vertices(name: str, kind: str) -> np.ndarray:
        return fields.take(name, kind, (count,), f"{count} vertices")

    def of_edges(name: str, kind: str) -> np.ndarray:
        return fields.take(name, kind, (len(edges),), f"{len(edges)} edges")

    def of_faces(name: str, kind: str, *more: int) -> np.ndarray:
        return fields.take(name, kind, (len(planes), *more), f"{len(planes)} faces")

    posterior = of_edges("posterior", "f")
    fields.expect("posterior", (posterior >= 0) & (posterior <= 1 + 1e-9), "is no probability")
    of_planes = of_faces("planes_covariance", "f", 4, 4)
    fields.expect("planes_covariance", is_covariance(of_planes), "is no covariance")
    # Known where shadows were looked for, and to no earlier trinoc.
    shadow = of_edges("shadow", "f") if "shadow" in fields else None
    if shadow is not None:
        fields.expect("shadow", (shadow >= 0) & (shadow <= 1 + 1e-9), "is no probability")
    part = of_vertices("part", "i")
    return Wireframe(
        vertices_mm=vertices,
        corner=of_vertices("corner", "b"),
        vertex_chi_square=of_vertices("vertex_chi_square", "f"),
        vertex_degrees=of_vertices("vertex_degrees", "i"),
        part=part,
        joint_covariance_mm2=_blocks(fields, part),
        edges=edges,
        posterior=posterior,
        views=of_edges("views", "i"),
        viewpoint_dependent=of_edges("viewpoint_dependent", "b"),
        chi_square=of_edges("chi_square", "f"),
        degrees=of_edges("degrees", "i"),
        edge_of_track=edge_of_track,
        face=face,
        face_vertex=of_face,
        planes=planes,
        planes_covariance=of_planes,
        face_chi_square=of_faces("face_chi_square", "f"),
        face_degrees=of_faces("face_degrees", "i"),
        facing=of_faces("facing", "b"),
        let_go=_let_go(fields),
        shadow=shadow,
    )


def _blocks(fields: ArrayFields, part: np.ndarray) -> tuple[np.ndarray, ...]:
    """The joint covariance of each part."""
    parts = int(part.max(initial=-1)) + 1
    sizes = np.bincount(part, minlength=parts) if len(part) and part.min() >= 0 else np.zeros(0)
    fields.expect("part", np.array([len(part) == 0 or len(sizes) > 0]), "is no part")
    fields.expect("part", np.array([bool((sizes > 0).all())]), "leaves a part without a vertex")
    wanted = [3 * int(size) for size in sizes]
    flat = fields.take(_JOINT, "f", (sum(size**2 for size in wanted),), f"{parts} parts")
    ends = np.cumsum([0, *(size**2 for size in wanted)]).tolist()
    blocks = tuple(
        flat[start : start + size**2].reshape(size, size)
        for start, size in zip(ends, wanted, strict=False)
    )
    good = [bool(is_covariance(block[None])[0]) for block in blocks]
    fields.expect(_JOINT, np.array(good, dtype=bool), "is no covariance")
    return blocks


def _let_go(fields: ArrayFields) -> tuple[LetGo, ...]:
    track = fields.take("let_go_track", "i", (None,), "rows of what was let go")
    place = fields.take("let_go_place_mm", "f", (len(track), 3), f"{len(track)} rows")
    reason = fields.take("let_go_reason", "U", (len(track),), f"{len(track)} rows")
    rows = zip(track.tolist(), place.tolist(), reason.tolist(), strict=True)
    return tuple(LetGo(number, tuple(where), str(words)) for number, where, words in rows)
