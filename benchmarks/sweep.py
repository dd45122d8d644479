"""Precision and recall of small scenes for several values of one tuned constant.

    python benchmarks/sweep.py selection.damping 0.1 0.3 0.6 [--seeds 3]
    python benchmarks/sweep.py segments.accept.soft_ratio 1.3 2.0
    python benchmarks/sweep.py calib.problem.gate 4.0 10.0
    python benchmarks/sweep.py --each 0.5 2 [--only segments.]
    python benchmarks/sweep.py --list

Names are those of trinoc/match/tuning, with `segments.` before them those of
trinoc/segments/tuning.py, with `calib.` those of trinoc/calib/tuning; --list prints them with
their values; a tuple is written like (1.0,3.0,8.0). --each takes every number in turn times each
factor, and prints what changes.

Scenes of the matcher are drawn from seeds that nothing was tuned on: blocks on a table, see-through
boxes with cut ends, loose segments. Columns are precision/recall of triples and of pairs, as in
benchmarks/matching.py, whose rows are larger: judge by those. A kind of scene and a value take some
seconds, or ten where the kernels of step 1 compile for it.

Segments are found in the three pictures of the demo: as they are, with noise of 6 grey levels
more, and in light 2.2 times as strong, where faces are saturated. Columns are recall/precision, the
error of the middle of segments across them in px, and the median-based variance of that error over
what is claimed, as in benchmarks/segments.py. With TRINOC_DATA a column for each set of photographs
follows: the share of published segments that are found, and segments a picture.

The sheet is calibrated from the three pictures of the demo, in a fresh process, in the same lights.
Columns are cameras that converged, the largest change of a parameter in its own sigmas against the
standing value, and the median ratio of the sigmas.
"""

import argparse
import ast
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from match_scores import score_matches
from segment_truth import (
    Photograph,
    Picture,
    photographs,
    pictures_of_scene,
    recall_of_published,
    score,
)

from simulation import Detector, block_scene, loose_segments, simulate_segments
from simulation.scenes import see_through_boxes
from trinoc.calib.tuning.every_group import TUNING as OF_CALIB
from trinoc.io.demo import demo_folder
from trinoc.match.matcher import match_segments
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.tables import with_field
from trinoc.segments.find import find_segments
from trinoc.segments.tuning import DEFAULT as OF_SEGMENTS
from trinoc.synth import table1_rig

FIRST_SEED = 130_000
PREFIX = "segments."
CALIB = "calib."
# Calibrates in every light with another value, which must stand before other modules are imported.
CALIBRATION = """
import json, sys
from trinoc.calib.tuning import every_group
from trinoc.numerics.tables import with_field
name, value, lights = json.loads(sys.argv[1])
value = tuple(value) if isinstance(value, list) else value
every_group.TUNING = with_field(every_group.TUNING, name, value)
import numpy as np
import trinoc
from trinoc.io import demo_images, demo_pattern, enable_compile_cache
from trinoc.synth import table1_lens
enable_compile_cache()
random, answers = np.random.default_rng(0), []
for gain, sigma in lights:
    images = {
        view: np.clip(np.rint(gain * grey + random.normal(0, sigma, grey.shape)), 0, 255)
        for view, grey in demo_images("sheet").items()
    }
    images = {view: grey.astype(np.uint8) for view, grey in images.items()}
    result = trinoc.calibrate(images, demo_pattern(), table1_lens(), throw=False)
    sigmas = [result.sigma(name) for name in result.parameters]
    values = dict(zip(result.parameters, zip(result.values.tolist(), sigmas)))
    answers.append([sum(each.name == "CONVERGED" for each in result.status.values()), values])
print(json.dumps(answers))
"""
OPTIONS: dict[str, Any] = {"": DEFAULT, PREFIX: OF_SEGMENTS, CALIB: OF_CALIB}
KINDS = {
    "table": (lambda seed: block_scene(seed, count=8), Detector(shortest_px=8.0)),
    "boxes ej5": (
        lambda seed: see_through_boxes(seed, count=10),
        Detector(cut_back_px=5.0, shortest_px=3.0),
    ),
    "random": (lambda seed: loose_segments(seed, count=120), Detector(shortest_px=8.0)),
}
# (gain, noise in grey levels) of the demo's pictures.
LIGHTS = {"demo": (1.0, 0.0), "demo, noise": (1.0, 6.0), "demo, bright": (2.2, 0.0)}


