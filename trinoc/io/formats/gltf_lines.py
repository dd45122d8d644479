"""3-D segments and features as the line primitives of a glTF 2.0, .glb or .gltf.

glTF counts in metres with y up: (x, y, z) of the world becomes (x, z, -y) / 1000, in single
precision, which is finer than .1 um on a bench.
"""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.features import Feature
from trinoc.io.atomic import atomic_write, write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.losses import COVARIANCE, TRACKS
from trinoc.match.tracks.matches import Matches

METRE_MM = 1000.0
# Of the specification: line segments, single precision, the target of vertices, and chunks.
LINES, FLOAT, ARRAY_BUFFER = 1, 5126, 34962
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"


def write_gltf(value: Matches | Feature, path: Path, unit_mm: float) -> None:
    """Write one mesh of lines. Raises InputError where there is none: glTF has no empty mesh."""
    if len(value) == 0:
        raise InputError(f"{path} was not written: there is no 3-D segment, and glTF needs one.")
    wires = value.wires()
    x, y, z = (wires.places_mm[wires.pairs.reshape(-1)] / unit_mm).T
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
    reads=(),
    place="file",
    endings=(".glb", ".gltf"),
    unit_mm=METRE_MM,
    unit_is_fixed=True,
    frames="x right, y up (the world's Z), z back (the world's -Y)",
    loses=(COVARIANCE, TRACKS),
    write=write_gltf,
)
