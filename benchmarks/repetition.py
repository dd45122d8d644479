"""Patterns that repeat: calibration of posteriors where whole rows of matches can shift.

    python benchmarks/repetition.py [--seeds 3] [--first 1] [--only "comb|pictures"] [--copies]

Chessboards, brick walls, shelves, combs and stairs, whose period lies along the line of three
cameras or before those of Table 1: as segments that a detector delivers, fairly or overexposed, and
the boards and walls as pictures too (noise, a lens with distortion), whose segments are found. Some
patterns end in the pictures, some do not. Rows: posteriors from, to: the share that is right
(tracks); then tracks and wrong ones above .9, how many of the right lines lie within their 95 %
regions, segments that are ambiguous, seconds of processor time, and the process's peak of memory.
With --copies, ten nearly equal segments of each view for one: sure tracks on it.
"""

import argparse
import re
import resource
import time
from collections.abc import Callable, Iterator
from itertools import pairwise, product
from typing import NamedTuple

import equinox as eqx
import numpy as np
from matching_truth import collinear_rig, edges_of, square_of, squares
from rig_parts.pixels import BARE
from scipy.stats import chi2

from simulation import Detector, loose_segments, simulate_segments
from simulation.camera_picture.layers import Paint
from simulation.camera_picture.optics import Optics
from simulation.camera_picture.paper import Paper
from simulation.camera_picture.render import Condition, camera_picture
from simulation.camera_picture.scene import SheetScene
from simulation.camera_picture.sensor import Sensor
from simulation.camera_picture.shapes import ConvexPolygon
from simulation.scenes import Scene
from trinoc import Matches, Rig, Segments, find_segments, match_segments
from trinoc.geometry.intrinsics import undistort_pixels
from trinoc.numerics.tables import take_rows
from trinoc.synth import table1_lens, table1_rig
from trinoc.synth.truth import SegmentTruth

LEVELS = (0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0001)
DISTORTION = (-0.12, 0.04, 0.0, 0.0, 0.0)
RIGS: dict[str, Callable[[tuple[float, ...] | None], Rig]] = {
    "in line": lambda distortion: collinear_rig(table1_lens(distortion=distortion)),
    "triangle": lambda distortion: table1_rig(distortion=distortion),
}
EXPOSURES = {"fair": 0.9 / 0.85, "overexposed": 2.2}


class Rectangles(NamedTuple):
    """Figures in one plane: middle and size of each, (n, 2), mm, and their period."""

    middle: np.ndarray
    size: np.ndarray
    period_mm: float


def chessboard(columns: int, random: np.random.Generator) -> Rectangles:
    side = random.uniform(8.0, 12.0)
    i, j = np.meshgrid(np.arange(columns), np.arange(8), indexing="ij")
    dark = (i + j) % 2 == 0
    middle = np.stack([i[dark] - (columns - 1) / 2, j[dark] - 3.5], axis=1) * side
    return Rectangles(middle, np.full(middle.shape, side), side)


