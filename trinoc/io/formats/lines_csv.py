"""3-D segments as CSV: a row for each track, with its covariance; numbers to their last digit."""

import io
from csv import writer
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.lines_table import lines_table
from trinoc.match import Matches


def write_csv(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write the columns of `lines_table`; what is not finite stays empty."""
    columns = lines_table(matches, unit_mm)
    out = io.StringIO()
    rows = writer(out, lineterminator="\n")
    rows.writerow(columns)
    rows.writerows(zip(*([_cell(item) for item in column] for column in columns.values())))
    write_text(path, out.getvalue())


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
    frames="the world of the rig; pixel (0, 0) is the centre of the top-left pixel",
    loses=(),
    write=write_csv,
)
