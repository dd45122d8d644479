"""3-D segments and features as drawings: OBJ, glTF 2.0 and DXF.

glTF has metres with y up: (x, y, z) mm of the world becomes (x, z, -y) / 1000, in single precision.

DXF is R12, which all CAD programs read: LINE entities, with a layer for each stage of matching. A
wire frame has a layer for edges of three views, one for edges of two views, and one for faces.
Faces are 3DFACE entities, in triangles if they have more than four corners. Other features have a
layer for their kind. R12 does not state a unit: select millimetres in the program that reads it.
"""

import base64
import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.features import Feature
from trinoc.io.atomic import atomic_write, write_text
from trinoc.io.formats.format import COVARIANCE, METRE_MM, TRACKS, Format
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.wire_frame.frame import Wireframe

# Of the specification: line segments, single precision, the target of vertices, and chunks.
LINES, FLOAT, ARRAY_BUFFER = 1, 5126, 34962
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"


def write_gltf(value: Matches | Feature, path: Path, unit_mm: float) -> None:
    """Write all lines as one glTF mesh, in .gltf or .glb. Faces are not written.

    Lengths are in units of `unit_mm`. Raise `InputError` if there is no line: glTF has no empty
    mesh.
    """
    if len(value) == 0:
        raise InputError(
            f"{path} was not written: there is no 3-D segment, and glTF needs at least one."
        )
    wires = value.wires()
    x, y, z = (wires.points_mm[wires.pairs.reshape(-1)] / unit_mm).T
    vertices = np.stack([x, z, -y], axis=1).astype("<f4")
    content = vertices.tobytes()
    if path.suffix.lower() == ".gltf":
        data = base64.b64encode(content).decode("ascii")
        document = _document(vertices, {"uri": f"data:application/octet-stream;base64,{data}"})
        write_text(path, json.dumps(document, indent=2) + "\n")
        return
    text = json.dumps(_document(vertices, {})).encode("ascii")
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(content)
    with atomic_write(path) as file:
        file.write(b"glTF" + struct.pack("<II", 2, size))
        file.write(struct.pack("<I", len(text)) + JSON_CHUNK + text)
        file.write(struct.pack("<I", len(content)) + BINARY_CHUNK + content)


def _document(vertices: np.ndarray, source: dict[str, str]) -> dict[str, Any]:
    size = vertices.nbytes
    return {
        "asset": {"version": "2.0", "generator": "trinoc"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "segments"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": LINES}]}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": FLOAT,
                "count": len(vertices),
                "type": "VEC3",
                "min": vertices.min(axis=0).tolist(),
                "max": vertices.max(axis=0).tolist(),
            }
        ],
        "bufferViews": [{"buffer": 0, "byteLength": size, "target": ARRAY_BUFFER}],
        "buffers": [{"byteLength": size, **source}],
    }


gltf = Format(
    name="gltf",
    title="glTF",
    holds=("matches", "features"),
    endings=(".glb", ".gltf"),
    unit_mm=METRE_MM,
    unit_is_fixed=True,
    frames="x right, y up (the world's Z), z back (the world's -Y)",
    loses=(COVARIANCE, TRACKS),
    write=write_gltf,
)


def write_obj(value: Matches | Feature, path: Path, unit_mm: float) -> None:
    """Write vertices, lines and faces as OBJ; lengths in units of `unit_mm`."""
    points_mm, pairs, _, loops = value.wires()
    lines = [f"# unit {unit_mm!r} mm, Z up"]
    lines.extend("v " + " ".join(map(repr, point)) for point in (points_mm / unit_mm).tolist())
    lines.extend(f"l {start + 1} {end + 1}" for start, end in pairs.tolist())
    lines.extend("f " + " ".join(str(v + 1) for v in loop.tolist()) for loop in loops)
    write_text(path, "\n".join(lines) + "\n")


obj = Format(
    name="obj",
    title="OBJ",
    holds=("matches", "features"),
    endings=(".obj",),
    frames="the world of the rig, Z up",
    loses=(COVARIANCE, TRACKS),
    write=write_obj,
)


# Of 3DFACE, a bit for each edge that is not drawn.
HIDDEN_FIRST, HIDDEN_THIRD = 1, 4


def write_dxf(value: Matches | Feature, path: Path, unit_mm: float) -> None:
    """Write lines and faces as DXF R12; lengths in units of `unit_mm`.

    Tracks have a layer for each stage of matching, other features a layer for their kind.
    """
    pairs: list[tuple[int, Any]] = [
        (999, f"trinoc: unit {unit_mm!r} mm, Z up"),
        *((0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"), (0, "ENDSEC")),
        *((0, "SECTION"), (2, "ENTITIES")),
    ]
    wires = value.wires()
    points = wires.points_mm / unit_mm
    layers = _layers(value)
    for row, (start, end) in zip(wires.owner, points[wires.pairs].tolist(), strict=True):
        pairs += [(0, "LINE"), (8, layers[row].upper())]
        pairs += zip((10, 20, 30), start, strict=True)
        pairs += zip((11, 21, 31), end, strict=True)
    for loop in wires.loops:
        pairs += _face(points[loop].tolist())
    pairs += [(0, "ENDSEC"), (0, "EOF")]
    write_text(path, "".join(f"{code}\n{value}\n" for code, value in pairs))


def _layers(value: Matches | Feature) -> list[str]:
    match value:
        case Matches():
            return list(map(str, value.stage))
        case Wireframe():
            return [TRINOCULAR if checked else BINOCULAR for checked in value.checked]
    return [value.KIND] * len(value)


def _face(corners: list[list[float]]) -> list[tuple[int, Any]]:
    """DXF (code, value) pairs of a face: one 3DFACE, or triangles if it has over four corners."""
    count = len(corners)
    polygons = [(list(range(count)), 0)]
    if count > 4:
        polygons = [
            ([0, k, k + 1], HIDDEN_FIRST * (k > 1) + HIDDEN_THIRD * (k < count - 2))
            for k in range(1, count - 1)
        ]
    pairs: list[tuple[int, Any]] = []
    for corner_indices, hidden_edges in polygons:
        pairs += [(0, "3DFACE"), (8, "FACES")]
        # A triangle has its last corner twice.
        for position, vertex in enumerate((*corner_indices, corner_indices[-1])[:4]):
            pairs += zip(
                (10 + position, 20 + position, 30 + position), corners[vertex], strict=True
            )
        pairs.append((70, hidden_edges))
    return pairs


dxf = replace(obj, name="dxf", title="DXF", endings=(".dxf",), write=write_dxf)
