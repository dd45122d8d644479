"""Joined lines, corners and marks of viewpoint-dependent tracks, against the true edges.

    python benchmarks/joined_lines.py [--seeds N] [--rendered FOLDER]

Scenes are drawn by simulation from seeds that nothing was tuned on. FOLDER holds scenes of
blocks that benchmarks/render_pictures.py rendered, a folder each. There a line is of the edge
from which four fifths of it are less than 1 mm away. Pairs of tracks are rightly joined if both
are of one edge or of two that are collinear, and a corner is right if all of its lines are of
edges that have it in common; what is of no edge cannot be right.
"""

import argparse
import sys
import time
from collections import Counter
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from matching import VIEWS, fresh_problems
from scipy.spatial import KDTree
from scipy.stats import chi2

from simulation import loose_segments
from simulation.solids import Cylinder
from trinoc.evaluation.distances import distance_to_segments_mm
from trinoc.geometry.rig import Rig
from trinoc.io import load_scene_truth
from trinoc.io.rig_json import load_rig
from trinoc.match import Corners, join_collinear, snap_corners
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.vectors import complete_axes
from trinoc.segments import find_segments
from trinoc.synth import table1_rig
from trinoc.synth.truth import SegmentTruth

KINDS = ("table", "boxes", "boxes ej5", "boxes x4", "random", "random ej5")
SAME_LINE_MM, NEAR_MM, MOST = 0.1, 1.0, 0.8
NOBODY, NOT_SCORED = -1, -2
FIRST_OF_OUTLINES = 130_000


class Tally:
    """Counts and errors over several scenes."""

    def __init__(self) -> None:
        """Start with empty counts."""
        self.count: Counter[str] = Counter()
        self.values: dict[str, list[float]] = {}

    def add(self, name: str, *values: float) -> None:
        self.values.setdefault(name, []).extend(values)

    def median(self, name: str) -> float:
        return float(np.median(self.values.get(name, [np.nan])))

    def share_below(self, name: str, limit: float) -> float:
        return float(np.mean(np.array(self.values.get(name, [np.nan])) < limit))

    def text(self) -> str:
        n = self.count
        joined = n["joined"] - n["not scored"]
        return (
            f"joined {n['right']}/{joined} right, of {n['true']} found {n['found']}; "
            f"across {self.median('pieces'):.3f} to {self.median('lines'):.3f} mm, "
            f"in 95 % region {self.share_below('line', float(chi2.ppf(0.95, 4))):.2f}; corners "
            f"{n['corners right']}/{n['corners'] - n['corners not scored']} right, "
            f"{self.median('ends'):.3f} to {self.median('points'):.3f} mm, in 95 % region "
            f"{self.share_below('point', float(chi2.ppf(0.95, 3))):.2f}; lengths "
            f"{self.median('length before'):.3f} to {self.median('length after'):.3f} mm; "
            f"{1e3 * self.median('seconds'):.0f} ms; edges marked as moving "
            f"{n['marked in three']}/{n['in three']} in three views, "
            f"{n['marked in two']}/{n['in two']} in two"
        )


def edges_of_tracks(matches: Matches, truth: SegmentTruth) -> np.ndarray:
    """(t,) number of the edge that all segments of a track share; else NOBODY or NOT_SCORED."""
    edge = np.full(len(matches), NOBODY)
    for track, row in enumerate(matches.index):
        owners = {
            int(truth.edge_of[view][segment])
            for view, segment in zip(matches.views, row, strict=True)
            if segment >= 0
        }
        if NOT_SCORED in owners:
            edge[track] = NOT_SCORED
        elif len(owners) == 1:
            edge[track] = owners.pop()
    return edge


def judge_marks(tally: Tally, matches: Matches, edge: np.ndarray) -> None:
    """Count tracks of straight edges that are marked as moving with the viewpoint."""
    assert matches.viewpoint_dependent is not None
    in_three = (matches.index >= 0).sum(axis=1) > 2
    for name, rows in (("in three", in_three), ("in two", ~in_three)):
        tally.count[name] += int((rows & (edge >= 0)).sum())
        tally.count[f"marked {name}"] += int(
            (rows & (edge >= 0) & matches.viewpoint_dependent).sum()
        )


