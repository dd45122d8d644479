"""`trinoc export`: cameras, lines and segments as files of other tools, and back from them."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from trinoc.cli.command import LOGGER, Command, Outcome, UsageError
from trinoc.cli.views import files_of_views, warn_of_folds
from trinoc.errors import InputError, list_names

if TYPE_CHECKING:
    from trinoc.geometry.intrinsics import Intrinsics

ReadFormat = Literal[
    "opencv",
    "ros",
    "kalibr",
    "colmap",
    "colmap-text",
    "mrcal",
    "matlab",
    "nerfstudio",
    "anipose",
    "caliscope",
    "multical",
    "mc-calib",
    "easymocap",
    "metashape",
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
    "anipose",
    "caliscope",
    "multical",
    "mc-calib",
    "easymocap",
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
    (--to), or read what another tool wrote, or videos (--from)."""

    files: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="FILE|NAME=VIDEO", help_behavior_hint="(required)"),
    ]
    """With --to, a file of trinoc: rig.json, camera.json or an npz. With --from, the other tool's
    file or folder; with --from video, that of each camera."""

    to: Annotated[
        WrittenFormat | None, tyro.conf.arg(metavar="FORMAT", help_behavior_hint=_NONE)
    ] = None
    """Cameras: opencv, ros, kalibr, colmap, colmap-text, mrcal, matlab, nerfstudio, anipose,
    caliscope, multical, mc-calib, easymocap, tf. Matches: ply, obj, gltf, dxf, csv, parquet, limap.
    Wire frames, rims: ply, obj, gltf, dxf, and json for wire frames. Segments: lsd, elsed,
    limap-segments."""

    source: Annotated[
        ReadFormat | Literal["video"] | None,
        tyro.conf.arg(name="from", metavar="FORMAT", help_behavior_hint=_NONE),
    ] = None
    """The same of cameras and segments, and metashape; or video, whose frames become pictures."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",), metavar="OUT")]
    """Where it goes: with --to, a file, or a new folder for formats of several files; with --from,
    rig.json, camera.json for a lens alone, segments.npz for segments, a new folder for frames."""

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

    every_s: float = 0.0
    """With --from video: one frame in so many seconds; 0 takes every frame."""

    def run(self, command_line: str) -> Outcome:
        """Read, check and write, in one direction."""
        if (self.to is None) == (self.source is None):
            raise UsageError("Give the other tool's format: --to, to write it, or --from, to read.")
        if self.source == "video":
            return self._write_frames()
        if len(self.files) != 1:
            raise UsageError(f"{len(self.files)} files are given: give one.")
        file = Path(self.files[0])
        return self._read(file, command_line) if self.to is None else self._write(file, self.to)

    def _write(self, file: Path, name: str) -> Outcome:
        from trinoc.geometry.intrinsics import Intrinsics
        from trinoc.io.formats.format import LOSSES
        from trinoc.io.formats.registry import FORMATS
        from trinoc.io.intrinsics_json import load_lens_covariance
        from trinoc.io.saving import expect_foreign, load

        if self.names is not None or self.lens:
            raise UsageError("--names and --lens go with --from: leave them out.")
        target = FORMATS[name]
        expect_foreign(self.out, force=self.force)
        value = load(file)
        target.save(value, self.out, unit_mm=self.unit_mm)
        lost = target.lost(value)
        if isinstance(value, Intrinsics) and load_lens_covariance(file) is not None:
            lost = (LOSSES["covariance"], *lost)
        if lost:
            LOGGER.warning("%s cannot hold, and so loses: %s", target.title, "; ".join(lost))
        record = {"format": target.name, "lost": list(lost)}
        return Outcome(f"{target.title}: {target.frames}", record, written=(self.out,))

    def _read(self, file: Path, command_line: str) -> Outcome:
        from trinoc.cli.command import provenance
        from trinoc.geometry.intrinsics import Intrinsics
        from trinoc.geometry.rig import Rig
        from trinoc.geometry.segments import Segments
        from trinoc.io.atomic import expect_place
        from trinoc.io.formats.registry import FORMATS
        from trinoc.io.saving import expect_replaceable, save

        expect_place(self.out)
        source = FORMATS[str(self.source)]
        names = None if self.names is None else [name.strip() for name in self.names.split(",")]
        lenses = self._lenses()
        value = source.load(file, unit_mm=self.unit_mm, lenses=lenses, names=names)
        if isinstance(value, Rig | Intrinsics):
            warn_of_folds(value, file)
        expect_replaceable(self.out, type(value), force=self.force)
        save(
            value, self.out, provenance=provenance(command_line, _list_inputs(file)), overwrite=True
        )
        match value:
            case Rig():
                known = "with" if value.parameters else "without"
                found = f"{len(value)} cameras, {known} covariance: {list_names(value)}"
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

    def _write_frames(self) -> Outcome:
        """Write the frames of synchronized videos, in one folder per camera."""
        if self.unit_mm is not None or self.names is not None or self.lens:
            raise UsageError("--unit-mm, --names and --lens go with other formats: leave them out.")
        files = files_of_views(self.files, guess=True)
        if not files:
            raise UsageError("No video is given: write NAME=VIDEO for each camera.")
        if len({file.resolve() for file in files.values()}) < len(files):
            raise UsageError("Two cameras are given one video: give each its own.")

        from trinoc.io.videos import compare_videos, open_videos, write_frames

        videos = open_videos(files)
        for remark in compare_videos(list(videos.values())):
            LOGGER.warning("%s", remark)
        count = write_frames(videos, self.out, self.every_s, LOGGER.warning)
        sizes = {name: list(video.size_px) for name, video in videos.items()}
        names = ", ".join(
            f"{name} ({width} x {height} px)" for name, (width, height) in sizes.items()
        )
        return Outcome(
            f"{count} frames of {names}", {"frames": count, "cameras": sizes}, written=(self.out,)
        )


def _list_inputs(file: Path) -> dict[str, Path]:
    if not file.is_dir():
        return {"file": file}
    try:
        return {each.name: each for each in sorted(file.iterdir()) if each.is_file()}
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror}).") from error
