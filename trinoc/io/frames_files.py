"""Files with the matches of many frames: npz, Parquet, and the output folder of `trinoc batch`."""

import importlib.util
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError, expect_path
from trinoc.io.arrays_npz import MOST_BYTES
from trinoc.io.atomic import atomic_write, expect_whole_characters
from trinoc.io.frames_table import (
    OF_TRACKS,
    Frames,
    frames_of_results,
    results_of_frames,
    sides_of_row,
)
from trinoc.io.json_document import parsed_json
from trinoc.io.tables_npz import (
    REMEDY,
    VERSION,
    ArrayFields,
    build_table,
    list_arrays,
    load_npz,
    save_npz,
)
from trinoc.match.tracks.matches import Matches, MatchStatus
from trinoc.numerics.tables import list_fields
from trinoc.recording.frame_table import FrameMatches

FORMAT = f"trinoc-{Frames.KIND}"
_DTYPES = {"f": np.float64, "i": np.int64}
# What Parquet has beside its table, with the kind of each; the last may be missing.
_BESIDE_TRACKS = {
    field.name: _DTYPES.get(field.kind, np.str_)
    for field in list_fields(Frames)
    if not field.column.per_row
}


def frames_ending() -> str:
    """File ending for `save_frames`: ".parquet" if pyarrow is installed, else ".npz"."""
    return ".parquet" if importlib.util.find_spec("pyarrow") else ".npz"


def save_frames(
    results: Sequence[FrameMatches], views: Sequence[str], path: str | os.PathLike[str]
) -> None:
    """Write the results of several frames to one npz or Parquet file, by the ending of `path`.

    `views` are the names of the views. The file appears complete or not at all. Equal results give
    equal files. Raise `InputError` for Parquet without pyarrow.
    """
    frames = frames_of_results(results, views)
    if Path(path).suffix == ".parquet":
        _write_parquet(frames, Path(path))
    else:
        save_npz(frames, path)


def load_frames(path: str | os.PathLike[str]) -> list[FrameMatches]:
    """Read the results of the frames from a file of `save_frames`.

    Raise `InputError` for another file, and for values that `match_segments` cannot produce.
    """
    if Path(path).suffix == ".parquet":
        frames = build_table(Frames, ArrayFields(_read_parquet(Path(path)), path))
    else:
        frames = load_npz(Frames, path)
    return results_of_frames(frames, path)


def _write_parquet(frames: Frames, path: Path) -> None:
    pyarrow, parquet = _pyarrow(path)
    texts = [array.ravel() for array in list_arrays(frames).values() if array.dtype.kind == "U"]
    expect_whole_characters("".join(text for array in texts for text in array), path)
    columns = {"frame": pyarrow.array(np.repeat(frames.frame, frames.tracks).tolist())}
    columns["frame"] = columns["frame"].cast(pyarrow.string())
    for name, array in frames.columns.items():
        flat = pyarrow.array(array.ravel().tolist() if array.dtype.kind == "U" else array.ravel())
        size = int(np.prod(array.shape[1:]))
        columns[name] = (
            pyarrow.FixedSizeListArray.from_arrays(flat, size) if array.ndim > 1 else flat
        )
        if array.dtype.kind == "U":
            columns[name] = columns[name].cast(pyarrow.string())
    arrays = list_arrays(frames)
    other_fields = {name: arrays[name].tolist() for name in _BESIDE_TRACKS}
    header = {"format": FORMAT, "version": VERSION, **other_fields}
    metadata = {b"trinoc": json.dumps(header, ensure_ascii=False, allow_nan=False).encode()}
    table = pyarrow.table(columns).replace_schema_metadata(metadata)
    with atomic_write(path) as file:
        parquet.write_table(table, file, compression="zstd")


def _read_parquet(path: Path) -> dict[str, np.ndarray]:
    pyarrow, parquet = _pyarrow(path)
    try:
        with parquet.ParquetFile(path) as file:
            _expect_size(file.metadata, path)
            header = file.schema_arrow.metadata or {}
            document = parsed_json(header.get(b"trinoc", b"").decode(), path)
            table = file.read()
            table.validate(full=True)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist: check the name.") from error
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} is not a readable Parquet file: {REMEDY}.") from error
    if not isinstance(document, dict) or (document.get("format"), document.get("version")) != (
        FORMAT,
        VERSION,
    ):
        raise InputError(f'{path} is no "{FORMAT}" of version {VERSION}: give another file.')
    views = document.get("views")
    if not isinstance(views, list):
        raise InputError(f'{path}: "views" is no list: {REMEDY}.')
    arrays = {
        name: _array_of_list(name, document[name], path, len(views))
        for name in _BESIDE_TRACKS
        if name in document
    }
    for name in set(table.column_names) - {"frame"}:
        column = table.column(name)
        sides = sides_of_row(OF_TRACKS.get(name, ()), len(views))
        if name not in OF_TRACKS and pyarrow.types.is_fixed_size_list(column.type):
            sides = (len(views),)
        arrays[name] = _array_of_column(name, column, sides, path)
    return arrays


def _array_of_list(name: str, values: object, path: Path, views: int) -> np.ndarray:
    """Convert the JSON list under `name` to an array.

    Raise `InputError` if the values have another type. `views` is the number of views.
    """
    try:
        array = np.array(values, dtype=_BESIDE_TRACKS[name])
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f'{path}: "{name}" is no list of such values: {REMEDY}.') from error
    return array.reshape(0, views) if name == "segments" and array.size == 0 else array


