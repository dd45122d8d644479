"""Edges and faces of a Wavefront OBJ model. Edges that continue each other become one edge."""

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError

# Points lie on the edge from the first to the last of a run to within this share of its length:
# more than the digits of a file round off, and less than the chords of an arc that turn by a
# twentieth of a degree.
STRAIGHT = 1e-4


def straight_runs(
    points: Float[np.ndarray, "n 3"], *, tolerance: float = STRAIGHT
) -> Float[np.ndarray, "k 2 3"]:
    """Split a polyline into its longest straight pieces, (k, 2, 3) ends.

    A closed polyline repeats its first point at the end. `tolerance` is the largest distance of a
    point from its piece, as a share of the length of the piece.
    """
    is_new = np.append(True, np.any(points[1:] != points[:-1], axis=1))
    points = points[is_new]
    edges, start = [], 0
    while start < len(points) - 1:
        stop = start + 1
        while stop + 1 < len(points) and _is_straight(points[start : stop + 2], tolerance):
            stop += 1
        edges.append(points[[start, stop]])
        start = stop
    runs = np.array(edges).reshape(-1, 2, 3)
    closed = len(runs) > 1 and np.array_equal(points[0], points[-1])
    # A closed polyline may begin in the middle of an edge.
    if closed and _is_straight(np.array([runs[-1, 0], points[0], runs[0, 1]]), tolerance):
        runs = np.concatenate([np.stack([runs[-1, 0], runs[0, 1]])[None], runs[1:-1]])
    return runs


def _is_straight(points: Float[np.ndarray, "n 3"], tolerance: float) -> bool:
    """True if the inner points lie, in order, on the line from the first to the last point."""
    chord = points[-1] - points[0]
    length = np.linalg.norm(chord)
    if length == 0:
        return False
    along = (points - points[0]) @ chord / length
    across = np.linalg.norm(points - points[0] - along[:, None] * chord / length, axis=1)
    return bool(across.max() <= tolerance * length and (np.diff(along) > 0).all())


CREASE_DEG = 30.0
# Exporters give the corner of several faces several vertices: they count as one when they agree
# to this share of the model's size.
_SAME_PLACE = 1e-7

Link = tuple[int, int]


class ObjModel(NamedTuple):
    """Edges and faces of an OBJ model, in the unit of the file.

    Attributes
    ----------
    edges : (m, 2, 3)
        Ends of each edge.
    triangles : (f, 3, 3)
        Corners of the triangles that the faces consist of.
    """

    edges: Float[np.ndarray, "m 2 3"]
    triangles: Float[np.ndarray, "f 3 3"]


def edges_of_obj(text: str, file: str, *, crease_deg: float = CREASE_DEG) -> ObjModel:
    """Edges and faces of an OBJ text.

    Parameters
    ----------
    text : str
        Content of the file.
    file : str
        Name of the file, for messages.
    crease_deg : float
        Smallest angle between two faces whose common side is an edge.

    Returns
    -------
    ObjModel
        The edges also include sides of one face or of more than two faces, and polylines.

    Raises
    ------
    InputError
        For an invalid line. The message names the line.
    """
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    polylines: list[list[int]] = []
    for number, line in enumerate(_joined_lines(text), start=1):
        fields = line.partition("#")[0].split()
        if not fields or fields[0] not in ("v", "f", "l"):
            continue
        if fields[0] == "v":
            vertices.append(_vertex(fields[1:], f"{file}, line {number}"))
            continue
        corners = [_index(word, len(vertices), f"{file}, line {number}") for word in fields[1:]]
        fewest = 3 if fields[0] == "f" else 2
        if len(corners) < fewest:
            raise InputError(
                f"{file}, line {number}: {len(corners)} corners are too few for "
                f"{'a face' if fewest == 3 else 'a polyline'}: give {fewest} or more."
            )
        (faces if fields[0] == "f" else polylines).append(corners)
    point_of, points = _merge_vertices(np.array(vertices).reshape(-1, 3))
    faces = [_without_repeats([point_of[corner] for corner in face]) for face in faces]
    faces = [face for face in faces if len(face) > 2]
    creases = _creases(points, faces, crease_deg)
    runs = [straight_runs(points[chain]) for chain in _chains(creases)]
    runs += [straight_runs(points[[point_of[i] for i in polyline]]) for polyline in polylines]
    triangles = [corner for face in faces for corner in _triangles(points, face)]
    return ObjModel(
        _each_once(np.concatenate([np.zeros((0, 2, 3)), *runs])),
        points[np.array(triangles, dtype=np.int64).reshape(-1, 3)],
    )


def _each_once(edges: Float[np.ndarray, "m 2 3"]) -> Float[np.ndarray, "e 2 3"]:
    """Remove repeated edges, for example of a polyline along the side of a face."""
    ordered = np.array([sorted(edge) for edge in edges.tolist()]).reshape(-1, 6)
    _, first = np.unique(ordered, axis=0, return_index=True)
    return edges[np.sort(first)]


def _joined_lines(text: str) -> list[str]:
    """Lines of an OBJ text; a line that ends in a backslash is joined with the next one.

    An empty line replaces the first of both, so that line numbers stay the same.
    """
    lines: list[str] = []
    unfinished_line = ""
    for line in text.splitlines():
        if line.endswith("\\"):
            unfinished_line += line[:-1] + " "
            lines.append("")
        else:
            lines.append(unfinished_line + line)
            unfinished_line = ""
    return [*lines, unfinished_line] if unfinished_line else lines


