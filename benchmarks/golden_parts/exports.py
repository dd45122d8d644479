"""Every file that the package writes, of one rig, lens, scene and board."""

import hashlib
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import trinoc
from golden_parts.inputs import blocks, knocked_rig
from golden_parts.records import Values
from trinoc.errors import TrinocError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.io import FORMATS
from trinoc.io.board_json import save_target
from trinoc.numerics.tables import Table
from trinoc.synth import table1_rig

ENDINGS = {"rig": ".json", "lens": ".json", "segments": ".npz"}


def exports() -> Values:
    """Files that each format of other tools, and our own, write for the same values."""
    values = dict(_values())
    for name, format_ in FORMATS.items():
        for kind, value in values.items():
            if kind in format_.kinds:
                yield from _written(name, kind, format_, value)
    with tempfile.TemporaryDirectory() as folder:
        for kind, value in values.items():
            path = Path(folder) / f"{kind}{ENDINGS.get(kind, '.npz')}"
            yield from _own_file(f"own.{kind}", value, path)
        for target in (trinoc.Chessboard(rows=5, columns=6, square_mm=10.0),
                       trinoc.AprilGrid(rows=3, columns=4, tag_mm=20.0)):  # fmt: skip
            path = Path(folder) / "board.json"
            save_target(target, path)
            yield f"own.{type(target).__name__}", path.read_text()


def _values() -> Values:
    """A value of each kind that files hold, made without a fit so that the values stay equal."""
    rig = knocked_rig()
    keys = [f"{name}.{key}" for name in rig.names for key in ("pan_deg", "distance_mm")]
    covariance = 1e-4 * (np.eye(len(keys)) + 0.1)
    yield "rig", trinoc.Rig(dict(rig.items()), parameters=keys, covariance=covariance)
    yield "lens", Intrinsics(
        focal_length_mm=16, pixel_pitch_mm=(0.0162, 0.0134), image_size_px=(512, 480),
        distortion=(-0.15, 0.02, 0.001, -0.0005),
    )  # fmt: skip
    segments, _ = blocks(9_002)
    matches = trinoc.match_segments(segments, table1_rig())
    yield "segments", segments["upper"]
    yield "matches", matches
    yield "wireframe", trinoc.match.wireframe(matches, table1_rig())
    yield "rims", trinoc.match.find_rims(matches, segments, table1_rig())


def _written(name: str, kind: str, format_: Any, value: Any) -> Values:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("out" + (format_.endings or ("",))[0])
        try:
            format_.save(value, path)
        except TrinocError as error:
            yield f"{name}.{kind}.refusal", str(error).replace(folder, "")
            return
        inside = sorted(file for file in path.rglob("*") if file.is_file())
        for file in inside or [path]:
            yield f"{name}.{kind}.{file.name}", _content(file, folder)
        yield f"{name}.{kind}.lost", format_.lost(value)


def _own_file(name: str, value: Any, path: Path) -> Values:
    try:
        trinoc.save(value, path)
    except TrinocError as error:
        yield f"{name}.refusal", str(error).replace(str(path.parent), "")
        return
    if path.suffix == ".npz":
        with np.load(path) as file:
            for key in file.files:
                yield f"{name}.{key}", file[key]
    else:
        yield name, _content(path, str(path.parent))
    reloaded = trinoc.load(path)
    yield f"{name}.again", isinstance(reloaded, Rig | Intrinsics | Table)


def _content(file: Path, folder: str) -> str:
    """Text of a file without its date and folder; for binary files, their digest."""
    data = file.read_bytes()
    if file.suffix == ".mat":
        data = data[128:]  # the header holds the day
    try:
        text = data.decode()
    except UnicodeDecodeError:
        return hashlib.sha256(data).hexdigest()
    return re.sub(r"\d{4}-\d\d-\d\d[T ][\d:.]+(Z|[+-]\d\d:\d\d)?", "DAY", text.replace(folder, ""))
