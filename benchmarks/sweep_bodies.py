"""Rows of benchmarks/sweep.py for what comes after triples: pairs, lines, wire frames, bodies.

Each group of trinoc/match/tuning/{occlusion,line_map,bodies}.py has rows of its own. Scenes are
matched once; what a number changes is done again for it, but for pairs, of which all is. Pictures
are the demo's and those of the folders given; scenes are chosen on, so judge by others.

occlusion  precision/recall of pairs and the log score of all tracks, of three views and of two
collinear  pairs of tracks rightly joined of all joined, found of all; error across, mm; share of
           lines in their 95 % region
corners    right of all; their error, mm; share in their 95 % region
wireframe  edges found (extra), corners found (extra), share in 95 % regions, true faces of all
cylinders  found, extra, error of the axis, mm, and normalised; tracks marked (wrongly)
rims       right of all; root mean square of their errors in sigmas; precision/recall of length
shadows    marked of all, right tracks marked, log score; precision of length; lamps, off by, deg
"""

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from companions import bars
from cylinders import Tally as CylinderTally, right_tracks
from joined_lines import (
    Tally as LineTally,
    edges_of_lines,
    edges_of_tracks,
    judge_corners,
    judge_lines,
)
from match_scores import score_matches
from matching_rendered import GREY_STEP, TOLERANCE_MM, Place, _place, _samples
from matching_truth import _outcomes
from scipy.stats import chi2
from shadows import lamp_mm, shares_of
from shared_scenes import VIEWS
from wireframe import Tally as WireframeTally, shape_of_segments

import trinoc
from simulation import Detector, block_scene, simulate_segments
from simulation.scenes import Scene, see_through_boxes
from simulation.solids import Cylinder, Polyhedron
from trinoc.evaluation.known_shape import KnownShape
from trinoc.evaluation.scoring import score_lengths
from trinoc.geometry.rig import Rig
from trinoc.io.demo import demo_folder
from trinoc.io.rig_json import load_rig
from trinoc.match import join_collinear, snap_corners
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.synth import table1_rig

FIRST_SEED = 131_000
UNSAID = 0.05
UP = np.array([0.0, 0.0, 1.0])
Figures = Callable[[MatchTuning], str]
SCENES: dict[str, tuple[Callable[[int], Scene], Detector]] = {
    "table": (lambda seed: block_scene(seed, count=8), Detector(shortest_px=8.0)),
    "boxes ej5": (
        lambda seed: see_through_boxes(seed, count=10),
        Detector(cut_back_px=5.0, shortest_px=3.0),
    ),
    "bars": (lambda seed: bars(seed, count=25), Detector()),
}


class Made(NamedTuple):
    """A made scene, matched."""

    rig: Rig
    segments: dict[str, Any]
    truth: Any
    solids: tuple
    matches: Matches


class Shown(NamedTuple):
    """A rendered scene, matched without and with the chords of arcs."""

    folder: Path
    place: Place
    segments: dict[str, Any]
    matches: Matches
    chords: dict[str, Any]
    matches_of_chords: Matches
    solids: tuple


@cache
def made(kind: str, seeds: int) -> list[Made]:
    scene_of, detector = SCENES[kind]
    rig, found = table1_rig(), []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        scene = scene_of(seed)
        segments, truth = simulate_segments(scene, rig, detector, seed=seed)
        matches = match_segments(segments, rig)
        found.append(Made(rig, segments, truth, getattr(scene, "solids", ()), matches))
    return found


@cache
def shown(folder: Path) -> list[Shown]:
    """The scenes of a folder; the folder itself where it is one scene."""
    if not (folder / "truth.json").exists():
        return [each for path in sorted(folder.glob("block_*")) for each in shown(path)]
    given = folder / "rig.json"
    place = _place(folder, load_rig(given) if given.exists() else table1_rig())
    plain, chords = (
        {view: trinoc.find_segments(place.pictures[view], arcs=arcs) for view in VIEWS}
        for arcs in (False, True)
    )
    number = folder.name.removeprefix("block_")
    solids = block_scene(int(number)).solids if number.isdecimal() else ()
    of_both = [match_segments(each, place.rig) for each in (plain, chords)]
    return [Shown(folder, place, plain, of_both[0], chords, of_both[1], solids)]


def log_score(stated: np.ndarray, right: np.ndarray) -> float:
    """Of all tracks put out, against UNSAID for what is not."""
    stated = np.clip(stated, 1e-4, 1 - 1e-4)
    gain = np.where(right, np.log(stated / UNSAID), np.log((1 - stated) / (1 - UNSAID)))
    return float(gain.sum())


def made_pairs(kind: str, views: tuple[str, ...], seeds: int) -> Figures:
    def figures(tuning: MatchTuning) -> str:
        found = []
        for each in made(kind, seeds):
            segments = {name: each.segments[name] for name in views}
            matches = match_segments(segments, each.rig, tuning=tuning)
            pairs = score_matches(matches, each.truth).pairs
            score = log_score(*np.array(_outcomes(matches, each.truth), dtype=float).T)
            found.append([pairs.precision, pairs.recall, score])
        return "{:.3f}/{:.3f} {:.1f}".format(*np.mean(found, axis=0))

    return figures


