"""`save` and `load` for all values that trinoc writes, each in its own format."""

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.errors import InputError, expect_path
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.image.ideal_pictures import PictureMaps
from trinoc.io import board_json, intrinsics_json, rig_json
from trinoc.io.arrays_npz import format_of_arrays, read_arrays, write_arrays
from trinoc.io.atomic import read_text
from trinoc.io.board_json import load_target, save_target
from trinoc.io.json_document import parsed_json
from trinoc.io.rig_json import status_to_block
from trinoc.io.tables_npz import load_npz, save_npz
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.tables import Table

# The kinds of values that are written as JSON, with their names in messages.
_DOCUMENTS: tuple[tuple[type, str], ...] = (
    (Rig, "a rig"),
    (Intrinsics, "a lens"),
    (AbstractTarget, "a layout"),
)
# The format of PictureMaps, whose arrays have the names of its fields.
MAPS_FORMAT, MAPS_VERSION = "trinoc-maps", 1


def tables() -> list[type[Table]]:
    """List the table classes that `save` writes as npz."""
    # Here, because a calibration writes none of them, and they bring the matcher with them.
    from trinoc.calib.detection.detection import Detection
    from trinoc.match.features import FEATURES

    return [Segments, Matches, Detection, *FEATURES]


def expect_ending(path: str | os.PathLike[str] | None, kind: type) -> None:
    """Raise `InputError` if `save` needs another file ending for a value of class `kind`.

    Called before a long computation. Nothing is checked if `path` is None.
    """
    file_kinds = [(*document, ".json") for document in _DOCUMENTS]
    file_kinds.append((PictureMaps, "maps", ".npz"))
    if issubclass(kind, Table):
        file_kinds.append((kind, kind.IN_WORDS, ".npz"))
    for each, label, ending in file_kinds:
        if path is not None and issubclass(kind, each) and Path(path).suffix.lower() != ending:
            are = "is" if label.startswith("a ") else "are"
            raise InputError(f"{path}: {label} {are} written as {ending}: choose such a name.")


def expect_replaceable(
    path: str | os.PathLike[str] | None,
    kind: type,
    *,
    force: bool = False,
    remedy: str = "--force",
) -> None:
    """Raise `InputError` if `save` may not write a value of class `kind` to `path`.

    Called before a long computation. Reasons are another file ending, and an existing file with
    another kind of content, unless `force`. `remedy` is the option named in the message.
    """
    expect_ending(path, kind)
    # Not of `Path`, which raises for a name that is too long.
    if path is None or force or not os.path.exists(path) or not Path(path).stat().st_size:
        return
    try:
        stated = _stated_format(Path(path))
    except InputError:
        stated = None
    if stated not in _list_formats(kind):
        content = f"a file of {stated}" if isinstance(stated, str) and stated else "something else"
        raise InputError(_describe_loss(path, content, remedy))


def expect_marked(path: str | os.PathLike[str] | None, mark: bytes, *, force: bool = False) -> None:
    """Raise `InputError` if an existing file does not contain the bytes `mark`, unless `force`.

    `mark` identifies the kind of file, such as a report, that may be replaced.
    """
    if path is None or force or not Path(path).is_file():
        return
    content = Path(path).read_bytes()
    if content and mark.lower() not in content.lower():
        raise InputError(_describe_loss(path, "something else"))