def match_figures(kind: str, seeds: int, tuning) -> str:
    """Mean precision/recall of triples, then of pairs."""
    scene_of, detector = KINDS[kind]
    rig, scores = table1_rig(), []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        segments, truth = simulate_segments(scene_of(seed), rig, detector, seed=seed)
        result = score_matches(match_segments(segments, rig, tuning=tuning), truth)
        scores.append([result.triples[:2], result.pairs[:2]])
    return " ".join(f"{p:.3f}/{r:.3f}" for p, r in np.mean(scores, axis=0))


@cache
def demo_pictures(light: str) -> list[Picture]:
    gain, sigma = LIGHTS[light]
    random = np.random.default_rng(0)
    pictures = []
    for picture in pictures_of_scene(demo_folder() / "truth.json", table1_rig()):
        levels = gain * picture.grey + random.normal(0.0, sigma, picture.grey.shape)
        edges = picture.edges.copy()
        edges[:, 4] *= gain
        grey = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        pictures.append(picture._replace(grey=grey, edges=edges))
    return pictures


def segment_figures(light: str, tuning) -> str:
    """Recall/precision, median error across, median-based variance of the normalised error."""
    scores, ratios = [], []
    for picture in demo_pictures(light):
        segments = find_segments(picture.grey, tuning=tuning)
        ends = np.asarray(segments.endpoints_px)
        scores.append(score(ends.reshape(-1, 4), picture))
        directions = ends[:, 1] - ends[:, 0]
        normal = (
            np.stack([-directions[:, 1], directions[:, 0]], axis=-1)
            / np.linalg.norm(directions, axis=1)[:, None]
        )
        half = np.concatenate([normal, normal], axis=1) / 2
        variance = np.einsum("ni,nij,nj->n", half, np.asarray(segments.covariance_px2), half)
        middle = scores[-1].ends_across.mean(axis=1)[scores[-1].alone]
        sigma = np.sqrt(variance[scores[-1].matched[scores[-1].alone]])
        ratios.append(np.stack([np.abs(middle), np.abs(middle) / sigma]))
    recall, precision = (
        sum(getattr(entry, part) for entry in scores)
        / sum(getattr(entry, total) for entry in scores)
        for part, total in (("found", "shown"), ("right", "put_out"))
    )
    error, ratio = np.median(np.concatenate(ratios, axis=1), axis=1)
    return f"{recall:.3f}/{precision:.3f} {error:.4f} {np.square(ratio / 0.6745):4.2f}"


@cache
def photographs_of_data() -> list[Photograph]:
    folder = os.environ.get("TRINOC_DATA", "")
    return list(photographs(Path(folder))) if folder else []


def photograph_figures(tuning) -> list[str]:
    """For each set: share of published segments that are found, and segments a picture."""
    rows: dict[str, list[tuple[np.ndarray, int]]] = {}
    for picture in photographs_of_data():
        lines = np.asarray(find_segments(picture.grey, tuning=tuning).endpoints_px).reshape(-1, 4)
        row = recall_of_published(picture, lines), len(lines)
        rows.setdefault(picture.name, []).append(row)
    return [
        f"{np.concatenate([is_found for is_found, _ in row]).mean():.3f}"
        f" {np.mean([count for _, count in row]):6.1f}"
        for row in rows.values()
    ]


@cache
def calibrations(name: str, value) -> list[tuple[int, dict[str, tuple[float, float]]]]:
    """For each light the cameras that converged, and value and sigma of every parameter."""
    request = json.dumps([name, value, list(LIGHTS.values())])
    command = [sys.executable, "-c", CALIBRATION, request]
    return json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


