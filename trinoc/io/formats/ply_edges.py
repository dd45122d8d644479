"""3-D segments as the edges of a PLY, with what is known of each; wire frames, and cylinders."""

from pathlib import Path

import numpy as np

from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.io.formats.lines_table import COORDINATES, UPPER
from trinoc.io.formats.losses import TRACKS
from trinoc.io.formats.wires import wires_of
from trinoc.match import TRINOCULAR, Cylinders, Matches, Wireframe


def write_ply(value: Matches | Wireframe | Cylinders, path: Path, unit_mm: float) -> None:
    """Write two vertices and an edge for each track, or a wire frame with its faces, as text."""
    if isinstance(value, Wireframe):
        write_text(path, "\n".join(_of_wireframe(value, unit_mm)) + "\n")
    elif isinstance(value, Cylinders):
        write_text(path, "\n".join(_of_cylinders(value, unit_mm)) + "\n")
    else:
        write_text(path, "\n".join(_of_matches(value, unit_mm)) + "\n")


def _of_matches(matches: Matches, unit_mm: float) -> list[str]:
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
    return [*header, *vertices, *edges]


def _of_wireframe(frame: Wireframe, unit_mm: float) -> list[str]:
    """Vertices with their covariance, faces as lists of vertices, edges with their posterior."""
    rows, columns = np.triu_indices(3)
    names = [f"cov_{'xyz'[row]}_{'xyz'[column]}" for row, column in zip(rows, columns, strict=True)]
    faces = frame.faces
    header = [
        "ply",
        "format ascii 1.0",
        f"comment unit {unit_mm!r} mm, Z up; cov_* is the covariance of a vertex in that unit",
        f"element vertex {len(frame.vertices_mm)}",
        *(f"property double {axis}" for axis in "xyz"),
        "property uchar corner",
        *(f"property double {name}" for name in names),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        f"element edge {len(frame)}",
        "property int vertex1",
        "property int vertex2",
        "property uchar views",
        "property double posterior",
        "end_header",
    ]
    covariance = (frame.vertices_covariance_mm2 / unit_mm**2)[:, rows, columns]
    vertices = [
        f"{_joined(place)} {int(corner)} {_joined(spread)}"
        for place, corner, spread in zip(
            frame.vertices_mm / unit_mm, frame.corner, covariance, strict=True
        )
    ]
    loops = [f"{len(loop)} {' '.join(map(str, loop.tolist()))}" for loop in faces]
    edges = [
        f"{one} {other} {views} {posterior!r}"
        for (one, other), views, posterior in zip(
            frame.edges.tolist(), frame.views.tolist(), frame.posterior.tolist(), strict=True
        )
    ]
    return [*header, *vertices, *loops, *edges]


def _of_cylinders(cylinders: Cylinders, unit_mm: float) -> list[str]:
    """Edges of rims and mantles, each with its cylinder, and what is known of that."""
    wires = wires_of(cylinders)
    known = np.column_stack(
        [cylinders.radius_mm / unit_mm, cylinders.radius_sigma_mm / unit_mm, cylinders.posterior]
    )
    return [
        "ply",
        "format ascii 1.0",
        f"comment unit {unit_mm!r} mm, Z up",
        f"element vertex {len(wires.places_mm)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element edge {len(wires.pairs)}",
        "property int vertex1",
        "property int vertex2",
        "property int cylinder",
        *(f"property double {name}" for name in ("radius", "radius_sigma", "posterior")),
        "end_header",
        *(_joined(place) for place in wires.places_mm / unit_mm),
        *(
            f"{one} {other} {row} {_joined(known[row])}"
            for (one, other), row in zip(wires.pairs.tolist(), wires.owner.tolist(), strict=True)
        ),
    ]


def _joined(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.tolist()))


ply = Format(
    name="ply",
    title="PLY",
    holds=("matches", "wireframe", "cylinders"),
    reads=(),
    place="file",
    endings=(".ply",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="the world of the rig",
    loses=(TRACKS,),
    write=write_ply,
)
