"""3-D segments as lines of a Wavefront OBJ; wire frames with faces, cylinders and rims as wires."""

from pathlib import Path

import numpy as np

from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.losses import COVARIANCE, TRACKS
from trinoc.io.formats.wires import wires_of
from trinoc.match import Cylinders, Matches, Rims, Wireframe


def write_obj(value: Matches | Wireframe | Cylinders | Rims, path: Path, unit_mm: float) -> None:
    """Write two vertices and a line for each track; or vertices, lines and faces."""
    lines = [f"# unit {unit_mm!r} mm, Z up"]
    if isinstance(value, Wireframe):
        places, pairs = value.vertices_mm, value.edges
        loops = [loop.tolist() for loop in value.faces]
    elif isinstance(value, Cylinders | Rims):
        (places, pairs, _), loops = wires_of(value), []
    else:
        places, pairs = value.lines_mm.reshape(-1, 3), np.arange(2 * len(value)).reshape(-1, 2)
        loops = []
    lines.extend("v " + " ".join(map(repr, place)) for place in (places / unit_mm).tolist())
    lines.extend(f"l {one + 1} {other + 1}" for one, other in pairs.tolist())
    lines.extend("f " + " ".join(str(vertex + 1) for vertex in loop) for loop in loops)
    write_text(path, "\n".join(lines) + "\n")


obj = Format(
    name="obj",
    title="OBJ",
    holds=("matches", "wireframe", "cylinders", "rims"),
    reads=(),
    place="file",
    endings=(".obj",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="the world of the rig, Z up",
    loses=(COVARIANCE, TRACKS),
    write=write_obj,
)
