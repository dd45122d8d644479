"""Segments against the exact edges of rendered scenes: recall, precision and errors.

Segments against published segments of photographs: how many of those are found.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from trinoc.geometry.rig import Rig
from trinoc.io import load_scene_truth
from trinoc.io.rig_json import load_rig

# Slopes of shadows count this far from a segment.
SHADOW_PX = 4
# A segment lies on the edge of a shadow where the light that shadows take away, smoothed by one
# pixel, changes across the segment by this much per pixel (a sharp step of 2.5 levels does).
SHADOW_SLOPE, SHADOW_COSINE = 1.0, np.cos(np.radians(20.0))
STRONG_STEP, WEAK_STEP = 8.0, 2.0
REACH_PX, ANGLE_DEG = 1.5, 8.0
SAMPLE_PX = 0.5
# A published segment is found again where so much of its length is covered.
COVERED_SHARE = 0.8
# Edges that deviate less than this from one line are parts of one edge.
SAME_LINE_PX = 0.1


class Picture(NamedTuple):
    """A picture, and its edges: rows x1 y1 x2 y2, the grey step across (right minus left of the
    way from first to second end), and 1 where that step is on record, 0 where it is not.

    `shadow_slope` is, at each pixel, the steepest slope of shadows within 4 px, in grey levels
    per pixel, and `shadow_gradient` (h, w, 2) that slope along u and v at the pixel itself; both
    are 0 where the scene was rendered without shadows. `rims` are the chords of cylinders' rims,
    rows x1 y1 x2 y2, and `clean` the picture without noise, if it was kept.
    """

    name: str
    grey: np.ndarray
    edges: np.ndarray
    shadow_slope: np.ndarray
    shadow_gradient: np.ndarray
    rims: np.ndarray
    clean: np.ndarray | None


class Photograph(NamedTuple):
    """A photograph of the set `name`, and its published segments, rows x1 y1 x2 y2."""

    name: str
    grey: np.ndarray
    published: np.ndarray


def photographs(folder: Path) -> Iterator[Photograph]:
    """The photographs of a set, or of all sets in a folder.

    A set is a folder with one NAME.npz, whose `segments_0`, `segments_1`, ... are the published
    segments of view0.png, view1.png, ... (or .jpg; or view00, view01, ...).
    """
    for path in sorted([*folder.glob("*.npz"), *folder.glob("*/*.npz")]):
        published = np.load(path)
        numbers = [key.removeprefix("segments_") for key in published if "segments_" in key]
        for number in numbers:
            files = {*path.parent.glob(f"view{number}.*"), *path.parent.glob(f"view0{number}.*")}
            for file in files:
                grey = np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))
                lines = published[f"segments_{number}"][:, :4].astype(float)
                yield Photograph(path.stem, grey, lines)


def recall_of_published(photograph: Photograph, lines: np.ndarray) -> np.ndarray:
    """(n,) whether lines within 1.5 px and eight degrees cover 80 % of each published segment."""
    hit, owner, _, _ = covering(photograph.published, lines)
    return np.bincount(owner, hit >= 0) / np.bincount(owner) >= COVERED_SHARE


class Score(NamedTuple):
    """Lengths and errors of the segments of one picture, in px.

    `put_out` leaves out what lies on the edge of a shadow and on no strong edge of the scene,
    `put_out_weak` what lies on the edge of a shadow and on no edge at all: `on_shadows` long.
    `on_rims` are chords of cylinders' rims, which count as false.
    `matched` are the segments that lie on an edge, `step` what grey step that edge says there
    is from their left to their right: negative where the right is darker; NaN where not known.
    `ends_along` tells how far their ends reach beyond the nearest end of that edge, along it.
    `alone` says whether no other edge lies within reach, with which it would be confused.
    """

    found: float
    shown: float
    right: float
    right_weak: float
    put_out: float
    put_out_weak: float
    on_shadows: float
    on_rims: float
    across_of_length: np.ndarray
    ends_across: np.ndarray
    end_error: np.ndarray
    ends_along: np.ndarray
    matched: np.ndarray
    step: np.ndarray
    alone: np.ndarray


def rendered_images(folder: Path) -> Iterator[Picture]:
    """The pictures of benchmarks/render_pictures.py blocks, by seed.

    The rims of cylinders are no edges here: a chord of one is a false segment. The outlines of
    their bodies are visible but have no step on record: they count as weak edges.
    """
    for path in sorted(folder.glob("block_*/truth.json")):
        yield from pictures_of_scene(path, load_rig(path.parent / "rig.json"))


def pictures_of_scene(path: Path, rig: Rig) -> Iterator[Picture]:
    """The pictures in the folder of one scene's truth, as of `rendered_images`."""
    truth, record = load_scene_truth(path), json.loads(path.read_text())
    outlines = record["silhouettes_mm"]
    for view, visible_parts in truth.seen.items():
        matrix = np.asarray(rig[view].matrix_px)
        straight = np.array([truth.edge_kinds[edge] == "edge" for edge in visible_parts.edge])
        edge, extent = visible_parts.edge[straight], visible_parts.extent[straight]
        first, second = truth.edges_mm[edge, 0], truth.edges_mm[edge, 1]
        parts = first[:, None] + extent[:, :, None] * (second - first)[:, None]
        step = -visible_parts.grey_step[straight]
        rows = np.column_stack([_project(matrix, parts), step, np.ones(len(step))])
        body = np.array(outlines[view]).reshape(-1, 2, 3)
        unknown = np.tile([5.0, 0.0], (len(body), 1))
        rows = np.concatenate([rows, np.column_stack([_project(matrix, body), unknown])])
        file = str(path.parent / f"scene_{view}.png")
        grey = np.asarray(cv2.imread(file, cv2.IMREAD_UNCHANGED))
        length = np.hypot(*(rows[:, 2:4] - rows[:, :2]).T)
        gradient = shadow_gradient(path.parent / f"shadows_{view}.png", grey.shape)
        slope = np.linalg.norm(gradient, axis=-1)
        slope = cv2.dilate(slope, np.ones((2 * SHADOW_PX + 1,) * 2, np.uint8))
        rim_edge, rim_extent = visible_parts.edge[~straight], visible_parts.extent[~straight]
        first, second = truth.edges_mm[rim_edge, 0], truth.edges_mm[rim_edge, 1]
        parts = first[:, None] + rim_extent[:, :, None] * (second - first)[:, None]
        yield Picture(
            f"{path.parent.name}/{view}", grey, rows[length > 2], slope, gradient,
            _project(matrix, parts), _clean(path.parent / f"clean_{view}.png"),
        )  # fmt: skip


