"""Knocked rigs corrected by matched segments: recovered matches, errors, convergence range.

Made scenes (blocks on a table, see-through boxes, loose segments; ends with 0.5 px of noise, a
fifth broken, a fifth nobody's). Cameras are turned about any axis and shifted any way after the
sheet was seen; the segments are those of the knocked rig, matched with the old one. Seeds are not
those on which the refinement's constants were chosen (200 to 203).
"""

import time
from collections.abc import Iterator

import numpy as np
from match_scores import score_matches

from refine_parts.rigs import SIZES, TRUE_RIG, calibrated_rig, camera_error, knocked, relative_error
from simulation import Detector, block_scene, loose_segments, simulate_segments
from simulation.scenes import see_through_boxes
from trinoc.calib import RefineResult
from trinoc.calib.bundle.refinement import refine
from trinoc.calib.bundle.result import RefineStatus
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.matcher import match_segments
from trinoc.synth.truth import SegmentTruth

FIRST_SEED = 130_000
# As wide as the matcher finds anything at all in segments of 0.5 px.
TOLERANT_SIGMA_PX = 4.0
SCENES = {
    "blocks": lambda seed: block_scene(seed, count=8),
    "10 boxes": lambda seed: see_through_boxes(seed, count=10),
    "100 loose": lambda seed: loose_segments(seed, count=100),
}

Trial = tuple[Rig, Rig, dict[str, Segments], SegmentTruth, str]


def trials_of(make, size: tuple[float, float], count: int, every: bool) -> Iterator[Trial]:
    """(sheet's rig, true rig, segments, their true edges, name of a knocked camera)."""
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        random = np.random.default_rng(seed)
        name = TRUE_RIG.names[seed % 3]
        true = knocked(TRUE_RIG, TRUE_RIG.names if every else (name,), size, random)
        segments, truth = simulate_segments(make(seed), true, Detector(), seed=seed)
        yield calibrated_rig(random), true, segments, truth, name


def corrected(
    start_rig: Rig, segments: dict[str, Segments], name: str, every: bool, schedule: str
) -> RefineResult:
    """One refinement with matches of the start rig, or rematched from tolerant to strict."""

    def match(rig: Rig, sigma_px: float | None = None):
        return match_segments(segments, rig, sigma_px=sigma_px)

    rematches = {
        "once": None,
        "tolerant": [lambda rig: match(rig, TOLERANT_SIGMA_PX), match],
    }[schedule]
    # With every camera knocked nothing of the sheet's word is left: relative poses.
    start, moved = (Rig(dict(start_rig.items())), ()) if every else (start_rig, (name,))
    return refine(start, match(start), moved=moved, match_again=rematches)


def table(scenes: dict, trials: int, every: bool) -> None:
    who = "every camera" if every else "one camera"
    print(f"\n## {who} knocked: triples' precision/recall with the rig as it was, refined, true;")
    print("median error deg, mm before -> after; answers given: right, wrong; refused")
    for schedule in ("once", "tolerant"):
        for label, make in scenes.items():
            for size in SIZES:
                row(f"{schedule:8s} {label:9s}", make, size, trials, every, schedule)


def row(label: str, make, size, trials: int, every: bool, schedule: str) -> None:
    scores, before, after, outcomes, laps = [], [], [], [], []
    for start_rig, true, segments, truth, name in trials_of(make, size, trials, every):
        begin = time.perf_counter()
        answer = corrected(start_rig, segments, name, every, schedule)
        laps.append(time.perf_counter() - begin)
        rigs = start_rig, answer.rig, true
        triples = [score_matches(match_segments(segments, rig), truth).triples for rig in rigs]
        scores.append([(score.precision, score.recall) for score in triples])
        off = [
            relative_error(rig, true) if every else camera_error(rig, true, name)
            for rig in (start_rig, answer.rig)
        ]
        before.append(off[0])
        refused = answer.status in (RefineStatus.AMBIGUOUS, RefineStatus.NOT_CONVERGED)
        # Right is what finds the matches again that the true rig finds, all but a tenth.
        right = triples[1].recall > 0.9 * triples[2].recall
        outcomes.append("refused" if refused else "right" if right else "wrong")
        if not refused:
            after.append(off[1])
    means = np.mean(scores, axis=0)
    shown = " ".join(f"{p:.2f}/{r:.2f}" for p, r in means)
    start = np.median(before, axis=0)
    end = np.median(after, axis=0) if after else (np.nan, np.nan)
    counts = ", ".join(str(outcomes.count(word)) for word in ("right", "wrong", "refused"))
    errors = f"{start[0]:.2f}, {start[1]:4.2f} -> {end[0]:.3f}, {end[1]:5.2f}"
    size_text = f"{size[0]:4.2f} {size[1]:3.1f}"
    print(f"{label} {size_text}: {shown}; {errors}; {counts}; {np.median(laps):.1f} s", flush=True)


def run(trials: int) -> None:
    """Print the tables of one knocked camera and of all of them."""
    for every in (False, True):
        table(SCENES, trials, every)
