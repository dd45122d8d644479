"""One function that writes any of trinoc's values to its own kind of file, and one that reads."""

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from trinoc.calib.detection.detection import Detection
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.io import intrinsics_json, rig_json
from trinoc.io.arrays_npz import format_of_arrays
from trinoc.io.board_json import save_target
from trinoc.io.json_text import parsed_json
from trinoc.io.pattern_json import save_pattern
from trinoc.io.rig_status import status_of_shots, status_to_block
from trinoc.io.tables_npz import load_npz, save_npz
from trinoc.io.whole_files import read_text
from trinoc.match.features import FEATURES
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.tables import Table

# What is written as JSON, in words.
_DOCUMENTS: tuple[tuple[type, str], ...] = (
    (Rig, "a rig"),
    (Intrinsics, "a lens"),
    (AbstractTarget, "a layout"),
)


def tables() -> list[type[Table]]:
    """The kinds of values that are written as npz."""
    return [Segments, Matches, Detection, *FEATURES]


def expect_ending(path: str | os.PathLike[str] | None, kind: type) -> None:
    """Before a long job: raise InputError for a name that `save` would refuse a value of a kind."""
    written = [(*document, ".json") for document in _DOCUMENTS]
    written += [(each, each.IN_WORDS, ".npz") for each in tables()]
    for each, words, ending in written:
        if path is not None and issubclass(kind, each) and Path(path).suffix.lower() != ending:
            are = "is" if words.startswith("a ") else "are"
            raise InputError(f"{path}: {words} {are} written as {ending}: choose such a name.")


def save(
    value: object,
    path: str | os.PathLike[str],
    *,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write a value to a file, whole or not at all.

    A Rig (or the rig of a CalibrationResult or a RigFromShots, then with its status), Intrinsics
    (or the lens of an IntrinsicsResult, then with its covariance), a Pattern and a board become
    JSON; Segments, Matches, a Detection, a Wireframe, Cylinders and Rims become npz. `provenance`,
    of rigs and lenses, says how it was found ("command", "version", "inputs"). Raises InputError
    for other values and for a name whose ending is not that of the file.
    """
    more: dict[str, Any] = {}
    if not isinstance(value, (*(kind for kind, _ in _DOCUMENTS), *tables())):
        value, more = _content_of_result(value, path)
    expect_ending(path, type(value))
    match value:
        case Rig():
            rig_json.save_rig(value, path, provenance=provenance, **more)
        case Intrinsics():
            intrinsics_json.save_intrinsics(value, path, provenance=provenance, **more)
        case Pattern():
            save_pattern(value, path)
        case AbstractTarget():
            save_target(value, path)
        case Table():
            save_npz(value, path)


def load(path: str | os.PathLike[str]) -> Any:
    """The value in a file of `save`, by what the file says: a Rig, Intrinsics, Segments, Matches, a
    Wireframe, Cylinders or Rims.

    Raises InputError for other files, and, with the field and the first row, for what no such value
    holds.
    """
    readers: dict[object, Callable[[Path], Any]] = {
        rig_json.FORMAT: rig_json.load_rig,
        intrinsics_json.FORMAT: intrinsics_json.load_intrinsics,
        **{f"trinoc-{kind.KIND}": partial(load_npz, kind) for kind in tables()},
    }
    file = Path(path)
    if file.suffix.lower() == ".json":
        values = parsed_json(read_text(file), file)
        found = values.get("format") if isinstance(values, dict) else None
    else:
        found = format_of_arrays(file)
    if not isinstance(found, str) or found not in readers:
        files = ", ".join(f"{kind.KIND}.npz" for kind in tables())
        raise InputError(
            f"{file} is no value that trinoc wrote: give a rig.json, camera.json or one of {files}."
        )
    return readers[found](file)


def load_matches(path: str | os.PathLike[str]) -> Matches:
    """Read matches that `save` wrote.

    Raises InputError for another file, and, with the field and the first row, for what no matching
    can give: segments that do not exist, fragments where a view sees none, places that are not
    finite or beyond all scenes, covariances that are none, probabilities outside [0, 1].
    """
    return load_npz(Matches, path)


def _content_of_result(
    value: object, path: str | os.PathLike[str]
) -> tuple[Rig | Intrinsics, dict[str, Any]]:
    """What a result of a calibration has to be written, and what is written beside it."""
    # Here, because these bring the calibrations with them, and a match wants none.
    from trinoc.calib.intrinsics_result import IntrinsicsResult
    from trinoc.calib.result.calibration import CalibrationResult
    from trinoc.calib.rig_from_shots import RigFromShots

    match value:
        case CalibrationResult():
            return value.rig, {"status": status_to_block(value)}
        case RigFromShots() if value.rig is not None:
            return value.rig, {"status": status_of_shots(value)}
        case IntrinsicsResult() if value.lens is not None:
            return value.lens, {"covariance": value.covariance}
        case RigFromShots() | IntrinsicsResult():
            raise InputError(f"{path} was not written: {value.status.value}")
    raise InputError(
        f"A {type(value).__name__} cannot be saved: give a Rig, CalibrationResult, "
        "Intrinsics, IntrinsicsResult, Pattern, Segments, Matches, Wireframe, Cylinders or Rims."
    )