def lengths(place: Place, matches: Matches) -> tuple[float, float]:
    """(precision, lines along shadows neither way; recall) of length."""
    samples = _samples(place, matches)
    length = samples.length_mm
    recall = score_lengths(
        matches.lines_mm, place.truth, tolerance_mm=TOLERANCE_MM, grey_step=GREY_STEP
    ).recall
    return float(length[samples.right].sum() / length[~samples.shadow].sum()), recall


def shown_pairs(folder: Path, views: tuple[str, ...]) -> Figures:
    def figures(tuning: MatchTuning) -> str:
        found = []
        for each in shown(folder):
            segments = {name: each.segments[name] for name in views}
            matches = match_segments(segments, each.place.rig, tuning=tuning)
            right, shadow = shares_of(each.place, matches)
            scored = (right > 0.5) | (shadow <= 0.5)
            score = log_score(matches.posterior[scored], right[scored] > 0.5)
            found.append([*lengths(each.place, matches), score])
        return "{:.3f}/{:.3f} {:.1f}".format(*np.mean(found, axis=0))

    return figures


@cache
def edges_of_tracks_shown(folder: Path) -> np.ndarray:
    (each,) = shown(folder)
    edges = each.place.truth.edges_mm[np.array(each.place.truth.edge_kinds) == "edge"]
    return edges_of_lines(each.matches.lines_mm, edges)


def of_lines(scenes: Callable[[], list], corners: bool) -> Figures:
    def figures(tuning: MatchTuning) -> str:
        tally = LineTally()
        for each in scenes():
            rig, truth = (
                (each.rig, each.truth)
                if isinstance(each, Made)
                else (each.place.rig, each.place.truth)
            )
            joined = join_collinear(each.matches, rig, tuning=tuning)
            if isinstance(each, Made):
                edges, edge = truth.edges_mm, edges_of_tracks(each.matches, truth)
                of_line = np.array([np.max(edge[joined.tracks_of(k)]) for k in range(len(joined))])
            else:
                edges = truth.edges_mm[np.array(truth.edge_kinds) == "edge"]
                edge = edges_of_tracks_shown(each.folder)
                of_line = edges_of_lines(joined.lines_mm, edges) if corners else edge
            if corners:
                judge_corners(tally, joined, snap_corners(joined, tuning=tuning), of_line, edges)
            else:
                judge_lines(tally, each.matches, joined, edge, edges)
        n = tally.count
        if corners:
            inside = tally.share_below("point", float(chi2.ppf(0.95, 3)))
            right, every = n["corners right"], n["corners"] - n["corners not scored"]
            return f"{right}/{every} {tally.median('points'):.3f} {inside:.3f}"
        inside = tally.share_below("line", float(chi2.ppf(0.95, 4)))
        return (
            f"{n['right']}/{n['joined'] - n['not scored']} {n['found']}/{n['true']} "
            f"{tally.median('lines'):.3f} {inside:.3f}"
        )

    return figures


def of_frames(scenes: Callable[[], list]) -> Figures:
    def figures(tuning: MatchTuning) -> str:
        tally = WireframeTally()
        for each in scenes():
            boxes = tuple(solid for solid in each.solids if isinstance(solid, Polyhedron))
            if isinstance(each, Made):
                rig, shape = each.rig, shape_of_segments(each.truth)
            else:
                rig, shape = each.place.rig, KnownShape.of_scene(each.place.truth)
            tally.add(each.matches, rig, shape, boxes, tuning)
        n = tally.count
        inside = np.mean(np.array(tally.square) < chi2.ppf(0.95, 3))
        return (
            f"{n['edges_found']} ({n['edges_extra']}) {n['corners_found']} ({n['corners_extra']}) "
            f"{inside:.3f} {n['lines in'] / n['lines']:.3f} {n['true faces']}/{n['faces']}"
        )

    return figures


def of_cylinders(scenes: Callable[[], list]) -> Figures:
    def figures(tuning: MatchTuning) -> str:
        tally = CylinderTally()
        for each in scenes():
            if isinstance(each, Made):
                rig, edge = each.rig, edges_of_tracks(each.matches, each.truth)
                right = edge >= 0
            else:
                rig, right = each.place.rig, right_tracks(each.place, each.matches)
            found = trinoc.match.find_cylinders(each.matches, each.segments, rig, tuning=tuning)
            solids = tuple(solid for solid in each.solids if isinstance(solid, Cylinder))
            tally.add(found, rig, each.segments, solids, right, each.matches)
        n, error = tally.count, np.abs(np.array(tally.error_mm)).reshape(-1, 5)
        axis = np.median(np.hypot(error[:, 0], error[:, 1]))
        return (
            f"{n['found']}/{n['there']} +{n['extra']} {axis:.3f} "
            f"{np.sqrt(np.mean(np.array(tally.square) / 5)):.2f} {n['silhouettes marked']}/"
            f"{n['silhouettes']} ({n['right marked']})"
        )

    return figures


