"""`trinoc export`: cameras, lines and segments as files of other tools, and back from them."""

from pathlib import Path
from typing import Literal

import trinoc
from trinoc.cli.command import LOGGER, Job, Outcome, UsageError
from trinoc.cli.views import files_of_views, named_files, warn_of_folds
from trinoc.errors import InputError, list_names

# Written out, because the formats themselves take long to import.
_Cameras = Literal["opencv", "ros", "kalibr", "colmap", "colmap-text", "mrcal", "matlab",
                   "nerfstudio", "anipose", "caliscope", "multical", "mc-calib",
                   "easymocap"]  # fmt: skip
_Segments = Literal["lsd", "elsed", "limap-segments"]
ReadFormat = Literal[_Cameras, "metashape", "tf", _Segments]
WrittenFormat = Literal[_Cameras, "tf", "ply", "obj", "gltf", "dxf", "csv", "parquet", "limap",
                        "json", _Segments]  # fmt: skip


def export(
    files: tuple[str, ...],
    /,
    *,
    to: WrittenFormat | None = None,
    from_: ReadFormat | Literal["video"] | None = None,
    out: Path,
    unit_mm: float | None = None,
    names: str | None = None,
    lens: tuple[str, ...] = (),
    every_s: float = 0.0,
    job: Job,
) -> Outcome:
    """Convert files of trinoc for another tool (--to), or files of another tool or videos (--from).

    Parameters
    ----------
    files : FILE|NAME=VIDEO
        With --to, a file of trinoc: rig.json, camera.json or an npz file. With --from, the file or
        folder of the other tool. With --from video, the video of each camera.
    to : FORMAT
        Cameras: opencv, ros, kalibr, colmap, colmap-text, mrcal, matlab, nerfstudio, anipose,
        caliscope, multical, mc-calib, easymocap, tf. Matches: ply, obj, gltf, dxf, csv, parquet,
        limap. Wire frames, rims: ply, obj, gltf, dxf, and json for wire frames. Segments: lsd,
        elsed, limap-segments.
    from_ : FORMAT
        The same formats of cameras and segments, and metashape. video: extract frames as images.
    out : OUT
        Output. With --to, a file, or a new folder for formats of several files. With --from,
        rig.json, camera.json for a single lens, segments.npz, or a new folder for frames.
    unit_mm : MM (default: of the format)
        Length in mm of one unit of the other tool's file, such as 1000 for metres.
    names : A,B,C (default: of the file)
        With --from: names of the cameras, in the order of the file, separated by commas.
    lens : FILE (for --from tf)
        Lenses for a file that has poses only: rig.json, or NAME=camera.json for each camera.
    every_s
        With --from video: interval between extracted frames in seconds. 0 extracts every frame.
    """
    if (to is None) == (from_ is None):
        raise UsageError(
            "The format of the other tool is missing: add --to FORMAT to write, or --from FORMAT "
            "to read."
        )
    if from_ == "video":
        if unit_mm is not None or names is not None or lens:
            raise UsageError(
                "--unit-mm, --names and --lens are not options of this format: omit these options."
            )
        return _write_frames(files, out, every_s)
    if len(files) != 1:
        raise UsageError(f"{len(files)} files are given: give one.")
    file = Path(files[0])
    if to is None:
        labels = None if names is None else [name.strip() for name in names.split(",")]
        return _read(file, str(from_), out, unit_mm, _lenses(lens), labels, job)
    if names is not None or lens:
        raise UsageError("--names and --lens are options of --from: omit --names and --lens.")
    return _write(file, to, out, unit_mm, job)


def _write(file: Path, name: str, out: Path, unit_mm: float | None, job: Job) -> Outcome:
    from trinoc.io.formats.format import LOSSES
    from trinoc.io.intrinsics_json import load_lens_covariance
    from trinoc.io.saving import expect_foreign

    target = trinoc.io.FORMATS[name]
    expect_foreign(out, force=job.force)
    value = trinoc.load(file)
    target.save(value, out, unit_mm=unit_mm)
    lost = target.lost(value)
    if isinstance(value, trinoc.Intrinsics) and load_lens_covariance(file) is not None:
        lost = (LOSSES["covariance"], *lost)
    if lost:
        LOGGER.warning("%s cannot contain, and therefore loses: %s", target.title, "; ".join(lost))
    record = {"format": target.name, "lost": list(lost)}
    return Outcome(f"{target.title}: {target.frames}", record, written=(out,))


def _read(
    file: Path,
    name: str,
    out: Path,
    unit_mm: float | None,
    lenses: "dict[str, trinoc.Intrinsics] | None",
    names: list[str] | None,
    job: Job,
) -> Outcome:
    from trinoc.io.atomic import expect_place

    expect_place(out)
    value = trinoc.io.FORMATS[name].load(file, unit_mm=unit_mm, lenses=lenses, names=names)
    if isinstance(value, trinoc.Rig | trinoc.Intrinsics):
        warn_of_folds(value, file)
    job.expect(type(value), out)
    trinoc.save(value, out, provenance=job.provenance(_list_inputs(file)), overwrite=True)
    match value:
        case trinoc.Rig():
            known = "with" if value.parameters else "without"
            text = f"{len(value)} cameras, {known} covariance: {list_names(value)}"
        case trinoc.Segments():
            text = f"{len(value)} segments, with sigmas of a plain detector"
        case _:
            text = "a lens, without covariance"
    record = {
        "format": name,
        "cameras": list(value.names) if isinstance(value, trinoc.Rig) else [],
        "segments": len(value) if isinstance(value, trinoc.Segments) else 0,
    }
    return Outcome(text, record, written=(out,))


def _lenses(arguments: tuple[str, ...]) -> "dict[str, trinoc.Intrinsics] | None":
    if not arguments:
        return None
    if len(arguments) == 1 and "=" not in arguments[0]:
        return {name: camera.intrinsics for name, camera in trinoc.load_rig(arguments[0]).items()}
    return {
        name: trinoc.io.load_intrinsics(file) for name, file in files_of_views(arguments).items()
    }


def _write_frames(arguments: tuple[str, ...], out: Path, every_s: float) -> Outcome:
    """Write the frames of synchronised videos into one folder for each camera.

    arguments : NAME=VIDEO. every_s : interval between frames in seconds; 0 for every frame.
    """
    files = named_files(arguments, wanted="video")
    if len({file.resolve() for file in files.values()}) < len(files):
        raise UsageError("Two cameras have the same video: give each camera its own video.")

    from trinoc.io.videos import compare_videos, open_videos, write_frames

    videos = open_videos(files)
    for remark in compare_videos(list(videos.values())):
        LOGGER.warning("%s", remark)
    count = write_frames(videos, out, every_s, LOGGER.warning)
    sizes = {name: list(video.size_px) for name, video in videos.items()}
    cameras = [f"{name} ({width} x {height} px)" for name, (width, height) in sizes.items()]
    record = {"frames": count, "cameras": sizes}
    return Outcome(f"{count} frames of {', '.join(cameras)}", record, written=(out,))


def _list_inputs(file: Path) -> dict[str, Path]:
    if not file.is_dir():
        return {"file": file}
    try:
        return {each.name: each for each in sorted(file.iterdir()) if each.is_file()}
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror}).") from error