def bricks(columns: int, random: np.random.Generator) -> Rectangles:
    length, height = random.uniform(14.0, 20.0), random.uniform(8.0, 10.0)
    mortar = random.uniform(1.5, 2.5)
    i, j = (index.ravel() for index in np.indices((columns // 2, 8)))
    middle = np.stack([(i - columns / 4 + j % 2 / 2) * length, (j - 3.5) * height], axis=1)
    return Rectangles(middle, np.full(middle.shape, (length, height)) - mortar, length / 2)


def of_rectangles(figures: Rectangles) -> np.ndarray:
    """(e, 2, 3) sides of all figures; a side that neighbours share comes once."""
    corners = figures.middle[:, None] + figures.size[:, None] / 2 * [
        [-1, -1],
        [1, -1],
        [1, 1],
        [-1, 1],
    ]
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    first = np.unique(np.round(np.sort(ends, axis=1).reshape(-1, 4), 6), axis=0, return_index=True)[
        1
    ]
    return _in_space(ends[np.sort(first)])


def _in_space(ends: np.ndarray, z: float = 0.0) -> np.ndarray:
    return np.concatenate([ends, np.full((*ends.shape[:2], 1), z)], axis=2)


def _across(x: np.ndarray, low: float, high: float, z: float = 0.0) -> np.ndarray:
    """Lines along Y at each x."""
    ends = np.stack([np.stack([x, np.full(len(x), y)], axis=1) for y in (low, high)], axis=1)
    return _in_space(ends, z)


def shelves(columns: int, random: np.random.Generator) -> np.ndarray:
    pitch, thick = random.uniform(14.0, 20.0), random.uniform(2.0, 4.0)
    x = (np.arange(columns // 2) - columns / 4) * pitch
    sides = np.array([[(x[0], y), (x[-1] + thick, y)] for y in (-50.0, -46.0, 46.0, 50.0)])
    return np.concatenate([_across(x, -46, 46), _across(x + thick, -46, 46), _in_space(sides)])


def comb(columns: int, random: np.random.Generator) -> np.ndarray:
    pitch = random.uniform(5.0, 8.0)
    x, thick = (np.arange(columns) - columns / 2) * pitch, pitch / 2
    tips = np.stack([np.stack([x, 0 * x + 30], 1), np.stack([x + thick, 0 * x + 30], 1)], axis=1)
    spine = np.array([[(x[0], y), (x[-1] + thick, y)] for y in (-30.0, -45.0)])
    teeth = [_across(x, -30, 30), _across(x + thick, -30, 30)]
    return np.concatenate([*teeth, _in_space(tips), _in_space(spine)])


def stairs(columns: int, random: np.random.Generator) -> np.ndarray:
    """Steps turned so that the period lies along X: nosings above, inner corners below."""
    pitch, deep = random.uniform(10.0, 14.0), random.uniform(4.0, 7.0)
    x = (np.arange(columns) - columns / 2) * pitch
    nosing, inner = _across(x, -40, 40), _across(x + pitch / 2, -40, 40, -deep)
    profile = [
        np.stack([a[:, e], b[:, e]], axis=1)
        for a, b in ((nosing, inner), (inner[:-1], nosing[1:]))
        for e in range(2)
    ]
    return np.concatenate([nosing, inner, *profile])


PLANE = {"chessboard": chessboard, "brick wall": bricks}
MADE: dict[str, Callable[[int, np.random.Generator], np.ndarray]] = {
    name: lambda columns, random, build=build: of_rectangles(build(columns, random))
    for name, build in PLANE.items()
} | {"shelves": shelves, "comb": comb, "stairs": stairs}


class Case(NamedTuple):
    """Segments of a pattern, its rig, and functions for right tracks and squared errors."""

    segments: dict[str, Segments]
    rig: Rig
    is_right: Callable[[Matches], np.ndarray]
    squares: Callable[[Matches], np.ndarray]


def columns_of(random: np.random.Generator) -> int:
    """Number of periods: the pattern ends inside all pictures, or inside none."""
    return int(random.integers(10, 15)) if random.random() < 0.6 else 50


def made(kind: str, rig_name: str, exposure: str, seed: int) -> Case:
    """Segments as a detector delivers them; overexposed, more are missing, broken and cut, and the
    sides of what is bright lie farther out, by more in one view than in another."""
    random, over = np.random.default_rng([seed, *map(ord, kind)]), exposure == "overexposed"
    edges = MADE[kind](columns_of(random), random)
    turn, tilt = np.radians(random.normal(size=2) * (1.0, 0.3))
    about_z = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    about_y = np.array(
        [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
    )
    edges = edges @ (about_z @ about_y).T + [*random.uniform(-4, 4, 2), 0]
    sigma_px = float(random.uniform(0.1, 0.3))
    detector = Detector(
        sigma_px, *((0.3, 0.1, 0.0, 5.0) if over else (0.15, 0.1, 0.0, 2.0)), shortest_px=8.0
    )
    rig = RIGS[rig_name](None)
    segments, truth = simulate_segments(Scene.of_edges(edges), rig, detector, seed=seed)
    # Each view misses edges by itself, so that some are in one view alone.
    missed = 0.12 if over else 0.05
    edge_of, extent = {}, {}
    for view, view_segments in segments.items():
        edge = np.asarray(truth.edge_of[view])
        shown = (random.random(len(edges)) > missed)[edge] | (edge < 0)
        edge_of[view], extent[view] = edge[shown], truth.extent[view][shown]
        segments[view] = take_rows(view_segments, shown)
    truth = SegmentTruth(truth.edges_mm, edge_of, extent)
    bright = np.where(random.random(len(edges)) < 0.5, 1.0, -1.0)
    for view, view_segments in segments.items() if over else ():
        ends = np.asarray(view_segments.endpoints_px)
        step = ends[:, 1] - ends[:, 0]
        normal = np.stack([step[:, 1], -step[:, 0]], axis=1) / np.linalg.norm(step, axis=1)[:, None]
        normal *= np.where(normal @ [1.0, 0.5] < 0, -1.0, 1.0)[:, None]
        out = random.uniform(0, 0.6) * bright[truth.edge_of[view]] * (truth.edge_of[view] >= 0)
        moved = ends + out[:, None, None] * normal[:, None]
        segments[view] = eqx.tree_at(lambda s: s.endpoints_px, view_segments, moved)

    def is_right(matches: Matches) -> np.ndarray:
        edges = [edges_of(matches, truth, track) for track in range(len(matches))]
        return np.array([len(numbers) == 1 and min(numbers) >= 0 for numbers in edges], dtype=bool)

    return Case(segments, rig, is_right, lambda matches: squares(matches, truth))


def pictured(kind: str, rig_name: str, exposure: str, seed: int) -> Case:
    """Segments found in pictures of a plane pattern. A track is right where its fragments, on the
    plane, lie within a quarter of a period of each other."""
    random = np.random.default_rng([seed, *map(ord, kind)])
    figures = PLANE[kind](columns_of(random), random)
    shift = random.uniform(-4, 4, 2)
    dark, light = (0.09, 0.85) if kind == "chessboard" else (0.35, 0.7)
    paint = [
        Paint(ConvexPolygon.rectangle(middle + shift, tuple(size)), dark)
        for middle, size in zip(figures.middle, figures.size, strict=True)
    ]
    condition = Condition(
        SheetScene(Paper(paper=light, table=None), covers=tuple(paint)),
        Optics(float(random.uniform(0.6, 1.0))),
        Sensor(exposure=EXPOSURES[exposure], read_levels=float(random.uniform(1.0, 3.0))),
    )
    rig = RIGS[rig_name](DISTORTION)
    segments = {
        view: find_segments(camera_picture(BARE, camera, condition, seed=seed + number))
        for number, (view, camera) in enumerate(rig.items())
    }

    def is_right(matches: Matches) -> np.ndarray:
        positions_mm = np.full((len(matches), len(matches.views), 2), np.nan)
        for number, view in enumerate(matches.views):
            is_member = matches.index[:, number] >= 0
            middle = matches.fragments_px[is_member, number].mean(axis=1)
            flat = undistort_pixels(rig[view].intrinsics, middle)
            on_plane = np.linalg.inv(rig[view].matrix_px[:, [0, 1, 3]])
            homogeneous = np.column_stack([flat, np.ones(len(flat))]) @ on_plane.T
            positions_mm[is_member, number] = homogeneous[:, :2] / homogeneous[:, 2:]
        spread = np.nanmax(positions_mm, axis=1) - np.nanmin(positions_mm, axis=1)
        return np.linalg.norm(spread, axis=1) < figures.period_mm / 4

    edges = of_rectangles(figures._replace(middle=figures.middle + shift))

    def squares_of_right(matches: Matches) -> np.ndarray:
        distances = np.full(len(matches), np.nan)
        for track in np.flatnonzero(is_right(matches)).tolist():
            edge = nearest_edge(edges, matches.lines_mm[track])
            if edge is not None:
                distances[track] = square_of(matches, track, edge)
        return distances

    return Case(segments, rig, is_right, squares_of_right)


def nearest_edge(edges_mm: np.ndarray, line_mm: np.ndarray) -> np.ndarray | None:
    """The edge whose line is nearest to both ends of another and that lies beside it; None where
    none does within 2 mm."""
    step = edges_mm[:, 1] - edges_mm[:, 0]
    along = step / np.linalg.norm(step, axis=1, keepdims=True)
    offset = line_mm - edges_mm[:, None, 0]
    part = np.einsum("eki,ei->ek", offset, along)
    off = np.linalg.norm(offset - part[..., None] * along[:, None], axis=2).max(axis=1)
    overlaps = (part.min(axis=1) < np.linalg.norm(step, axis=1)) & (part.max(axis=1) > 0)
    off[~overlaps] = np.inf
    return edges_mm[off.argmin()] if off.min() < 2.0 else None


class Row(NamedTuple):
    """Result of one set of segments."""

    posterior: np.ndarray
    right: np.ndarray
    in_three: np.ndarray
    is_inside: np.ndarray
    ambiguous: int
    seconds: float


def measure(case: Case) -> Row:
    begin = time.process_time()
    matches = match_segments(case.segments, case.rig)
    seconds = time.process_time() - begin
    distances = case.squares(matches)
    is_inside = distances[np.isfinite(distances)] < chi2.ppf(0.95, 4)
    three = (matches.index >= 0).sum(axis=1) > 2
    ambiguous = sum(
        np.char.startswith(reasons.astype(str), "ambiguous").sum()
        for reasons in matches.reasons.values()
    )
    right = case.is_right(matches)
    return Row(matches.posterior, right, three, is_inside, int(ambiguous), seconds)


def report(name: str, rows: list[Row]) -> None:
    """Print a line for tracks in three views and one for pairs."""
    p, right, three, is_inside = (
        np.concatenate([getattr(row, field) for row in rows])
        for field in ("posterior", "right", "in_three", "is_inside")
    )
    for label, mask in (("three", three), ("two", ~three)):
        posteriors, true = p[mask], right[mask].astype(bool)
        level = np.digitize(posteriors, LEVELS) - 1
        cells = []
        for k, (low, _) in enumerate(pairwise(LEVELS)):
            if (level == k).any():
                cells.append(f"{low:g}: {true[level == k].mean():.2f} ({(level == k).sum()})")
        sure = posteriors > 0.9
        mean = f"{posteriors.mean():.3f} right {true.mean():.3f}" if len(posteriors) else "-"
        print(f"{name:36} {label:5} mean {mean}; {'; '.join(cells)} | sure {sure.sum()}, ", end="")
        print(f"wrong {(sure & ~true).sum()}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    share = f"{is_inside.mean():.3f} ({len(is_inside)})" if len(is_inside) else "-"
    print(
        f"{name:36} 95 % regions hold {share}; ambiguous {sum(row.ambiguous for row in rows)}; "
        f"{sum(row.seconds for row in rows):.1f} s; peak {peak:.0f} MiB",
        flush=True,
    )


def copies(seed: int) -> None:
    """Print the tracks on ten jittered copies of one segment, among segments of loose lines."""
    rig = table1_rig()
    for jitter_px in (0.0, 0.02, 0.05, 0.1, 0.2, 0.4):
        random = np.random.default_rng(seed)
        segments, truth = simulate_segments(
            loose_segments(seed, count=40),
            rig,
            Detector(missing_share=0.0, broken_share=0.0),
            seed=seed,
        )
        shared = set.intersection(*(set(edges.tolist()) for edges in truth.edge_of.values())) - {-1}
        edge, inputs = min(shared), {}
        for view, view_segments in segments.items():
            ends = np.asarray(view_segments.endpoints_px)
            on = ends[truth.edge_of[view] == edge][:1]
            more = np.repeat(on, 10, axis=0) + jitter_px * random.normal(size=(10, 2, 2))
            inputs[view] = np.concatenate([more, ends[truth.edge_of[view] != edge]]).reshape(-1, 4)
        matches = match_segments(inputs, rig)
        on_it = (matches.index < 10).all(axis=1) & (matches.posterior > 0.9)
        equal = {
            view: (reasons == "equal to another segment").sum()
            for view, reasons in matches.reasons.items()
        }
        print(
            f"copies, jitter {jitter_px:4g} px: {on_it.sum()} sure tracks; refused {equal}",
            flush=True,
        )


def cases(only: str, seeds: range) -> Iterator[tuple[str, Iterator[Case]]]:
    for source, build, kinds in (("made", made, MADE), ("pictures", pictured, PLANE)):
        for kind, rig_name, exposure in product(kinds, RIGS, EXPOSURES):
            name = f"{source} {kind}, {rig_name}, {exposure}"
            if re.search(only, name):
                yield name, (build(kind, rig_name, exposure, seed) for seed in seeds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--only", default="", help="sets whose name matches this expression")
    parser.add_argument("--copies", action="store_true", help="nearly equal segments alone")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    if options.copies:
        for seed in seeds:
            copies(seed)
        return
    every: dict[str, list[Row]] = {}
    for name, sets in cases(options.only, seeds):
        rows = [measure(case) for case in sets]
        report(name, rows)
        for group in (name.split(" ")[0], "all"):
            every.setdefault(group, []).extend(rows)
    for group, rows in every.items():
        report(group, rows)


if __name__ == "__main__":
    main()