def _array_of_column(name: str, column: object, sides: tuple[int, ...], path: Path) -> np.ndarray:
    joined = column.combine_chunks()  # pyright: ignore[reportAttributeAccessIssue]
    try:
        flat = joined.flatten() if sides else joined
        array = flat.to_numpy(zero_copy_only=False)
        array = array.astype(np.str_) if array.dtype == object else array
        return array.reshape(-1, *sides)
    except (ValueError, AttributeError, NotImplementedError) as error:
        raise InputError(f'{path}: "{name}" has another shape: {REMEDY}.') from error


def _expect_size(metadata: object, path: Path) -> None:
    groups = (metadata.row_group(k) for k in range(metadata.num_row_groups))  # pyright: ignore
    if sum(group.total_byte_size for group in groups) > MOST_BYTES:
        raise InputError(
            f"{path} unpacks to more than {MOST_BYTES / 1e9:.1f} GB, which no file of trinoc does: "
            "give another file."
        )


def _pyarrow(path: Path):
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            f"{path} is Parquet, which needs pyarrow: pip install 'trinoc[parquet]', or write npz."
        ) from error
    return pyarrow, pyarrow.parquet


def manifest_lines(results: Sequence[FrameMatches], file: str) -> list[dict[str, Any]]:
    """Manifest entries of the frames in one result file: name, status, file and row.

    Equal results give equal entries.
    """
    return [{"frame": r.name, **_fate(r), "file": file, "row": k} for k, r in enumerate(results)]


def manifest_text(lines: Iterable[Mapping[str, Any]]) -> str:
    """Convert manifest entries to text, one JSON object per line."""
    return "".join(json.dumps(line, ensure_ascii=False) + "\n" for line in lines)


def read_lines(manifest: Path) -> dict[str, list[dict[str, Any]]]:
    """Read a manifest: the entries of each result file, in the order of its rows.

    Damaged lines are skipped; the result files contain the same data.
    """
    lines_of_file: dict[str, dict[int, dict[str, Any]]] = {}
    for text in manifest.read_bytes().splitlines():
        try:
            line = json.loads(text)
            lines_of_file.setdefault(str(line["file"]), {})[int(line["row"])] = line
        except (ValueError, TypeError, KeyError, RecursionError):
            continue
    return {file: [rows[k] for k in sorted(rows)] for file, rows in lines_of_file.items()}


def _fate(result: FrameMatches) -> dict[str, Any]:
    if result.matches is None:
        return {"status": "failed", "why": result.status}
    stage = result.matches.stage
    # Here, because it brings the matcher with it, and a reader of frames wants none.
    from trinoc.match.tracks.reliability import assess_matches

    assessment, reason = assess_matches(result.matches), {}
    if assessment.status is MatchStatus.SUSPECT:
        reason = {"suspect": assessment.deciding.explanation}
    elif assessment.status is MatchStatus.UNCERTAIN:
        reason = {"uncertain": assessment.deciding.reason}
    return {
        "status": result.status,
        **reason,
        "segments": {view: len(reasons) for view, reasons in result.matches.reasons.items()},
        "tracks": {name: int((stage == name).sum()) for name in ("trinocular", "binocular")},
    }


class RecordingMatches(Mapping):
    """Mapping from frame name to matches, or to None for a frame that failed.

    Result files are read on access; only the last one is kept in memory.

    Attributes
    ----------
    folder : Path
        Folder of the result files.
    failures : dict of str
        Reason for each failed frame, keyed by frame name.
    """

    def __init__(
        self, folder: Path, places: Mapping[str, tuple[str, int]], failures: dict[str, str]
    ) -> None:
        self.folder, self._places, self.failures = folder, places, failures
        self._last: tuple[str, list[FrameMatches]] = ("", [])

    def __len__(self) -> int:
        return len(self._places)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __getitem__(self, frame: str) -> Matches | None:
        file, row = self._places[frame]
        if self._last[0] != file:
            self._last = file, load_frames(self.folder / file)
        results = self._last[1]
        if not row < len(results) or results[row].name != frame:
            raise InputError(
                f'{self.folder / file} has no frame "{frame}" in row {row}, which contradicts the '
                "manifest: run the batch again."
            )
        return results[row].matches


def load_recording(folder: str | os.PathLike[str]) -> RecordingMatches:
    """Open the results of `match_recording` in a folder.

    Parameters
    ----------
    folder : path
        Output folder. Several jobs may have written to it.

    Returns
    -------
    RecordingMatches
        Matches of each frame, in the order of the recording.

    Raises
    ------
    InputError
        If the folder contains no results.
    """
    expect_path(folder)
    path = Path(folder)
    lines: dict[str, list[dict]] = {}
    for manifest in sorted(path.glob("manifest*.jsonl")):
        lines |= read_lines(manifest)
    if not lines:
        raise InputError(f"{path} holds no results of trinoc batch: give its output folder.")
    positions, failures = {}, {}
    for file in sorted(lines):
        if Path(file).name != file:
            raise InputError(
                f'A manifest in {path} names "{file}", which is outside this folder: remove this '
                "manifest."
            )
        for line in lines[file]:
            name = str(line.get("frame"))
            positions[name] = file, int(line["row"])
            if line.get("status") == "failed":
                failures[name] = str(line.get("why"))
    return RecordingMatches(path, positions, failures)
