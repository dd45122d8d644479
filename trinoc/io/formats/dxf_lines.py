"""3-D segments as the LINE entities of a DXF (R12, which every CAD reads), a layer for each stage.

A wire frame has its edges on two layers, those of three views and those of two, and its faces as
3DFACE on a third, in triangles where they have more than four corners. Other features have a layer
of their kind.

R12 has no unit of its own: tell the program that reads it millimetres.
"""

from pathlib import Path
from typing import Any

from trinoc.geometry.features import Feature
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.losses import COVARIANCE, TRACKS
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.wire_frame.frame import Wireframe

# Of 3DFACE, a bit for each edge that is not drawn.
HIDDEN_FIRST, HIDDEN_THIRD = 1, 4


def write_dxf(value: Matches | Feature, path: Path, unit_mm: float) -> None:
    """Write the lines and the faces, on a layer for each stage or kind."""
    pairs: list[tuple[int, Any]] = [
        (999, f"trinoc: unit {unit_mm!r} mm, Z up"),
        *((0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"), (0, "ENDSEC")),
        *((0, "SECTION"), (2, "ENTITIES")),
    ]
    wires = value.wires()
    places = wires.places_mm / unit_mm
    layers = _layers(value)
    for row, (start, end) in zip(wires.owner, places[wires.pairs].tolist(), strict=True):
        pairs += [(0, "LINE"), (8, layers[row].upper())]
        pairs += zip((10, 20, 30), start, strict=True)
        pairs += zip((11, 21, 31), end, strict=True)
    for loop in wires.loops:
        pairs += _face(places[loop].tolist())
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
    """One 3DFACE of three corners or four, or a fan of triangles."""
    count = len(corners)
    parts = [(list(range(count)), 0)]
    if count > 4:
        parts = [
            ([0, k, k + 1], HIDDEN_FIRST * (k > 1) + HIDDEN_THIRD * (k < count - 2))
            for k in range(1, count - 1)
        ]
    pairs: list[tuple[int, Any]] = []
    for chosen, hidden in parts:
        pairs += [(0, "3DFACE"), (8, "FACES")]
        # A triangle has its last corner twice.
        for number, vertex in enumerate((*chosen, chosen[-1])[:4]):
            pairs += zip((10 + number, 20 + number, 30 + number), corners[vertex], strict=True)
        pairs.append((70, hidden))
    return pairs


dxf = Format(
    name="dxf",
    title="DXF",
    holds=("matches", "features"),
    reads=(),
    place="file",
    endings=(".dxf",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="the world of the rig, Z up",
    loses=(COVARIANCE, TRACKS),
    write=write_dxf,
)
