"""3-D segments as tables with a row for each track: CSV, Parquet (needs pyarrow) and PLY."""

import csv as csv_text
import io
import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.features import Feature
from trinoc.io.atomic import atomic_write, write_text
from trinoc.io.formats.format import TRACKS, Format
from trinoc.match.tracks.matches import TRINOCULAR, Matches
from trinoc.match.wire_frame.frame import Wireframe

_FRAMES = "the world of the rig; pixel (0, 0) is the centre of the top-left pixel"


def columns_in_unit(columns: dict[str, np.ndarray], unit_mm: float) -> dict[str, np.ndarray]:
    """Convert columns from mm and mm^2 to units of `unit_mm`.

    The endings _mm and _mm2 of the column names are removed.
    """
    scaled = {}
    for name, column in columns.items():
        power = 2 if name.endswith("_mm2") else int(name.endswith("_mm"))
        base_name = name.removesuffix("_mm2").removesuffix("_mm")
        scaled[base_name] = column / unit_mm**power if power else column
    return scaled


def _columns(matches: Matches, unit_mm: float) -> dict[str, np.ndarray]:
    """Columns of the file, with one entry for each track.

    If `unit_mm` is 1, the endings _mm and _mm2 of the column names remain.
    """
    columns = matches.named_columns()
    return columns if unit_mm == 1 else columns_in_unit(columns, unit_mm)


def write_csv(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write one row for each track, with all digits; a number that is not finite is left empty."""
    columns = _columns(matches, unit_mm)
    out = io.StringIO()
    rows = csv_text.writer(out, lineterminator="\n")
    rows.writerow(columns)
    rows.writerows(zip(*([_cell(item) for item in column] for column in columns.values())))
    write_text(path, out.getvalue())


def write_parquet(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write one row for each track as Parquet. Raise `InputError` if pyarrow is not installed."""
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
    endings=(".csv",),
    frames=_FRAMES,
    write=write_csv,
)
parquet = replace(csv, name="parquet", title="Parquet", endings=(".parquet",), write=write_parquet)


# Of a column: what PLY calls its numbers.
_TYPES = {"f": "double", "i": "int", "b": "uchar"}


def write_ply(value: Matches | Feature, path: Path, unit_mm: float) -> None:
    """Write vertices, faces and edges as PLY text; lengths in units of `unit_mm`.

    Each edge has the numeric columns of the feature or track that it belongs to.
    """
    wires = value.wires()
    vertices: dict[str, np.ndarray] = dict(
        zip(("x_mm", "y_mm", "z_mm"), wires.points_mm.T, strict=True)
    )
    if isinstance(value, Wireframe):
        vertices |= {"corner": value.corner}
        covariance = value.vertices_covariance_mm2
        for row, column in zip(*np.triu_indices(3), strict=True):
            vertices[f"cov_{'xyz'[row]}_{'xyz'[column]}_mm2"] = covariance[:, row, column]
    edges: dict[str, np.ndarray] = dict(zip(("vertex1", "vertex2"), wires.pairs.T, strict=True))
    if len(wires.owner) != len(value):
        edges |= {value.KIND.removesuffix("s"): wires.owner}
    edges |= {name: column[wires.owner] for name, column in _number_columns(value).items()}
    elements = (
        _element("vertex", columns_in_unit(vertices, unit_mm)),
        _faces([loop.tolist() for loop in wires.loops]),
        _element("edge", columns_in_unit(edges, unit_mm)),
    )
    head = itertools.chain.from_iterable(head for head, _ in elements)
    rows = itertools.chain.from_iterable(rows for _, rows in elements)
    comment = f"comment unit {unit_mm!r} mm, Z up; cov_* are covariances in that unit"
    lines = ["ply", "format ascii 1.0", comment, *head, "end_header", *rows]
    write_text(path, "\n".join(lines) + "\n")


def _number_columns(value: Matches | Feature) -> dict[str, np.ndarray]:
    """Numeric columns of a table, except pixel coordinates and segment indices."""
    columns = value.named_columns(brief=not isinstance(value, Matches))
    if isinstance(value, Matches):
        columns["trinocular"] = value.stage == TRINOCULAR
    return {
        name: column
        for name, column in columns.items()
        if column.dtype.kind in _TYPES and not name.endswith(("_px", "_segment"))
    }


def _element(name: str, columns: Mapping[str, np.ndarray]) -> tuple[list[str], list[str]]:
    """(header lines, data lines) of one PLY element, such as "vertex", with the given columns."""
    count = len(next(iter(columns.values())))
    properties = [
        f"property {_TYPES[c.dtype.kind]} {column_name}" for column_name, c in columns.items()
    ]
    plain = [(c.astype(int) if c.dtype.kind == "b" else c).tolist() for c in columns.values()]
    rows = [" ".join(map(repr, row)) for row in zip(*plain, strict=True)]
    return [f"element {name} {count}", *properties], rows


def _faces(loops: list[list[int]]) -> tuple[list[str], list[str]]:
    if not loops:
        return [], []
    head = [f"element face {len(loops)}", "property list uchar int vertex_indices"]
    return head, [" ".join(map(str, (len(loop), *loop))) for loop in loops]


ply = Format(
    name="ply",
    title="PLY",
    holds=("matches", "features"),
    endings=(".ply",),
    frames="the world of the rig",
    loses=(TRACKS,),
    write=write_ply,
)
