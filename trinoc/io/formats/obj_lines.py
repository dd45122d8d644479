"""3-D segments and features as lines and faces of a Wavefront OBJ."""

from pathlib import Path

from trinoc.geometry.features import Feature
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.losses import COVARIANCE, TRACKS
from trinoc.match.tracks.matches import Matches


def write_obj(value: Matches | Feature, path: Path, unit_mm: float) -> None:
    """Write vertices, lines and faces."""
    places, pairs, _, loops = value.wires()
    lines = [f"# unit {unit_mm!r} mm, Z up"]
    lines.extend("v " + " ".join(map(repr, place)) for place in (places / unit_mm).tolist())
    lines.extend(f"l {one + 1} {other + 1}" for one, other in pairs.tolist())
    lines.extend("f " + " ".join(str(v + 1) for v in loop.tolist()) for loop in loops)
    write_text(path, "\n".join(lines) + "\n")


obj = Format(
    name="obj",
    title="OBJ",
    holds=("matches", "features"),
    reads=(),
    place="file",
    endings=(".obj",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="the world of the rig, Z up",
    loses=(COVARIANCE, TRACKS),
    write=write_obj,
)