def expect_foreign(path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Raise `InputError` if `path` is a file that trinoc wrote, unless `force`.

    A file in another tool's format must not replace it.
    """
    if force or not Path(path).is_file() or Path(path).suffix.lower() not in (".json", ".npz"):
        return
    try:
        stated = _stated_format(Path(path))
    except InputError:
        return
    if isinstance(stated, str) and stated.startswith("trinoc-"):
        raise InputError(_describe_loss(path, f"a file of {stated}"))


def _describe_loss(path: str | os.PathLike[str], content: str, remedy: str = "--force") -> str:
    return (
        f"{path} exists and contains {content}, which would be overwritten: give another name, or "
        f"{remedy}."
    )


def _stated_format(file: Path) -> object:
    """Value of the key "format" in a JSON or npz file; None or empty if it has none."""
    if file.suffix.lower() == ".json":
        values = parsed_json(read_text(file), file)
        return values.get("format") if isinstance(values, dict) else None
    return format_of_arrays(file)


def _list_formats(kind: type) -> tuple[str, ...]:
    """Values of the key "format" in files with a value of class `kind`."""
    if issubclass(kind, Table):
        return (f"trinoc-{kind.KIND}",)
    if issubclass(kind, AbstractTarget):
        return board_json.PATTERN_FORMAT, board_json.FORMAT
    if issubclass(kind, PictureMaps):
        return (MAPS_FORMAT,)
    return (rig_json.FORMAT if issubclass(kind, Rig) else intrinsics_json.FORMAT,)


def save(
    value: object,
    path: str | os.PathLike[str],
    *,
    provenance: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a value to a file, which appears complete or not at all.

    Parameters
    ----------
    value : Rig, CalibrationResult, Intrinsics, Pattern, board, or table
        Rigs, lenses and boards become JSON. Segments, Matches, Detection, Wireframe, Rims and
        PictureMaps become npz. Of a CalibrationResult the rig is written with its status. Of a lens
        calibration the lens is written with its covariance.
    path : path
        File to write, with the ending .json or .npz.
    provenance : mapping, optional
        Source of a rig or lens: "command", "version", "inputs".
    overwrite : bool
        True: an existing file with another kind of content may be replaced.

    Raises
    ------
    InputError
        If the value cannot be saved, the file ending is wrong, or a file with another kind of
        content exists.
    """
    expect_path(path)
    writer_arguments: dict[str, Any] = {}
    kinds = (PictureMaps, *(tables() if isinstance(value, Table) else dict(_DOCUMENTS)))
    if not isinstance(value, kinds):
        value, writer_arguments = _content_of_result(value, path)
    expect_replaceable(path, type(value), force=overwrite, remedy="overwrite=True")
    match value:
        case Rig():
            rig_json.save_rig(value, path, provenance=provenance, **writer_arguments)
        case Intrinsics():
            intrinsics_json.save_intrinsics(value, path, provenance=provenance, **writer_arguments)
        case AbstractTarget():
            save_target(value, path)
        case Table():
            save_npz(value, path)
        case PictureMaps():
            arrays = {name: np.asarray(array) for name, array in value._asdict().items()}
            # Smooth as they are, their last digits do not compress.
            write_arrays(path, MAPS_FORMAT, MAPS_VERSION, arrays, compressed=False)


def load(path: str | os.PathLike[str]) -> Any:
    """Read the value in a file that trinoc wrote. The content of the file decides its type.

    Parameters
    ----------
    path : path
        File, or the output folder of a batch.

    Returns
    -------
    Rig, Intrinsics, Pattern, board, SceneTruth, table, list, RecordingMatches or KnownShape
        A rig.json gives a Rig, a camera.json Intrinsics, a layout a Pattern or board, a truth.json
        a SceneTruth. An npz gives Segments, Matches, Detection, Wireframe, Rims or PictureMaps. A
        file of frames (npz or parquet) gives a list of FrameMatches, a batch folder
        RecordingMatches, an OBJ a KnownShape.

    Raises
    ------
    InputError
        If trinoc did not write the file, or a value is invalid. The message names the field and the
        first invalid row.
    """
    expect_path(path)
    file = Path(path)
    if os.path.isdir(file):
        from trinoc.io.frames_files import load_recording

        return load_recording(file)
    # Files that say nothing of themselves.
    if file.suffix.lower() == ".parquet":
        from trinoc.io.frames_files import load_frames

        return load_frames(file)
    if file.suffix.lower() == ".obj":
        from trinoc.io.known_shape import load_shape

        return load_shape(file)
    stated: object = None
    if file.suffix.lower() in (".json", ".npz") or not os.path.exists(file):
        stated = _stated_format(file)
    if isinstance(stated, str) and stated in _BY_FORMAT:
        return _BY_FORMAT[stated][1](file)

    from trinoc.match.wire_frame.frame import Wireframe

    readers = _other_readers()
    if stated == f"trinoc-{Wireframe.KIND}" and file.suffix.lower() == ".json":
        raise InputError(
            f"{file} is a wire frame for other programs, without the covariance between its "
            f"vertices: give the {Wireframe.KIND}.npz that it was exported from."
        )
    if stated == "trinoc-cylinders":
        raise InputError(
            f"{file} holds cylinders, which trinoc no longer reads: export it with the version "
            "that wrote it, or match with --steps rims."
        )
    if not isinstance(stated, str) or stated not in readers:
        documents = ", ".join([*(label for label, _ in _BY_FORMAT.values()), "truth.json"])
        arrays = ", ".join(f"{kind}.npz" for kind in (*(t.KIND for t in tables()), "maps"))
        raise InputError(
            f"{file} is no value that trinoc wrote: give {documents}, one of {arrays}, shape.obj, "
            "or the folder of trinoc batch or a file in it."
        )
    return readers[stated](file)


_Reader = Callable[[Path], Any]
# For each format of a JSON file: its name in messages, and its reader.
_BY_FORMAT: dict[str, tuple[str, _Reader]] = {
    rig_json.FORMAT: ("a rig.json", rig_json.load_rig),
    intrinsics_json.FORMAT: ("camera.json", intrinsics_json.load_intrinsics),
    board_json.PATTERN_FORMAT: ("sheet.json", load_target),
    board_json.FORMAT: ("board.json", load_target),
}


def _other_readers() -> dict[str, _Reader]:
    """Readers of truth.json and of all npz files, keyed by format name."""
    from trinoc.io import demo, frames_files

    return {
        **{f"trinoc-{kind.KIND}": partial(load_npz, kind) for kind in tables()},
        demo.FORMAT: demo.load_scene_truth,
        frames_files.FORMAT: frames_files.load_frames,
        MAPS_FORMAT: _load_maps,
    }


def _load_maps(file: Path) -> PictureMaps:
    arrays = read_arrays(file, MAPS_FORMAT, MAPS_VERSION)
    map_x, map_y, size = (arrays.get(name, np.zeros(0)) for name in PictureMaps._fields)
    if not (
        map_x.shape == map_y.shape
        and (map_x.ndim, size.shape) == (2, (2,))
        and size.dtype.kind in "iu"
        and all(each.dtype == np.float32 and np.isfinite(each).all() for each in (map_x, map_y))
    ):
        raise InputError(f"{file} holds no maps of pictures: write it again.")
    return PictureMaps(map_x, map_y, (int(size[0]), int(size[1])))


def load_matches(path: str | os.PathLike[str]) -> Matches:
    """Read matches from an npz file of `save`.

    Parameters
    ----------
    path : path
        File to read.

    Returns
    -------
    Matches

    Raises
    ------
    InputError
        If the file contains something else, or values that no matching produces, such as a missing
        segment or a probability above 1. The message names the field and the first invalid row.
    """
    return load_npz(Matches, path)


def _content_of_result(
    value: object, path: str | os.PathLike[str]
) -> tuple[Rig | Intrinsics, dict[str, Any]]:
    """Value that is written for a calibration result: (rig or lens, arguments of its writer).

    Raise `InputError` for other values, and for a calibration without a rig.
    """
    # Here, because it brings the calibrations with it, and a match wants none.
    from trinoc.calib.result.calibration import CalibrationResult

    if isinstance(value, CalibrationResult):
        if not value.has_rig:
            raise InputError(f"{path} was not written: {value.overall_status.value}")
        if value.is_lens:
            return value.lens, {"covariance": value.lens_covariance}
        return value.rig, {"status": status_to_block(value)}
    raise InputError(
        f"A {type(value).__name__} cannot be saved: give a Rig, CalibrationResult, "
        "Intrinsics, Pattern, Segments, Matches, Wireframe or Rims."
    )
