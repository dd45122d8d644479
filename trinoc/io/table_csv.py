"""Tables of numbers and words as CSV, which any program opens."""

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

from trinoc.io.atomic import write_text


def save_table(rows: Sequence[Mapping[str, Any]], path: str | os.PathLike[str]) -> None:
    """Write rows under the names of all their columns; what a row lacks, and NaN, stays empty.

    The file is whole or not there, so that it may be written again after every row.
    """
    # The longest row has them all in order; one that failed has fewer.
    fullest = max(rows, key=len, default={})
    names = list(dict.fromkeys(name for row in (fullest, *rows) for name in row))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([_cell(row.get(name)) for name in names])
    write_text(path, out.getvalue())


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