def outlines(radius_mm: float, sigma_px: float, seeds: int) -> str:
    """Count the joined outlines of standing cylinders, 30 mm high, among loose segments."""
    rig = table1_rig()
    total = triples = marked = 0
    for seed in range(FIRST_OF_OUTLINES, FIRST_OF_OUTLINES + seeds):
        generator = np.random.default_rng(seed)
        feet = np.pad(generator.uniform(-60, 60, (14, 2)), ((0, 0), (0, 1)))
        loose = loose_segments(seed, count=60).edges_mm
        segments = {}
        for name, camera in rig.items():
            lines = [
                Cylinder(foot, radius_mm, 30.0, 96).silhouette_mm(camera.centre_world_mm)
                for foot in feet
            ]
            image = np.concatenate([*lines, loose]) @ camera.matrix_px[:, :3].T
            image = image + camera.matrix_px[:, 3]
            ends = image[..., :2] / image[..., 2:]
            segments[name] = ends + sigma_px * generator.normal(size=ends.shape)
        matches = match_segments(segments, rig, sigma_px=sigma_px)
        assert matches.viewpoint_dependent is not None
        same_outline = (matches.index == matches.index[:, :1]).all(axis=1)
        same_outline &= matches.index[:, 0] < 2 * len(feet)
        total, triples = total + 2 * len(feet), triples + int(same_outline.sum())
        marked += int(matches.viewpoint_dependent[same_outline].sum())
    return f"{total} outlines, {triples} joined in three views, {marked} of them marked"


def edges_of_lines(lines_mm: np.ndarray, edges_mm: np.ndarray) -> np.ndarray:
    """(n,) number of the edge near which most of each line lies, or NOBODY."""
    edge_numbers = np.full(len(lines_mm), NOBODY)
    share = np.linspace(0, 1, 41)[:, None]
    for number, line in enumerate(lines_mm):
        points = line[0] + share * (line[1] - line[0])
        far = [np.quantile(distance_to_segments_mm(points, e[None]), MOST) for e in edges_mm]
        if min(far) < NEAR_MM:
            edge_numbers[number] = int(np.argmin(far))
    return edge_numbers


def off_line(points_mm: np.ndarray, edge: np.ndarray) -> np.ndarray:
    direction = edge[1] - edge[0]
    axes = complete_axes(direction / np.linalg.norm(direction))
    return np.linalg.norm((points_mm - edge[0]) @ axes.T, axis=-1)


