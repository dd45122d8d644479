"""Files of the matches of many frames: npz, or Parquet with a row for each track."""

import importlib.util
import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.io.arrays_npz import MOST_BYTES
from trinoc.io.atomic import atomic_write
from trinoc.io.frames_table import (
    OF_TRACKS,
    Frames,
    frames_of_results,
    results_of_frames,
    sides_of_row,
)
from trinoc.io.json_text import parsed_json
from trinoc.io.tables_npz import (
    REMEDY,
    VERSION,
    ArrayFields,
    build_table,
    list_arrays,
    load_npz,
    save_npz,
)
from trinoc.numerics.tables import list_fields
from trinoc.recording.frame import FrameMatches

FORMAT = f"trinoc-{Frames.KIND}"
_DTYPES = {"f": np.float64, "i": np.int64}
# What Parquet has beside its table, with the kind of each; the last may be missing.
_BESIDE_TRACKS = {
    field.name: _DTYPES.get(field.kind, np.str_)
    for field in list_fields(Frames)
    if not field.column.beside
}


def frames_ending() -> str:
    """The ending of files of frames: ".parquet" where pyarrow is installed, else ".npz"."""
    return ".parquet" if importlib.util.find_spec("pyarrow") else ".npz"


def save_frames(
    results: Sequence[FrameMatches], views: Sequence[str], path: str | os.PathLike[str]
) -> None:
    """Write what became of some frames, whole or not at all, as the ending says.

    Equal results give equal bytes. Raises InputError where Parquet is wanted without pyarrow.
    """
    frames = frames_of_results(results, views)
    if Path(path).suffix == ".parquet":
        _write_parquet(frames, Path(path))
    else:
        save_npz(frames, path)


def load_frames(path: str | os.PathLike[str]) -> list[FrameMatches]:
    """Read a file of `save_frames`. Raises InputError for another file, as `load_matches` does."""
    if Path(path).suffix == ".parquet":
        frames = build_table(Frames, ArrayFields(_read_parquet(Path(path)), path))
    else:
        frames = load_npz(Frames, path)
    return results_of_frames(frames, path)


def _write_parquet(frames: Frames, path: Path) -> None:
    pyarrow, parquet = _pyarrow(path)
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
    beside = {name: arrays[name].tolist() for name in _BESIDE_TRACKS}
    said = {"format": FORMAT, "version": VERSION, **beside}
    metadata = {b"trinoc": json.dumps(said, ensure_ascii=False, allow_nan=False).encode()}
    table = pyarrow.table(columns).replace_schema_metadata(metadata)
    with atomic_write(path) as file:
        parquet.write_table(table, file, compression="zstd")


def _read_parquet(path: Path) -> dict[str, np.ndarray]:
    pyarrow, parquet = _pyarrow(path)
    try:
        with parquet.ParquetFile(path) as file:
            _expect_size(file.metadata, path)
            said = file.schema_arrow.metadata or {}
            document = parsed_json(said.get(b"trinoc", b"").decode(), path)
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
    """A JSON list as an array; wrong ones are refused here or by the checks that follow."""
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
