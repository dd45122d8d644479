"""Known shapes from files: lists of edges, polylines, OBJ models, truth of synthetic scenes."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.evaluation.known_shape import GREY_STEP, KnownShape
from trinoc.io.atomic import read_bytes
from trinoc.io.column_names import names_of_line, order_in_space
from trinoc.io.demo import FORMAT as SCENE_FORMAT, load_scene_truth
from trinoc.io.json_document import parsed_json
from trinoc.io.obj_model import CREASE_DEG, edges_of_obj, straight_runs

# Models with millions of faces have this.
MOST_BYTES_OF_SHAPE = 1_000_000_000

_REMEDY = "give lines of six numbers x1 y1 z1 x2 y2 z2, or points x y z with a blank line between"


def load_shape(
    path: str | os.PathLike[str],
    *,
    unit_mm: float = 1.0,
    crease_deg: float = CREASE_DEG,
    grey_step: float = GREY_STEP,
) -> KnownShape:
    """Read the edges of a known shape.

    Parameters
    ----------
    path : path
        File in one of the formats below.
    unit_mm : float
        Length in mm of one unit of the file.
    crease_deg : float
        Smallest angle between two faces of an OBJ model whose common side is an edge.
    grey_step : float
        Smallest difference of grey levels across a visible edge of a synthetic scene.

    Returns
    -------
    KnownShape
        Edges in mm. Straight pieces that continue each other, of a polyline or of an OBJ model, are
        one edge.

    Raises
    ------
    InputError
        If the file cannot be read. The message names the line.

    Notes
    -----
    - .obj: edges are the sides of faces that meet at more than `crease_deg`, the sides of only one
      face, and polylines (`l`). Faces hide the edges behind them.
    - .json: a list of edges, or an object with this list under "edges_mm" or "edges". An edge is
      [[x, y, z], [x, y, z]] or six numbers.
    - truth.json of a synthetic scene: the straight edges that are visible in two images should be
      detected.
    - Other text: a row of six numbers is an edge; a row of three numbers is a point of a polyline,
      and a blank line separates polylines. Commas or blanks separate numbers. Lines that begin
      with `#` are skipped. A first line may name the columns, in any order: x1 y1 z1 x2 y2 z2, or
      x y z.
    """
    file = Path(path)
    if not (np.isfinite(unit_mm) and unit_mm > 0):
        raise InputError(f"The unit is {unit_mm} mm, but must be positive.")
    if file.suffix.lower() == ".json":
        return _of_json(file, unit_mm, grey_step)
    text = _read_text(file)
    if file.suffix.lower() == ".obj":
        model = edges_of_obj(text, str(file), crease_deg=crease_deg)
        shape = KnownShape.of_edges(unit_mm * model.edges, unit_mm * model.triangles)
    else:
        shape = KnownShape.of_edges(unit_mm * _of_rows(text, str(file)))
    return _check_shape(shape, file)


def _read_text(file: Path) -> str:
    try:
        return read_bytes(file, MOST_BYTES_OF_SHAPE).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{file} is no text file: {_REMEDY}, or an OBJ model.") from error


def _check_shape(shape: KnownShape, file: Path) -> KnownShape:
    if len(shape.edges_mm) == 0:
        raise InputError(f"{file} holds no edge: {_REMEDY}.")
    return shape


def _of_rows(text: str, file: str) -> Float[np.ndarray, "m 2 3"]:
    """Edges (m, 2, 3) in a text: rows of six numbers, or polylines of rows of three numbers."""
    edges: list[list[float]] = []
    polylines: list[list[list[float]]] = [[]]
    width = 0
    heading: tuple[list[str], str] | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.replace(",", " ").replace(";", " ").split()
        if not fields:
            polylines.append([])
            continue
        if fields[0].startswith("#"):
            continue
        row = _numbers(fields)
        if row is None:
            if width == 0 and heading is None and not any(map(_is_number, fields)):
                heading = names_of_line(line.strip()), f"{file}, line {number}"
                continue
            raise InputError(f"{file}, line {number}: these are not all finite numbers: {_REMEDY}.")
        width = width or len(row)
        if len(row) not in (3, 6) or len(row) != width:
            wanted = f"{width} as before" if width in (3, 6) else "three or six"
            raise InputError(
                f"{file}, line {number}: there are {len(row)} numbers instead of {wanted}: "
                f"{_REMEDY}."
            )
        if heading is not None:
            row = order_in_space(heading[0], np.array([row]), heading[1])[0].tolist()
        (edges if width == 6 else polylines[-1]).append(row)  # pyright: ignore[reportArgumentType]
        if width == 6 and row[:3] == row[3:]:
            raise InputError(f"{file}, line {number}: the edge has no length: leave it out.")
    if width == 6:
        return np.array(edges).reshape(-1, 2, 3)
    runs = [straight_runs(np.array(points)) for points in polylines if len(points) > 1]
    return np.concatenate([np.zeros((0, 2, 3)), *runs])


def _numbers(fields: list[str]) -> list[float] | None:
    if not all(map(_is_number, fields)):
        return None
    values = [float(word) for word in fields]
    return values if np.isfinite(values).all() else None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _of_json(file: Path, unit_mm: float, grey_step: float) -> KnownShape:
    document = parsed_json(_read_text(file), file)
    if isinstance(document, dict) and document.get("format") == SCENE_FORMAT:
        if unit_mm != 1.0:
            raise InputError(f"{file} is in millimetres already: omit the unit.")
        truth = load_scene_truth(file)
        return _check_shape(KnownShape.of_scene(truth, grey_step=grey_step), file)
    if isinstance(document, dict):
        document = document.get("edges_mm", document.get("edges"))
    if not isinstance(document, list):
        raise InputError(
            f'{file} contains no list of edges: give a list, or a list under "edges_mm".'
        )
    edges = [_edge(file, number, entry) for number, entry in enumerate(document)]
    return _check_shape(KnownShape.of_edges(unit_mm * np.array(edges).reshape(-1, 2, 3)), file)


def _edge(file: Path, number: int, entry: Any) -> Float[np.ndarray, "2 3"]:
    """Convert an entry of a JSON list to the two ends of an edge; `number` is its index."""
    try:
        edge = np.array(entry, dtype=np.float64).reshape(2, 3)
    except (TypeError, ValueError, OverflowError):
        edge = np.full((2, 3), np.nan)
    if not np.isfinite(edge).all() or (edge[0] == edge[1]).all():
        raise InputError(
            f"{file}: edge {number} of the list is not two different points of three finite "
            "numbers: correct it, or leave it out."
        )
    return edge
