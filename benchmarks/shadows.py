"""Tracks that are boundaries of shadows, the probability stated of each, and the lamp.

    python benchmarks/shadows.py FOLDER ...

FOLDER holds scenes of blocks that benchmarks/render_pictures.py rendered, a folder each; the demo
comes first. A track is a shadow where more than half of it lies on no edge and along the boundary
of a shadow in all of its views, right where more than half lies on an edge; others count with
neither. Precision is of length, over all that is put out, before and after tracks are dropped
whose probability of being a shadow is above .5.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from matching_rendered import TOLERANCE_MM, Place, _place, _project, _samples
from render_pictures import DEMO, DEMO_LIGHT, greys_and_light
from segment_truth import samples_on_shadow
from shared_scenes import VIEWS

import trinoc
from simulation import block_scene
from trinoc.evaluation.scoring import score_lengths
from trinoc.io.rig_json import load_rig
from trinoc.match.tracks.matches import Matches
from trinoc.synth import table1_rig

BINS = 10


def shares_of(place: Place, matches: Matches) -> tuple[np.ndarray, np.ndarray]:
    """(share of each track on an edge, share along shadows)."""
    samples = _samples(place, matches)
    count = np.bincount(samples.owner, minlength=len(matches))
    step = matches.lines_mm[:, 1] - matches.lines_mm[:, 0]
    within = np.arange(len(samples.owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5
    part = within / count[samples.owner]
    points = matches.lines_mm[samples.owner, 0] + part[:, None] * step[samples.owner]
    unit = (step / np.linalg.norm(step, axis=1, keepdims=True))[samples.owner]
    shadow = ~samples.right & (place.shadows is not None)
    for column, view in enumerate(matches.views if place.shadows is not None else ()):
        here, there = (_project(place.rig[view].matrix_px, p) for p in (points, points + unit))
        along = (there - here) / np.linalg.norm(there - here, axis=1, keepdims=True)
        seen = matches.index[samples.owner, column] >= 0
        shadow &= ~seen | samples_on_shadow(here, along, (place.shadows or {})[view])
    return (
        np.bincount(samples.owner, samples.right, minlength=len(count)) / count,
        np.bincount(samples.owner, shadow, minlength=len(count)) / count,
    )


def lamp_mm(folder: Path) -> np.ndarray:
    """The lamp that a scene was rendered with."""
    if folder == DEMO:
        return np.array(DEMO_LIGHT.key_from_mm)
    seed = json.loads((folder / "truth.json").read_text())["seed"]
    generator = np.random.default_rng([seed, 1])
    return np.array(greys_and_light(block_scene(seed), generator)[2].key_from_mm)


def calibration_error(stated: np.ndarray, true: np.ndarray) -> float:
    """Mean of how far stated probabilities are from what is true, in ten bins."""
    bins = np.minimum((stated * BINS).astype(int), BINS - 1)
    error = np.bincount(bins, stated - true, minlength=BINS)
    return float(np.abs(error).sum() / len(stated))


def table_row(folders: list[Path]) -> str:
    """A line for one kind of scene."""
    stated, is_shadow, is_right, lamps, precision, recall, seconds = [], [], [], [], [], [], 0.0
    for folder in folders:
        rig = table1_rig() if folder == DEMO else load_rig(folder / "rig.json")
        place = _place(folder, rig)
        segments = {view: trinoc.find_segments(place.pictures[view]) for view in VIEWS}
        matches = trinoc.match_segments(segments, rig)
        start = time.process_time()
        found = trinoc.match.find_shadows(matches, segments, rig)
        seconds += time.process_time() - start
        right, shadow = shares_of(place, matches)
        stated.append(found.shadow)
        is_shadow.append((shadow > 0.5) & (shadow > right))
        is_right.append((right > 0.5) & (right > shadow))
        length = np.linalg.norm(matches.lines_mm[:, 1] - matches.lines_mm[:, 0], axis=1)
        kept = found.shadow <= 0.5
        precision.append(
            [(length * right)[rows].sum() / length[rows].sum() for rows in (kept | ~kept, kept)]
        )
        recall.append(
            [
                score_lengths(
                    matches.lines_mm[rows], place.truth, tolerance_mm=TOLERANCE_MM, grey_step=8.0
                ).recall
                for rows in (kept | ~kept, kept)
            ]
        )
        way = lamp_mm(folder) - found.middle_mm
        off = np.degrees(np.arccos(np.clip(found.toward_lamp @ way / np.linalg.norm(way), -1, 1)))
        lamps.append([found.lamp_posterior, off, found.lamp_sigma_deg])
        lamps[-1] += [found.nearness_per_mm * np.linalg.norm(way)]
    p, shadow, right = map(np.concatenate, (stated, is_shadow, is_right))
    told, lamp = shadow | right, np.array(lamps)
    known = lamp[:, 0] > 0.5
    before, after = np.mean(precision, axis=0)
    words = (
        f"{len(folders)} scenes; shadows marked {(p[shadow] > 0.5).sum()} of {shadow.sum()}, right "
        f"{(p[right] > 0.5).sum()} of {right.sum()}, others {(p[~told] > 0.5).sum()} of "
        f"{(~told).sum()}; share {shadow[told].mean():.3f}, stated {p[told].mean():.3f}, "
        f"calibration error {calibration_error(p[told], shadow[told]):.3f}; precision "
        f"{before:.3f} -> {after:.3f}, recall {np.mean(recall, axis=0).round(3).tolist()}; "
        f"worse in {sum(b > a + 1e-9 for b, a in precision)}; lamps known {known.sum()}"
    )
    if known.any():
        words += (
            f", off by {np.median(lamp[known, 1]):.2f} deg in the median, at most "
            f"{lamp[known, 1].max():.2f}, sigma {np.median(lamp[known, 2]):.2f}, true nearness "
            f"times {np.median(lamp[known, 3]):.2f}"
        )
    return f"{words}; {seconds / len(folders):.1f} s"


def main() -> None:
    """Print a line for each kind."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="*")
    given = parser.parse_args()
    trinoc.io.enable_compile_cache()
    print(f"demo: {table_row([DEMO])}", flush=True)
    for folder in given.folders:
        scenes = sorted(path.parent for path in folder.glob("*/truth.json"))
        print(f"{folder.name}: {table_row(scenes)}", flush=True)


if __name__ == "__main__":
    main()