def judge_lines(
    tally: Tally, matches: Matches, joined: JoinedLines, edge: np.ndarray, edges_mm: np.ndarray
) -> None:
    """Count joined pairs of tracks, and add the distances of lines from their edges."""
    of_edge = Counter(edge[edge >= 0].tolist())
    tally.count["true"] += sum(n * (n - 1) // 2 for n in of_edge.values())
    for line in np.flatnonzero(joined.pieces > 1):
        tracks = joined.tracks_of(line)
        for one, other in combinations(edge[tracks].tolist(), 2):
            tally.count["joined"] += 1
            if NOT_SCORED in (one, other):
                tally.count["not scored"] += 1
            elif one == other >= 0:
                tally.count["right"] += 1
                tally.count["found"] += 1
            elif min(one, other) >= 0:
                separation_mm = max(
                    off_line(edges_mm[other], edges_mm[one]).max(),
                    off_line(edges_mm[one], edges_mm[other]).max(),
                )
                tally.count["right"] += int(separation_mm < SAME_LINE_MM)
        number = edge[tracks[0]]
        if number < 0 or (edge[tracks] != number).any():
            continue
        true = edges_mm[number]
        tally.add("pieces", *(_rms(off_line(matches.lines_mm[t], true)) for t in tracks))
        tally.add("lines", _rms(off_line(joined.lines_mm[line], true)))
        direction = true[1] - true[0]
        axes = complete_axes(direction / np.linalg.norm(direction))
        error = ((joined.lines_mm[line] - true[0]) @ axes.T).reshape(4)
        project = np.kron(np.eye(2), axes)
        spread = project @ joined.covariance_mm2[line] @ project.T
        tally.add("line", error @ np.linalg.solve(spread, error))


def judge_corners(
    tally: Tally,
    joined: JoinedLines,
    corners: Corners,
    edge: np.ndarray,
    edges_mm: np.ndarray,
) -> None:
    """Count corners, and add their errors. `edge` is the edge number of each line."""
    ends = edges_mm.reshape(-1, 3)
    met = KDTree(ends).query_ball_point(ends, 1e-3)
    corner_of_end = np.array(
        [min(neighbours) if len(neighbours) > 1 else -1 for neighbours in met]
    ).reshape(-1, 2)
    for number in range(len(corners)):
        members = corners.corner == number
        owners = edge[corners.line[members]]
        tally.count["corners"] += 1
        if (owners == NOT_SCORED).any():
            tally.count["corners not scored"] += 1
            continue
        corner_sets = [set(corner_of_end[e].tolist()) - {-1} if e >= 0 else set() for e in owners]
        common = set.intersection(*corner_sets)
        if not common:
            continue
        tally.count["corners right"] += 1
        true = ends[common.pop()]
        error = corners.points_mm[number] - true
        tally.add("points", float(np.linalg.norm(error)))
        tally.add("point", error @ np.linalg.solve(corners.covariance_mm2[number], error))
        before = joined.lines_mm[corners.line[members], corners.end[members]] - true
        tally.add("ends", *np.linalg.norm(before, axis=1))
    bounded_lines = np.flatnonzero(np.bincount(corners.line, minlength=len(joined)) == 2)
    for line in bounded_lines[edge[bounded_lines] >= 0]:
        true = np.linalg.norm(np.diff(edges_mm[edge[line]], axis=0))
        for name, lines in (("before", joined.lines_mm), ("after", corners.lines_mm)):
            length = np.linalg.norm(np.diff(lines[line], axis=0))
            tally.add(f"length {name}", float(abs(length - true)))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def solved(tally: Tally, matches: Matches, rig: Rig) -> tuple[JoinedLines, Corners]:
    start = time.perf_counter()
    joined = join_collinear(matches, rig)
    corners = snap_corners(joined)
    tally.add("seconds", time.perf_counter() - start)
    return joined, corners


def fresh(kind: str, seeds: int) -> str:
    tally = Tally()
    for _, rig, segments, truth in fresh_problems(kind, seeds):
        matches = match_segments(segments, rig)
        joined, corners = solved(tally, matches, rig)
        edge = edges_of_tracks(matches, truth)
        judge_marks(tally, matches, edge)
        judge_lines(tally, matches, joined, edge, truth.edges_mm)
        of_line = [Counter(edge[joined.tracks_of(k)].tolist()) for k in range(len(joined))]
        edge_of_line = np.array([count.most_common(1)[0][0] for count in of_line])
        judge_corners(tally, joined, corners, edge_of_line, truth.edges_mm)
    return tally.text()


def rendered(folder: Path) -> str:
    tally = Tally()
    for scene_folder in sorted(p.parent for p in folder.glob("*/truth.json")):
        rig, truth = (
            load_rig(scene_folder / "rig.json"),
            load_scene_truth(scene_folder / "truth.json"),
        )
        segments = {}
        for view in VIEWS:
            picture = cv2.imread(str(scene_folder / f"scene_{view}.png"), cv2.IMREAD_GRAYSCALE)
            if picture is None:
                sys.exit(f"{scene_folder} lacks the picture of {view}.")
            segments[view] = find_segments(picture)
        edges_mm = truth.edges_mm[np.array(truth.edge_kinds) == "edge"]
        matches = match_segments(segments, rig)
        joined, corners = solved(tally, matches, rig)
        edge = edges_of_lines(matches.lines_mm, edges_mm)
        judge_marks(tally, matches, edge)
        judge_lines(tally, matches, joined, edge, edges_mm)
        judge_corners(tally, joined, corners, edges_of_lines(joined.lines_mm, edges_mm), edges_mm)
    return tally.text()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--rendered", type=Path)
    options = parser.parse_args()
    for kind in KINDS:
        print(f"{kind}: {fresh(kind, options.seeds)}", flush=True)
    for sigma_px in (0.1, 0.5):
        for radius_mm in (1.0, 2.0, 3.0, 6.0, 12.0):
            what = outlines(radius_mm, sigma_px, options.seeds)
            print(f"cylinders of {radius_mm:g} mm, {sigma_px} px: {what}", flush=True)
    if options.rendered is not None:
        print(f"rendered: {rendered(options.rendered)}")


if __name__ == "__main__":
    main()
