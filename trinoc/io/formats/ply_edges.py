"""3-D segments as the edges of a PLY, with posterior and covariance as properties of each edge."""

from pathlib import Path

import numpy as np

from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.lines_table import COORDINATES, UPPER
from trinoc.io.formats.losses import TRACKS
from trinoc.match import TRINOCULAR, Matches


def write_ply(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write two vertices and an edge for each track, as text."""
    covariances = [f"cov_{COORDINATES[row]}_{COORDINATES[column]}" for row, column in UPPER]
    header = [
        "ply",
        "format ascii 1.0",
        f"comment unit {unit_mm!r} mm, Z up; cov_* is the covariance of x1 to z2 in that unit",
        f"element vertex {2 * len(matches)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element edge {len(matches)}",
        "property int vertex1",
        "property int vertex2",
        "property uchar trinocular",
        "property double posterior",
        *(f"property double {name}" for name in covariances),
        "end_header",
    ]
    vertices = [_joined(end) for end in (matches.lines_mm / unit_mm).reshape(-1, 3)]
    rows, columns = np.triu_indices(6)
    numbers = np.column_stack(
        [matches.posterior, (matches.covariance_mm2 / unit_mm**2)[:, rows, columns]]
    )
    edges = [
        f"{2 * k} {2 * k + 1} {int(stage == TRINOCULAR)} {_joined(row)}"
        for k, (stage, row) in enumerate(zip(matches.stage, numbers, strict=True))
    ]
    write_text(path, "\n".join([*header, *vertices, *edges]) + "\n")


def _joined(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.tolist()))


ply = Format(
    name="ply",
    title="PLY",
    holds=("matches",),
    reads=(),
    place="file",
    endings=(".ply",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="the world of the rig",
    loses=(TRACKS,),
    write=write_ply,
)
