"""3-D segments as tables of a row for each track: CSV, and Parquet, which needs pyarrow."""

import csv as csv_text
import io
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.io.atomic import atomic_write, write_text
from trinoc.io.formats.format import Format
from trinoc.match.tracks.matches import Matches

_FRAMES = "the world of the rig; pixel (0, 0) is the centre of the top-left pixel"


def columns_in_unit(columns: dict[str, np.ndarray], unit_mm: float) -> dict[str, np.ndarray]:
    """Named columns with lengths in units of `unit_mm`, without _mm and _mm2 in their names."""
    scaled = {}
    for name, column in columns.items():
        power = 2 if name.endswith("_mm2") else int(name.endswith("_mm"))
        own = name.removesuffix("_mm2").removesuffix("_mm")
        scaled[own] = column / unit_mm**power if power else column
    return scaled


def _columns(matches: Matches, unit_mm: float) -> dict[str, np.ndarray]:
    """Those of the file: their names say that lengths are in mm where they are."""
    columns = matches.named_columns()
    return columns if unit_mm == 1 else columns_in_unit(columns, unit_mm)


def write_csv(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write the columns, numbers to their last digit; what is not finite stays empty."""
    columns = _columns(matches, unit_mm)
    out = io.StringIO()
    rows = csv_text.writer(out, lineterminator="\n")
    rows.writerow(columns)
    rows.writerows(zip(*([_cell(item) for item in column] for column in columns.values())))
    write_text(path, out.getvalue())


def write_parquet(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write the columns, typed. Raises InputError where pyarrow is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            f"{path} is Parquet, which needs pyarrow: pip install 'trinoc[parquet]', or export CSV."
        ) from error
    table = pyarrow.table(_columns(matches, unit_mm))
    with atomic_write(path) as file:
        pyarrow.parquet.write_table(table, file)


def _cell(item: Any) -> Any:
    if isinstance(item, np.floating):
        return repr(float(item)) if np.isfinite(item) else ""
    return item.item()


csv = Format(
    name="csv",
    title="CSV",
    holds=("matches",),
    reads=(),
    place="file",
    endings=(".csv",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames=_FRAMES,
    loses=(),
    write=write_csv,
)
parquet = Format(
    name="parquet",
    title="Parquet",
    holds=("matches",),
    reads=(),
    place="file",
    endings=(".parquet",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames=_FRAMES,
    loses=(),
    write=write_parquet,
)
