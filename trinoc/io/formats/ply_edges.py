"""3-D segments and features as vertices, faces and edges of a PLY, with what is known of them."""

import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from trinoc.geometry.features import Feature
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.lines_tables import columns_in_unit
from trinoc.io.formats.losses import TRACKS
from trinoc.match.tracks.matches import TRINOCULAR, Matches
from trinoc.match.wire_frame.frame import Wireframe

# Of a column: what PLY calls its numbers.
_TYPES = {"f": "double", "i": "int", "b": "uchar"}


def write_ply(value: Matches | Feature, path: Path, unit_mm: float) -> None:
    """Write vertices, faces and edges as text; each edge has the columns of what it is of."""
    wires = value.wires()
    vertices: dict[str, np.ndarray] = dict(
        zip(("x_mm", "y_mm", "z_mm"), wires.places_mm.T, strict=True)
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
    """The numbers of each row that are no words and not of pictures."""
    columns = value.named_columns(brief=not isinstance(value, Matches))
    if isinstance(value, Matches):
        columns["trinocular"] = value.stage == TRINOCULAR
    return {
        name: column
        for name, column in columns.items()
        if column.dtype.kind in _TYPES and not name.endswith(("_px", "_segment"))
    }


def _element(name: str, columns: Mapping[str, np.ndarray]) -> tuple[list[str], list[str]]:
    """(head, rows) of a kind of thing."""
    count = len(next(iter(columns.values())))
    of_columns = [f"property {_TYPES[c.dtype.kind]} {own}" for own, c in columns.items()]
    plain = [(c.astype(int) if c.dtype.kind == "b" else c).tolist() for c in columns.values()]
    rows = [" ".join(map(repr, row)) for row in zip(*plain, strict=True)]
    return [f"element {name} {count}", *of_columns], rows


def _faces(loops: list[list[int]]) -> tuple[list[str], list[str]]:
    if not loops:
        return [], []
    head = [f"element face {len(loops)}", "property list uchar int vertex_indices"]
    return head, [" ".join(map(str, (len(loop), *loop))) for loop in loops]


ply = Format(
    name="ply",
    title="PLY",
    holds=("matches", "features"),
    reads=(),
    place="file",
    endings=(".ply",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="the world of the rig",
    loses=(TRACKS,),
    write=write_ply,
)
