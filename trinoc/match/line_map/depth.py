"""Depth as one view sees it: along the matched lines, and on the planes that they bound."""

from collections import deque
from itertools import combinations

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.cluster.hierarchy import fcluster, linkage
from skimage.draw import polygon

from trinoc.geometry.camera import Camera, project
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.line_map import DepthTuning
from trinoc.numerics.precision import in_float64


@in_float64
def depth_map(
    matches: Matches,
    rig: Rig,
    view: str,
    *,
    filled: bool = False,
    tuning: MatchTuning = DEFAULT,
) -> Float[np.ndarray, "h w"]:
    """Depth in mm before a camera at each pixel, NaN where nothing is known.

    Along every line that the view sees; with `filled` also inside every closed loop of matched
    lines of one plane, whichever views see them, the nearest plane where several overlap.
    Nothing is guessed where a loop is not closed. Raises InputError for an unknown view.
    """
    camera = rig[view]
    width, height = camera.image_size_px
    depth = np.full((height, width), np.inf)
    seen = matches.index[:, matches.views.index(view)] >= 0
    for line in matches.lines_mm[seen]:
        _put_line(depth, camera, line)
    if filled:
        corner_mm = _corner_mm(camera, matches.lines_mm, tuning.depth.corner_px)
        for face in find_loops(matches.lines_mm, corner_mm, tuning.depth):
            _put_face(depth, camera, face)
    return np.where(np.isfinite(depth), depth, np.nan)


def find_loops(
    lines_mm: Float[np.ndarray, "t 2 3"], corner_mm: float, tuning: DepthTuning = DEFAULT.depth
) -> list[np.ndarray]:
    """Corners (k, 3), in order, of every shortest loop of lines that lie in one plane."""
    if len(lines_mm) < 3:
        return []
    ends = lines_mm.reshape(-1, 3)
    corner = fcluster(linkage(ends), corner_mm, criterion="distance") - 1
    place = np.stack([ends[corner == c].mean(axis=0) for c in range(corner.max() + 1)])
    edges = corner.reshape(-1, 2)
    edges = np.unique(np.sort(edges[edges[:, 0] != edges[:, 1]], axis=1), axis=0)
    faces: dict[frozenset[int], np.ndarray] = {}
    for at in range(len(place)):
        around = [int(e.sum()) - at for e in edges if at in e]
        for first, second in combinations(around, 2):
            inside = _in_plane(place, at, first, second, corner_mm, tuning.smallest_sine)
            if inside is None:
                continue
            loop = _shortest_way(edges, inside, first, second, at, tuning.most_edges)
            if loop is not None:
                faces.setdefault(frozenset([at, *loop]), place[[at, *loop]])
    return list(faces.values())


def _in_plane(
    place: Float[np.ndarray, "c 3"],
    at: int,
    first: int,
    second: int,
    corner_mm: float,
    smallest_sine: float,
) -> Bool[np.ndarray, "c"] | None:
    """Which corners lie in the plane of three, None where these are in a row."""
    to_first, to_second = place[first] - place[at], place[second] - place[at]
    normal = np.cross(to_first, to_second)
    size = np.linalg.norm(normal)
    if size < smallest_sine * np.linalg.norm(to_first) * np.linalg.norm(to_second):
        return None
    return np.abs((place - place[at]) @ normal) / size < corner_mm


def _shortest_way(
    edges: Int[np.ndarray, "e 2"],
    inside: Bool[np.ndarray, "c"],
    start: int,
    goal: int,
    avoid: int,
    most_edges: int,
) -> list[int] | None:
    """Corners from start to goal along edges of one plane, without passing `avoid`."""
    before: dict[int, int] = {start: start}
    steps = {start: 2}
    queue = deque([start])
    while queue:
        here = queue.popleft()
        if here == goal:
            way = [here]
            while way[-1] != start:
                way.append(before[way[-1]])
            return way[::-1]
        if steps[here] == most_edges - 1:
            continue
        for a, b in edges[(edges == here).any(axis=1)].tolist():
            there = b if a == here else a
            if there not in before and there != avoid and inside[there]:
                before[there], steps[there] = here, steps[here] + 1
                queue.append(there)
    return None


def _corner_mm(camera: Camera, lines_mm: Float[np.ndarray, "t 2 3"], corner_px: float) -> float:
    depths = _depths(camera, lines_mm.reshape(-1, 3))
    if len(depths) == 0:
        return 0.0
    return float(corner_px * np.median(depths) / np.mean(camera.intrinsics.focal_length_px))


def _depths(camera: Camera, points_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    pose = np.asarray(camera.cam_from_world)
    return points_mm @ pose[2, :3] + pose[2, 3]


def _put_line(depth: Float[np.ndarray, "h w"], camera: Camera, line: np.ndarray) -> None:
    ends = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, line))
    samples = max(int(2 * np.linalg.norm(ends[1] - ends[0])), 2)
    points = line[0] + np.linspace(0, 1, samples)[:, None] * (line[1] - line[0])
    uv = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, points))
    _put(depth, np.rint(uv[:, 1]), np.rint(uv[:, 0]), _depths(camera, points))


def _put_face(depth: Float[np.ndarray, "h w"], camera: Camera, face: np.ndarray) -> None:
    if (_depths(camera, face) <= 0).any():
        return
    uv = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, face))
    rows, columns = polygon(uv[:, 1], uv[:, 0], depth.shape)
    normalise = jax.vmap(camera.intrinsics.normalised_from_pixel)
    normalised = np.asarray(normalise(np.stack([columns, rows], axis=1).astype(np.float64)))
    rays = np.concatenate([normalised, np.ones((len(rows), 1))], axis=1)
    pose = np.asarray(camera.cam_from_world)
    corners = face @ pose[:, :3].T + pose[:, 3]
    centre = corners.mean(axis=0)
    normal = np.linalg.svd(corners - centre)[2][2]
    with np.errstate(divide="ignore"):
        _put(depth, rows, columns, (centre @ normal) / (rays @ normal))


def _put(
    depth: Float[np.ndarray, "h w"], rows: np.ndarray, columns: np.ndarray, value: np.ndarray
) -> None:
    """The nearer of what is there and what comes."""
    height, width = depth.shape
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width) & (value > 0)
    place = rows[inside].astype(np.int64), columns[inside].astype(np.int64)
    np.minimum.at(depth, place, value[inside])
