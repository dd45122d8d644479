"""3-D segments as the lines of a Wavefront OBJ."""

from pathlib import Path

from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.losses import COVARIANCE, TRACKS
from trinoc.match import Matches


def write_obj(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write two vertices and a line for each track."""
    lines = [f"# unit {unit_mm!r} mm, Z up"]
    for end in (matches.lines_mm / unit_mm).reshape(-1, 3).tolist():
        lines.append("v " + " ".join(map(repr, end)))
    lines.extend(f"l {2 * track + 1} {2 * track + 2}" for track in range(len(matches)))
    write_text(path, "\n".join(lines) + "\n")


obj = Format(
    name="obj",
    title="OBJ",
    holds=("matches",),
    reads=(),
    place="file",
    endings=(".obj",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="the world of the rig, Z up",
    loses=(COVARIANCE, TRACKS),
    write=write_obj,
)
