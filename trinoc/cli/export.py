"""`trinoc export`: cameras, lines and segments as files of other tools, and back from them."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from trinoc.cli.command import LOGGER, Command, Outcome, UsageError
from trinoc.cli.views import files_of_views
from trinoc.errors import InputError

if TYPE_CHECKING:
    from trinoc.geometry.intrinsics import Intrinsics
from typing import Literal

ReadFormat = Literal[
    "opencv",
    "ros",
    "kalibr",
    "colmap",
    "colmap-text",
    "mrcal",
    "matlab",
    "nerfstudio",
    "tf",
    "lsd",
    "elsed",
    "limap-segments",
]
WrittenFormat = Literal[
    "opencv",
    "ros",
    "kalibr",
    "colmap",
    "colmap-text",
    "mrcal",
    "matlab",
    "nerfstudio",
    "tf",
    "ply",
    "obj",
    "gltf",
    "dxf",
    "csv",
    "parquet",
    "limap",
    "json",
    "lsd",
    "elsed",
    "limap-segments",
]
UnitMm = Annotated[
    float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="(default: of the format)")
]


_NONE = "(default: none)"


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExportCommand(Command):
    """Write cameras, 3-D segments, features or segments of a picture as another tool reads them
    (--to), or read what another tool wrote (--from)."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """With --to, a file of trinoc: rig.json, camera.json or an npz. With --from, the other tool's
    file or folder."""

    to: Annotated[
        WrittenFormat | None, tyro.conf.arg(metavar="FORMAT", help_behavior_hint=_NONE)
    ] = None
    """Cameras: opencv, ros, kalibr, colmap, colmap-text, mrcal, matlab, nerfstudio, tf. Matches:
    ply, obj, gltf, dxf, csv, parquet, limap. Wire frames, cylinders, rims: ply, obj, gltf, dxf, and
    json for wire frames. Segments: lsd, elsed, limap-segments."""

    source: Annotated[
        ReadFormat | None,
        tyro.conf.arg(name="from", metavar="FORMAT", help_behavior_hint=_NONE),
    ] = None
    """The same of cameras and segments."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",), metavar="OUT")]
    """Where it goes: with --to, a file, or a new folder for formats of several files; with --from,
    rig.json, camera.json for a lens alone, segments.npz for segments."""

    unit_mm: UnitMm = None
    """Length in mm of one unit of the other tool's file, such as 1000 for metres; by default that
    of the format."""

    names: Annotated[
        str | None, tyro.conf.arg(metavar="A,B,C", help_behavior_hint="(default: of the file)")
    ] = None
    """With --from: names for the cameras, with commas between, in the order of the file."""

    lens: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="FILE", help_behavior_hint="(for --from tf)"),
    ] = ()
    """The lenses of a file that holds poses alone: rig.json, or NAME=camera.json for each."""

    def run(self, command_line: str) -> Outcome:
        """Read, check and write, in one direction."""
        if (self.to is None) == (self.source is None):
            raise UsageError("Give the other tool's format: --to, to write it, or --from, to read.")
        return self._read(command_line) if self.to is None else self._write(self.to)

    def _write(self, name: str) -> Outcome:
        from trinoc.geometry.intrinsics import Intrinsics
        from trinoc.io.formats.format import LOSSES
        from trinoc.io.formats.registry import FORMATS
        from trinoc.io.intrinsics_json import load_lens_covariance
        from trinoc.io.saving import expect_foreign, load

        if self.names is not None or self.lens:
            raise UsageError("--names and --lens go with --from: leave them out.")
        target = FORMATS[name]
        expect_foreign(self.out, force=self.force)
        value = load(self.file)
        target.save(value, self.out, unit_mm=self.unit_mm)
        lost = target.lost(value)
        if isinstance(value, Intrinsics) and load_lens_covariance(self.file) is not None:
            lost = (LOSSES["covariance"], *lost)
        if lost:
            LOGGER.warning("%s cannot hold, and so loses: %s", target.title, "; ".join(lost))
        record = {"format": target.name, "lost": list(lost)}
        return Outcome(f"{target.title}: {target.frames}", record, written=(self.out,))

    def _read(self, command_line: str) -> Outcome:
        from trinoc.cli.command import provenance
        from trinoc.geometry.rig import Rig
        from trinoc.geometry.segments import Segments
        from trinoc.io.atomic import expect_place
        from trinoc.io.formats.registry import FORMATS
        from trinoc.io.saving import expect_replaceable, save

        expect_place(self.out)
        source = FORMATS[str(self.source)]
        names = None if self.names is None else [name.strip() for name in self.names.split(",")]
        lenses = self._lenses()
        value = source.load(self.file, unit_mm=self.unit_mm, lenses=lenses, names=names)
        expect_replaceable(self.out, type(value), force=self.force)
        save(value, self.out, provenance=provenance(command_line, self._inputs()))
        match value:
            case Rig():
                known = "with" if value.parameters else "without"
                found = f"{len(value)} cameras, {known} covariance: {', '.join(value.names)}"
            case Segments():
                found = f"{len(value)} segments, with sigmas of a plain detector"
            case _:
                found = "a lens, without covariance"
        record = {
            "format": source.name,
            "cameras": list(value.names) if isinstance(value, Rig) else [],
            "segments": len(value) if isinstance(value, Segments) else 0,
        }
        return Outcome(found, record, written=(self.out,))

    def _lenses(self) -> "dict[str, Intrinsics] | None":
        from trinoc.io.intrinsics_json import load_intrinsics
        from trinoc.io.rig_json import load_rig

        if not self.lens:
            return None
        if len(self.lens) == 1 and "=" not in self.lens[0]:
            return {name: camera.intrinsics for name, camera in load_rig(self.lens[0]).items()}
        return {name: load_intrinsics(file) for name, file in files_of_views(self.lens).items()}

    def _inputs(self) -> dict[str, Path]:
        if not self.file.is_dir():
            return {"file": self.file}
        try:
            return {file.name: file for file in sorted(self.file.iterdir()) if file.is_file()}
        except OSError as error:
            raise InputError(f"{self.file} cannot be read ({error.strerror}).") from error