def _clean(path: Path) -> np.ndarray | None:
    if not path.exists():
        return None
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)) / 256.0


def shadow_gradient(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    if not path.exists():
        return np.zeros((*shape, 2), dtype=np.float32)
    taken = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)).astype(np.float32)
    taken = cv2.GaussianBlur(taken, (0, 0), 1.0)
    slopes = (cv2.Sobel(taken, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    return np.stack(list(slopes), axis=-1)


def score(segments: np.ndarray, picture: Picture) -> Score:
    """Score of segments (n, 4) against the edges of a picture.

    Samples every half pixel: one is found (right) when a segment (an edge) lies within 1.5 px
    and eight degrees of it. A segment that is right over half of its length is compared with
    the edge that most of its samples lie on.
    """
    edges = picture.edges
    strong = edges[np.abs(edges[:, 4]) >= STRONG_STEP]
    weak = edges[np.abs(edges[:, 4]) >= WEAK_STEP]
    of_edge, _, edge_length, _ = covering(strong, segments)
    of_strong, _, length, _ = covering(segments, strong)
    of_weak, owner, _, across = covering(segments, weak)
    shadow = _on_shadow(segments, picture.shadow_gradient)
    on_rim = covering(segments, picture.rims)[0] >= 0
    ends, error, beyond, matched, step, alone = [], [], [], [], [], []
    for index, segment in enumerate(segments):
        hits = of_weak[owner == index]
        if len(hits) == 0 or np.mean(hits >= 0) < 0.5:
            continue
        row = weak[np.bincount(hits[hits >= 0]).argmax()]
        edge = row[:4].reshape(2, 2)
        direction = (edge[1] - edge[0]) / np.linalg.norm(edge[1] - edge[0])
        offset = segment[:4].reshape(2, 2) - edge[0]
        ends.append(offset[:, 1] * direction[0] - offset[:, 0] * direction[1])
        gap = np.linalg.norm(segment[:4].reshape(2, 1, 2) - edge, axis=-1)
        error.extend(gap.min(axis=0))
        along, size = offset @ direction, np.linalg.norm(edge[1] - edge[0])
        beyond.append(np.where(along < size / 2, -along, along - size))
        matched.append(index)
        same_way = np.sign((segment[2:4] - segment[:2]) @ direction)
        others = off_line(edges, edge)
        alone.append(bool((covering(segment[None], others)[0] < 0).all()))
        step.append(same_way * row[4] if row[5] else np.nan)
    return Score(
        edge_length[of_edge >= 0].sum(),
        edge_length.sum(),
        length[of_strong >= 0].sum(),
        length[of_weak >= 0].sum(),
        length[(of_strong >= 0) | ~shadow].sum(),
        length[(of_weak >= 0) | ~shadow].sum(),
        length[(of_weak < 0) & shadow].sum(),
        length[(of_weak < 0) & ~shadow & on_rim].sum(),
        np.abs(across[of_weak >= 0]),
        np.array(ends).reshape(-1, 2),
        np.array(error),
        np.array(beyond).reshape(-1, 2),
        np.array(matched, dtype=int),
        np.array(step),
        np.array(alone, dtype=bool),
    )


def off_line(edges: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Edges that do not lie on the line through two points."""
    return edges[np.abs(_across(edges, line)).max(axis=1) > SAME_LINE_PX]


def _across(edges: np.ndarray, line: np.ndarray) -> np.ndarray:
    """(m, 2) distances of the ends of edges from a line through two points."""
    direction = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    offset = edges[:, :4].reshape(-1, 2, 2) - line[0]
    return offset[..., 1] * direction[0] - offset[..., 0] * direction[1]


def _on_shadow(segments: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Mask of the segments' samples on the edge of a shadow that runs along them."""
    sample, unit, _, _ = samples_of(segments)
    return samples_on_shadow(sample, unit, gradient)


def samples_on_shadow(sample: np.ndarray, unit: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Mask of the points at which a shadow's edge runs along `unit` within 1.5 px."""
    normal = np.stack([-unit[:, 1], unit[:, 0]], axis=-1)
    shadow = np.zeros(len(sample), dtype=bool)
    height, width = gradient.shape[:2]
    for offset in (-REACH_PX, -REACH_PX / 2, 0.0, REACH_PX / 2, REACH_PX):
        column, row = np.rint(sample + offset * normal).astype(int).T
        there = gradient[row.clip(0, height - 1), column.clip(0, width - 1)]
        across, size = np.abs((there * normal).sum(axis=1)), np.linalg.norm(there, axis=1)
        shadow |= (size > SHADOW_SLOPE) & (across > SHADOW_COSINE * size)
    return shadow


def samples_of(lines: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(sample, unit, owner, length) of points every half pixel along lines x1 y1 x2 y2.

    The point, the unit vector along its line, the line, and the length it stands for.
    """
    steps_px = lines[:, 2:4] - lines[:, :2]
    size = np.hypot(*steps_px.T)
    count = np.maximum(1, np.rint(size / SAMPLE_PX).astype(int))
    owner = np.repeat(np.arange(len(lines)), count)
    step = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[owner]
    sample = lines[owner, :2] + step[:, None] * steps_px[owner]
    return sample, (steps_px / size[:, None])[owner], owner, (size / count)[owner]


def covering(
    one: np.ndarray, other: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(other, one, length, across): of each sample of `one`, the nearest line that covers it.

    `other` is -1 where none does; `across` is the sample's signed distance from that line.
    """
    sample, unit, owner, length_each = samples_of(one)
    best, nearest = np.full(len(sample), REACH_PX), np.full(len(sample), -1)
    signed = np.full(len(sample), np.nan)
    for index, line in enumerate(other):
        direction = line[2:4] - line[:2]
        length = np.hypot(*direction)
        direction = direction / length
        offset = sample - line[:2]
        along = offset @ direction
        across = offset[:, 1] * direction[0] - offset[:, 0] * direction[1]
        parallel = np.abs(unit @ direction) > np.cos(np.radians(ANGLE_DEG))
        covers = (along > -REACH_PX) & (along < length + REACH_PX) & parallel
        closer = np.flatnonzero(covers & (np.abs(across) < best))
        best[closer], nearest[closer] = np.abs(across[closer]), index
        signed[closer] = across[closer]
    return nearest, owner, length_each, signed


def _project(matrix: np.ndarray, ends_mm: np.ndarray) -> np.ndarray:
    image = ends_mm @ matrix[:, :3].T + matrix[:, 3]
    return (image[..., :2] / image[..., 2:]).reshape(-1, 4)
