"""`trinoc export`: cameras, lines and segments as files of other tools."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from trinoc.cli.command import Command, Outcome
from trinoc.cli.format_names import UnitMm, WrittenFormat
from trinoc.cli.progress import LOGGER


@dataclasses.dataclass(frozen=True, kw_only=True)
class Export(Command):
    """Write cameras, 3-D segments or segments of a picture as another tool reads them."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """What to write: rig.json, camera.json, matches.npz, wireframe.npz, cylinders.npz,
    rims.npz or segments.npz."""

    to: Annotated[WrittenFormat, tyro.conf.arg(metavar="FORMAT")]
    """Cameras: opencv, ros, kalibr, colmap, colmap-text, mrcal, matlab, nerfstudio, tf. Matches:
    ply, obj, gltf, dxf, csv, parquet, limap. Wire frames: ply, obj, dxf, json. Cylinders: ply,
    obj. Rims: obj. Segments: lsd, elsed, limap-segments."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",), metavar="OUT")]
    """Where it goes: a file, or a new folder for formats of several files."""

    unit_mm: UnitMm = None
    """Length in mm of one unit of the file, such as 1000 for metres; by default that of the
    format."""

    def run(self, command_line: str) -> Outcome:
        """Read, write, and say what the format cannot hold."""
        from trinoc.geometry import Intrinsics
        from trinoc.io import FORMATS, LOSSES, load, load_lens_covariance

        target = FORMATS[self.to]
        value = load(self.file)
        target.save(value, self.out, unit_mm=self.unit_mm)
        lost = target.lost(value)
        if isinstance(value, Intrinsics) and load_lens_covariance(self.file) is not None:
            lost = (LOSSES["covariance"], *lost)
        if lost:
            LOGGER.warning("%s cannot hold, and so loses: %s", target.title, "; ".join(lost))
        record = {"format": target.name, "lost": list(lost), "written": [str(self.out)]}
        return Outcome(f"{target.title}: {target.frames}\nwritten: {self.out}", record)