def calibration_figures(name: str, value) -> list[str]:
    """Cameras that converged, largest change in sigmas, median ratio of sigmas."""
    figures = []
    standing = calibrations(name, attrgetter(name)(OF_CALIB))
    try:
        swept = calibrations(name, value)
    except subprocess.CalledProcessError:
        # Such a value lets no sheet be found.
        return ["failed"] * len(standing)
    for (_, before), (converged, after) in zip(standing, swept, strict=True):
        both = np.array([(*before[key], *after[key]) for key in before.keys() & after.keys()])
        change = np.abs(both[:, 2] - both[:, 0]) / both[:, 1] if len(both) else [np.nan]
        ratio = np.median(both[:, 3] / both[:, 1]) if len(both) else np.nan
        figures.append(f"{converged} {np.max(change):.3f} {ratio:.3f}")
    return figures


def row_of_figures(name: str, value, seeds: int) -> list[str]:
    """Figures of one value; if the code fails with it, a row that reports this."""
    try:
        return _row_of_figures(name, value, seeds)
    except Exception as error:
        return [f"failed: {error}"]


def _row_of_figures(name: str, value, seeds: int) -> list[str]:
    if name.startswith(CALIB):
        return calibration_figures(name.removeprefix(CALIB), value)
    if name.startswith(PREFIX):
        tuning = with_field(OF_SEGMENTS, name.removeprefix(PREFIX), value)
        figures = [segment_figures(light, tuning) for light in LIGHTS]
        return [*figures, *photograph_figures(tuning)]
    tuning = with_field(DEFAULT, name, value)
    return [match_figures(kind, seeds, tuning) for kind in KINDS]


def standing_value(name: str) -> Any:
    prefix = next(prefix for prefix in (PREFIX, CALIB, "") if name.startswith(prefix))
    return attrgetter(name.removeprefix(prefix))(OPTIONS[prefix])


def names() -> Iterator[str]:
    for prefix, options in OPTIONS.items():
        for group in fields(options):
            for entry in fields(getattr(options, group.name)):
                yield f"{prefix}{group.name}.{entry.name}"


def scaled(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(scaled(entry, factor) for entry in value)
    return max(round(value * factor), 1) if isinstance(value, int) else value * factor


def sweep_each(only: str, factors: list[float], seeds: int) -> None:
    """Print a row for every number times every factor; "-" if nothing changes."""
    standing: dict[str, list[str]] = {}
    for name in names():
        value = standing_value(name)
        if not name.startswith(only) or isinstance(value, bool | str | None):
            continue
        room = next((prefix for prefix in (PREFIX, CALIB) if name.startswith(prefix)), "")
        room = room or name.partition(".")[0]
        if room not in standing:
            standing[room] = row_of_figures(name, value, seeds)
            print(f"{'(standing)':38s} {'':14s} " + " | ".join(standing[room]))
        for factor in factors:
            other = scaled(value, factor)
            row = row_of_figures(name, other, seeds)
            same = row == standing[room]
            shown = (" " if a == b else a for a, b in zip(row, standing[room], strict=False))
            print(f"{name:38s} {other!s:14.14s} {'-' if same else ' | '.join(shown)}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("name", nargs="?")
    parser.add_argument("values", nargs="*", type=ast.literal_eval)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--each", nargs="+", type=float, metavar="FACTOR")
    parser.add_argument("--only", default="", metavar="START")
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    if options.each:
        sweep_each(options.only, options.each, options.seeds)
        return
    if options.list or options.name is None:
        for name in names():
            print(f"{name:40s} {standing_value(name)}")
        return
    standing = standing_value(options.name)
    sets = dict.fromkeys(picture.name for picture in photographs_of_data())
    heads = [*LIGHTS, *sets] if options.name.startswith(PREFIX) else KINDS
    heads = LIGHTS if options.name.startswith(CALIB) else heads
    print(f"{options.name:20s} " + " ".join(f"{kind:25s}" for kind in heads))
    for value in dict.fromkeys([standing, *options.values]):
        row = row_of_figures(options.name, type(standing)(value), options.seeds)
        line = " ".join(f"{figure:25s}" for figure in row)
        print(f"{value!s:20s} {line}{'  (standing)' if value == standing else ''}", flush=True)


if __name__ == "__main__":
    main()
