"""One function that reads any of trinoc's own files of rigs, lenses, matches and segments."""

import os
from pathlib import Path

from trinoc.errors import InputError
from trinoc.geometry import Intrinsics, Rig, Segments
from trinoc.io import (
    cylinders_npz,
    intrinsics_json,
    matches_npz,
    rig_json,
    rims_npz,
    segments_npz,
    wireframe_npz,
)
from trinoc.io.arrays_npz import format_of_arrays
from trinoc.io.json_text import parsed_json
from trinoc.io.whole_files import read_text
from trinoc.match import Cylinders, Matches, Rims, Wireframe

READERS = {
    rig_json.FORMAT: rig_json.load_rig,
    intrinsics_json.FORMAT: intrinsics_json.load_intrinsics,
    matches_npz.FORMAT: matches_npz.load_matches,
    segments_npz.FORMAT: segments_npz.load_segments,
    cylinders_npz.FORMAT: cylinders_npz.load_cylinders,
    rims_npz.FORMAT: rims_npz.load_rims,
    wireframe_npz.FORMAT: wireframe_npz.load_wireframe,
}


def load_any(
    path: str | os.PathLike[str],
) -> Rig | Intrinsics | Matches | Segments | Cylinders | Rims | Wireframe:
    """The value in a rig.json, camera.json or npz of matches, segments, cylinders, rims or a wire
    frame, by what the file says.

    Raises InputError for other files.
    """
    file = Path(path)
    found = _format_of_json(file) if file.suffix.lower() == ".json" else format_of_arrays(file)
    if not isinstance(found, str) or found not in READERS:
        raise InputError(
            f"{file} is no rig, camera, matches, segments, cylinders, rims or wire frame of "
            "trinoc: give a rig.json, camera.json, matches.npz, segments.npz, cylinders.npz, "
            "rims.npz or wireframe.npz."
        )
    return READERS[found](file)


def _format_of_json(file: Path) -> object:
    values = parsed_json(read_text(file), file)
    return values.get("format") if isinstance(values, dict) else None