def _vertex(fields: list[str], where: str) -> list[float]:
    try:
        values = [float(word) for word in fields[:3]]
    except ValueError:
        values = []
    if len(values) < 3 or not np.isfinite(values).all():
        raise InputError(f"{where}: a vertex needs three finite numbers: correct it there.")
    return values


def _index(word: str, count: int, where: str) -> int:
    """Convert a vertex reference of an OBJ text to an index from 0.

    References count from 1, or with a minus sign back from the last of `count` vertices. Raise
    `InputError` for an invalid reference.
    """
    try:
        number = int(word.split("/")[0])
    except ValueError:
        number = 0
    index = number - 1 if number > 0 else count + number
    if number == 0 or not 0 <= index < count:
        raise InputError(
            f'{where}: "{word}" names none of the {count} vertices before it: correct it there.'
        )
    return index


def _merge_vertices(
    vertices: Float[np.ndarray, "n 3"],
) -> tuple[list[int], Float[np.ndarray, "k 3"]]:
    """Merge vertices at the same position: (point index of each vertex, points (k, 3))."""
    if len(vertices) == 0:
        return [], vertices
    size = float(np.ptp(vertices, axis=0).max()) or 1.0
    rounded = np.rint((vertices - vertices.min(axis=0)) / (_SAME_PLACE * size)).astype(np.int64)
    _, first, point_of = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    return point_of.reshape(-1).tolist(), vertices[first]


def _without_repeats(face: list[int]) -> list[int]:
    return [corner for i, corner in enumerate(face) if corner != face[i - 1]]


def _creases(
    points: Float[np.ndarray, "k 3"], faces: list[list[int]], crease_deg: float
) -> list[Link]:
    """Sides of faces that are edges of the shape, as pairs of point indices.

    These are sides of two faces that meet at more than `crease_deg`, of one face, or of more than
    two.
    """
    owners: defaultdict[Link, list[tuple[int, bool]]] = defaultdict(list)
    for number, face in enumerate(faces):
        for i, corner in enumerate(face):
            link = face[i - 1], corner
            owners[min(link), max(link)].append((number, link[0] < link[1]))
    normals = [_normal(points[face]) for face in faces]
    creases = []
    for link, face_sides in owners.items():
        if len(face_sides) == 2:
            (a, forward), (b, also_forward) = face_sides
            # Faces wound alike go along their common edge in opposite ways.
            sign = -1.0 if forward == also_forward else 1.0
            sine = np.linalg.norm(np.cross(normals[a], normals[b]))
            turn = np.degrees(np.arctan2(sine, sign * float(normals[a] @ normals[b])))
            if turn <= crease_deg:
                continue
        creases.append(link)
    return creases


def _normal(corners: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """Unit normal (3,) of a polygon by Newell's method; zero for a polygon without area."""
    centred = corners - corners.mean(axis=0)
    normal = np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)
    length = np.linalg.norm(normal)
    return normal / length if length > 0 else normal


def _chains(links: list[Link]) -> list[list[int]]:
    """Join pairs of point indices to polylines, through points that belong to exactly two pairs."""
    links_at: defaultdict[int, list[Link]] = defaultdict(list)
    for link in links:
        links_at[link[0]].append(link)
        links_at[link[1]].append(link)
    remaining = dict.fromkeys(links)
    ends = [link for link in links if len(links_at[link[0]]) != 2 or len(links_at[link[1]]) != 2]
    chains = []
    for first in [*ends, *links]:
        if first not in remaining:
            continue
        del remaining[first]
        begin, end = first if len(links_at[first[0]]) != 2 else first[::-1]
        chain = [begin, end]
        while len(links_at[chain[-1]]) == 2:
            following = [link for link in links_at[chain[-1]] if link in remaining]
            if not following:
                break
            del remaining[following[0]]
            a, b = following[0]
            chain.append(b if a == chain[-1] else a)
        chains.append(chain)
    return chains


def _triangles(points: Float[np.ndarray, "k 3"], face: list[int]) -> list[list[int]]:
    """Split a plane polygon into triangles by cutting off ears; empty if it crosses itself.

    `face` and the result are point indices.
    """
    normal = _normal(points[face])
    corners, triangles = list(face), []
    while len(corners) > 3:
        for i in range(len(corners)):
            ear = [corners[i - 1], corners[i], corners[(i + 1) % len(corners)]]
            if _is_ear(points, ear, corners, normal):
                break
        else:  # a polygon that crosses itself
            return []
        triangles.append(ear)
        corners.remove(ear[1])
    return [t for t in [*triangles, corners] if np.any(_normal(points[t]))]


def _is_ear(
    points: Float[np.ndarray, "k 3"],
    ear: list[int],
    polygon: list[int],
    normal: Float[np.ndarray, "3"],
) -> bool:
    """True if three consecutive corners of a polygon are a triangle inside the polygon.

    The corner must turn in the direction of `normal`, and no other corner may lie in the triangle.
    """
    corners = points[ear]
    side = np.cross(np.roll(corners, -1, axis=0) - corners, normal[None])
    if np.cross(corners[1] - corners[0], corners[2] - corners[1]) @ normal < 0:
        return False
    others = points[[corner for corner in polygon if corner not in ear]]
    # Outside is where the way is across any side.
    depth = np.einsum("nsi,si->ns", others[:, None] - corners[None], side)
    return not bool((depth < 0).all(axis=1).any())
