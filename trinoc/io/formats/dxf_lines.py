"""3-D segments as the LINE entities of a DXF (R12, which every CAD reads), a layer for each stage.

R12 has no unit of its own: tell the program that reads it millimetres.
"""

from pathlib import Path
from typing import Any

from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.losses import COVARIANCE, TRACKS
from trinoc.match import Matches


def write_dxf(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write a line for each track."""
    pairs: list[tuple[int, Any]] = [
        (999, f"trinoc: unit {unit_mm!r} mm, Z up"),
        *((0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"), (0, "ENDSEC")),
        *((0, "SECTION"), (2, "ENTITIES")),
    ]
    for stage, (start, end) in zip(
        matches.stage, (matches.lines_mm / unit_mm).tolist(), strict=True
    ):
        pairs += [(0, "LINE"), (8, str(stage).upper())]
        pairs += zip((10, 20, 30), start, strict=True)
        pairs += zip((11, 21, 31), end, strict=True)
    pairs += [(0, "ENDSEC"), (0, "EOF")]
    write_text(path, "".join(f"{code}\n{value}\n" for code, value in pairs))


dxf = Format(
    name="dxf",
    title="DXF",
    holds=("matches",),
    reads=(),
    place="file",
    endings=(".dxf",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="the world of the rig, Z up",
    loses=(COVARIANCE, TRACKS),
    write=write_dxf,
)