def of_rims(folder: Path) -> Figures:
    def figures(tuning: MatchTuning) -> str:
        right, put_out, square, scores = 0, 0, [], []
        for each in shown(folder):
            chords, rig = each.chords, each.place.rig
            rims = trinoc.match.find_rims(each.matches_of_chords, chords, rig, tuning=tuning)
            tops = np.array(
                [s.base_centre_mm + np.array([0, 0, s.height_mm]) for s in round_ones(each)]
            )
            error = rims.centre_mm[:, None] - tops.reshape(-1, 3)
            apart = np.linalg.norm(error, axis=2)
            good = apart.min(axis=1, initial=np.inf) < TOLERANCE_MM
            right, put_out = right + int(good.sum()), put_out + len(rims)
            for row in np.flatnonzero(good):
                own = error[row, apart[row].argmin()]
                square.append(own @ np.linalg.solve(rims.covariance_mm2[row, :3, :3], own) / 3)
            found = trinoc.match.add_rims(
                each.matches, each.segments, rims, chords, rig, tuning=tuning
            ).matches
            kept = found.take(np.flatnonzero(found.marks["silhouette"] < 0.5))
            scores.append(lengths(each.place, kept))
        spread = np.sqrt(np.mean(square)) if square else np.nan
        return f"{right}/{put_out} {spread:.2f} " + "{:.4f}/{:.4f}".format(*np.mean(scores, axis=0))

    return figures


def round_ones(each: Shown) -> list[Cylinder]:
    return [solid for solid in each.solids if isinstance(solid, Cylinder)]


@cache
def shares(folder: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    return [shares_of(each.place, each.matches) for each in shown(folder)]


def of_shadows(folder: Path) -> Figures:
    def figures(tuning: MatchTuning) -> str:
        n, stated, is_shadow, precision, off = np.zeros(4, int), [], [], [], []
        for each, (right, shadow) in zip(shown(folder), shares(folder), strict=True):
            given = each.matches, each.segments, each.place.rig
            found = trinoc.match.find_shadows(*given, tuning=tuning)
            marked, dark = found.shadow > 0.5, (shadow > 0.5) & (shadow > right)
            bright = (right > 0.5) & (right > shadow)
            n += [int(rows.sum()) for rows in (marked & dark, dark, marked & bright, bright)]
            stated.append(found.shadow[dark | bright])
            is_shadow.append(dark[dark | bright])
            step = each.matches.lines_mm[:, 1] - each.matches.lines_mm[:, 0]
            length = np.linalg.norm(step, axis=1) * ~marked
            precision.append((length * right).sum() / length.sum())
            way = lamp_mm(each.folder) - found.middle_mm
            cosine = found.toward_lamp @ way / np.linalg.norm(way)
            if found.lamp_known:
                off.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        score = log_score(np.concatenate(stated), np.concatenate(is_shadow))
        lamps = f"{len(off)} {np.median(off):.2f} {np.max(off):.2f}" if off else "0"
        return f"{n[0]}/{n[1]} {n[2]}/{n[3]} {score:.1f} {np.mean(precision):.4f} {lamps}"

    return figures


def rows_of_group(group: str, folders: list[Path], seeds: int) -> dict[str, Figures]:
    """What shows a group, by the name of the scenes; nothing for other groups."""
    every = [demo_folder(), *folders]
    return dict(_rows(group, every, seeds))


def _rows(group: str, folders: list[Path], seeds: int) -> Iterator[tuple[str, Figures]]:
    two = VIEWS[1:]
    if group == "occlusion":
        three = (("table", VIEWS), ("boxes ej5", VIEWS))
        for kind, views in (*three, ("table", two), ("boxes ej5", two), ("bars", two)):
            yield f"{kind}, {len(views)}", made_pairs(kind, views, seeds)
        for folder in folders:
            for views in (VIEWS, two):
                yield f"{folder.name}, {len(views)}", shown_pairs(folder, views)
    per_scene: dict[str, Callable[..., Figures]] = {
        "collinear": lambda scenes: of_lines(scenes, corners=False),
        "corners": lambda scenes: of_lines(scenes, corners=True),
        "wireframe": of_frames,
        "cylinders": of_cylinders,
    }
    if group in per_scene:
        kinds = ("table",) if group == "cylinders" else ("table", "boxes ej5")
        count = 4 * seeds if group == "cylinders" else seeds
        for kind in kinds:
            yield kind, per_scene[group](lambda kind=kind: made(kind, count))
        for folder in folders if group != "cylinders" else folders[1:]:
            yield folder.name, per_scene[group](lambda folder=folder: shown(folder))
    for name, figures in (("rims", of_rims), ("shadows", of_shadows)):
        if group == name:
            for folder in folders:
                yield folder.name, figures(folder)
