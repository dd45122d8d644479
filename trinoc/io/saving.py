"""One function that writes any of trinoc's values to its own kind of file."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trinoc.calib import AbstractTarget, Pattern
from trinoc.errors import InputError
from trinoc.geometry import Intrinsics, Rig, Segments
from trinoc.io.board_json import save_target
from trinoc.io.cylinders_npz import save_cylinders
from trinoc.io.intrinsics_json import save_intrinsics
from trinoc.io.matches_npz import save_matches
from trinoc.io.pattern_json import save_pattern
from trinoc.io.rig_json import save_rig
from trinoc.io.rig_status import status_of_shots, status_to_block
from trinoc.io.rims_npz import save_rims
from trinoc.io.segments_npz import save_segments
from trinoc.io.wireframe_npz import save_wireframe
from trinoc.match import Cylinders, Matches, Rims, Wireframe

# What is written, in words, and the ending of its file.
_ENDINGS = (
    (Rig, "a rig is", ".json"),
    (Intrinsics, "a lens is", ".json"),
    (AbstractTarget, "a layout is", ".json"),
    (Segments, "segments are", ".npz"),
    (Matches, "matches are", ".npz"),
    (Cylinders, "cylinders are", ".npz"),
    (Rims, "rims are", ".npz"),
    (Wireframe, "a wire frame is", ".npz"),
)
_WRITTEN = tuple(kind for kind, _, _ in _ENDINGS)


def expect_ending(path: str | os.PathLike[str] | None, kind: type) -> None:
    """Before a long job: raise InputError for a name that `save` would refuse a value of a kind."""
    for each, words, ending in _ENDINGS:
        if path is not None and issubclass(kind, each) and Path(path).suffix.lower() != ending:
            raise InputError(f"{path}: {words} written as {ending}: choose such a name.")


def save(
    value: object,
    path: str | os.PathLike[str],
    *,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write a value to a file, whole or not at all.

    A Rig (or the rig of a CalibrationResult or a RigFromShots, then with its status), Intrinsics
    (or the lens of an IntrinsicsResult, then with its covariance), a Pattern and a board become
    JSON; Segments, Matches, Cylinders, Rims and a Wireframe become npz. `provenance`, of rigs and
    lenses, says how it was found ("command", "version", "inputs"). Raises InputError for other
    values and for a name whose ending is not that of the file.
    """
    more: dict[str, Any] = {}
    if not isinstance(value, _WRITTEN):
        value, more = _content_of_result(value, path)
    expect_ending(path, type(value))
    match value:
        case Rig():
            save_rig(value, path, provenance=provenance, **more)
        case Intrinsics():
            save_intrinsics(value, path, provenance=provenance, **more)
        case Pattern():
            save_pattern(value, path)
        case AbstractTarget():
            save_target(value, path)
        case Segments():
            save_segments(value, path)
        case Matches():
            save_matches(value, path)
        case Cylinders():
            save_cylinders(value, path)
        case Rims():
            save_rims(value, path)
        case Wireframe():
            save_wireframe(value, path)


def _content_of_result(
    value: object, path: str | os.PathLike[str]
) -> tuple[Rig | Intrinsics, dict[str, Any]]:
    """What a result of a calibration has to be written, and what is written beside it."""
    # Here, because these bring the calibrations with them, and a match wants none.
    from trinoc.calib import CalibrationResult, IntrinsicsResult, RigFromShots

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
        "Intrinsics, IntrinsicsResult, Pattern, Segments, Matches, Cylinders, Rims or Wireframe."
    )
