"""Files of the matches of many frames: npz, or Parquet with a row for each track."""

import importlib.util
import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.io.array_checks import REMEDY
from trinoc.io.arrays_npz import MOST_BYTES, read_arrays, write_arrays
from trinoc.io.atomic import atomic_write
from trinoc.io.frames_arrays import (
    ALSO_OF_FRAMES,
    OF_FRAMES,
    OF_TRACKS,
    arrays_of_frames,
    frames_of_arrays,
)
from trinoc.io.json_text import parsed_json
from trinoc.recording import FrameMatches

FORMAT, VERSION = "trinoc-frames", 1
_BESIDE_TRACKS = ("views", *OF_FRAMES, "reasons")
_DTYPES = {
    "tracks": np.int64,
    "segments": np.int64,
    "noise_scale": np.float64,
    "noise_tail": np.float64,
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
    arrays = arrays_of_frames(results, views)
    if Path(path).suffix == ".parquet":
        _write_parquet(arrays, Path(path))
    else:
        write_arrays(path, FORMAT, VERSION, arrays)


def load_frames(path: str | os.PathLike[str]) -> list[FrameMatches]:
    """Read a file of `save_frames`. Raises InputError for another file, as `load_matches` does."""
    if Path(path).suffix == ".parquet":
        return frames_of_arrays(_read_parquet(Path(path)), path)
    return frames_of_arrays(read_arrays(path, FORMAT, VERSION), path)


def _write_parquet(arrays: dict[str, np.ndarray], path: Path) -> None:
    pyarrow, parquet = _pyarrow(path)
    columns = {"frame": pyarrow.array(np.repeat(arrays["frame"], arrays["tracks"]).tolist())}
    columns["frame"] = columns["frame"].cast(pyarrow.string())
    for name in OF_TRACKS:
        array = arrays[name]
        flat = pyarrow.array(array.ravel().tolist() if array.dtype.kind == "U" else array.ravel())
        size = int(np.prod(array.shape[1:]))
        columns[name] = (
            pyarrow.FixedSizeListArray.from_arrays(flat, size) if array.ndim > 1 else flat
        )
        if array.dtype.kind == "U":
            columns[name] = columns[name].cast(pyarrow.string())
    beside = {name: arrays[name].tolist() for name in (*_BESIDE_TRACKS, *ALSO_OF_FRAMES)}
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
            table = file.read(columns=list(OF_TRACKS))
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
    arrays = {}
    for name in (*_BESIDE_TRACKS, *(also for also in ALSO_OF_FRAMES if also in document)):
        arrays[name] = _array_of_list(name, document.get(name), path, len(views))
    for name, shape in OF_TRACKS.items():
        if name not in table.column_names:
            raise InputError(f'{path} lacks the column "{name}": {REMEDY}.')
        sides = [len(views) if side == "v" else int(side) for side in shape]
        arrays[name] = _array_of_column(name, table.column(name), sides, path)
    return arrays


def _array_of_list(name: str, values: object, path: Path, views: int) -> np.ndarray:
    """A JSON list as an array; wrong ones are refused here or by the checks that follow."""
    try:
        array = np.array(values, dtype=_DTYPES.get(name, np.str_))
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f'{path}: "{name}" is no list of such values: {REMEDY}.') from error
    return array.reshape(0, views) if name == "segments" and array.size == 0 else array


def _array_of_column(name: str, column: object, sides: list[int], path: Path) -> np.ndarray:
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
