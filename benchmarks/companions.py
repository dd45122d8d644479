"""What parallel partners and curves add to pairs of two views: with and without them.

    python benchmarks/companions.py [--seeds N]

Bars are long thin boxes of which every edge is seen, curves are chains of eight short pieces. Seeds
are such that nothing was tuned on. The log score is that of all tracks put out, against .05 for
what is not; differences are those of the same scene, with the standard error of their mean.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from match_scores import score_matches
from matching_truth import _outcomes

from simulation import Detector, block_scene, loose_segments, simulate_segments
from simulation.scenes import Scene, see_through_boxes
from simulation.solids import box
from trinoc.match import MatchTuning
from trinoc.match.matcher import match_segments
from trinoc.synth import table1_rig

SEED, UNSAID = 60_000, 0.05
VIEWS = "left", "right"


def bars(seed: int, count: int = 45) -> Scene:
    """Bars of 30 to 70 mm, 1.5 to 5 mm thick, lying at any height and any way."""
    generator, edges = np.random.default_rng(seed), []
    for _ in range(count):
        length, (width, height) = generator.uniform(30, 70), generator.uniform(1.5, 5, 2)
        turn = float(generator.uniform(0, 180))
        shift = np.append(generator.uniform(-75, 75, 2), generator.uniform(0, 45))
        solid = box((float(length), float(width), float(height)))
        edges.append(solid.place(turn_deg=turn, shift_mm=shift).edges_mm)
    return Scene.of_edges(np.concatenate(edges))


def curves(seed: int, count: int = 60, pieces: int = 8) -> Scene:
    """Chains of pieces of 6 to 16 mm that turn by 3 to 25 degrees from one to the next."""
    generator, edges = np.random.default_rng(seed), []
    for _ in range(count):
        place = np.append(generator.uniform(-75, 75, 2), generator.uniform(0, 50))
        way, toward = generator.normal(size=(2, 3)) * [[1, 1, 0.4], [1, 1, 1]]
        way, turn = way / np.linalg.norm(way), np.radians(generator.uniform(3, 25))
        for length in generator.uniform(6, 16, pieces):
            edges.append([place, place + length * way])
            place = place + length * way
            across = toward - (toward @ way) * way
            way = np.cos(turn) * way + np.sin(turn) * across / np.linalg.norm(across)
    return Scene.of_edges(np.array(edges))


def scenes(seeds: int) -> Iterator[tuple[str, list[tuple[int, Scene]]]]:
    every = range(SEED, SEED + seeds)
    yield "bars", [(seed, bars(seed)) for seed in every]
    yield "curves", [(seed, curves(seed)) for seed in every]
    yield "blocks on a table", [(seed, block_scene(seed, count=8)) for seed in every]
    yield "see-through boxes", [(seed, see_through_boxes(seed, count=42)) for seed in every]
    yield "loose segments", [(seed, loose_segments(seed, count=500)) for seed in every]


def figures(seed: int, scene: Scene, most: float) -> np.ndarray:
    """Precision and recall of pairs, log score, calibration error."""
    rig = table1_rig()
    segments, truth = simulate_segments(scene, rig, Detector(), seed=seed)
    usual = MatchTuning()
    tuning = replace(usual, occlusion=replace(usual.occlusion, most_companion=most))
    matches = match_segments({name: segments[name] for name in VIEWS}, rig, tuning=tuning)
    pairs = score_matches(matches, truth).pairs
    stated, right = np.array(_outcomes(matches, truth), dtype=float).T
    stated = np.clip(stated, 1e-4, 1 - 1e-4)
    gained = np.where(right, np.log(stated / UNSAID), np.log((1 - stated) / (1 - UNSAID)))
    place = np.clip((10 * stated).astype(int), 0, 9)
    error = sum(abs((stated - right)[place == k].sum()) for k in range(10)) / len(stated)
    return np.array([pairs.precision, pairs.recall, gained.sum(), error])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    given = parser.parse_args()
    for kind, drawn in scenes(given.seeds):
        without, found = (
            np.array([figures(seed, scene, most) for seed, scene in drawn]) for most in (0.0, 4.0)
        )
        change = found - without
        spread = change.std(axis=0, ddof=1) / np.sqrt(len(drawn))
        print(
            f"{kind:18s}"
            + " {:.3f}/{:.3f}, error {:.3f}".format(*without.mean(axis=0)[[0, 1, 3]])
            + " to {:.3f}/{:.3f}, {:.3f};".format(*found.mean(axis=0)[[0, 1, 3]])
            + f" precision {change.mean(axis=0)[0]:+.3f} +- {spread[0]:.3f},"
            + f" recall {change.mean(axis=0)[1]:+.3f} +- {spread[1]:.3f},"
            + f" log score {change.mean(axis=0)[2]:+.1f} +- {spread[2]:.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
