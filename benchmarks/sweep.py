"""Precision and recall of small made scenes for several values of one tuned constant.

    python benchmarks/sweep.py selection.damping 0.1 0.3 0.6 [--seeds 3] [--list]

Names are those of trinoc/match/tuning, and --list prints them with their values; a tuple is
written like (1.0,3.0,8.0). Scenes are drawn from seeds that nothing was tuned on: blocks on a
table, see-through boxes with cut ends, loose segments. Columns are precision/recall of triples and
of pairs, as in benchmarks/matching.py, whose rows are larger: judge by those. A kind of scene and
a value take some seconds, or ten where the kernels of step 1 compile for it.
"""

import argparse
import ast
from dataclasses import fields
from operator import attrgetter

import numpy as np
from match_scores import score_matches

from trinoc.match.matcher import match_segments
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.tables import with_field
from trinoc.synth import (
    Detector,
    block_scene,
    loose_segments,
    simulate_segments,
    table1_rig,
)
from trinoc.synth.scenes import see_through_boxes

FIRST_SEED = 130_000
KINDS = {
    "table": (lambda seed: block_scene(seed, count=8), Detector(shortest_px=8.0)),
    "boxes ej5": (
        lambda seed: see_through_boxes(seed, count=10),
        Detector(cut_back_px=5.0, shortest_px=3.0),
    ),
    "random": (lambda seed: loose_segments(seed, count=120), Detector(shortest_px=8.0)),
}


def figures(kind: str, seeds: int, tuning) -> str:
    """Mean precision/recall of triples, then of pairs."""
    scene_of, detector = KINDS[kind]
    rig, scores = table1_rig(), []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        segments, truth = simulate_segments(scene_of(seed), rig, detector, seed=seed)
        score = score_matches(match_segments(segments, rig, tuning=tuning), truth)
        scores.append([score.triples[:2], score.pairs[:2]])
    return " ".join(f"{p:.3f}/{r:.3f}" for p, r in np.mean(scores, axis=0))


def names() -> list[str]:
    groups = [(group.name, getattr(DEFAULT, group.name)) for group in fields(DEFAULT)]
    return [f"{name}.{field.name}" for name, group in groups for field in fields(group)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", nargs="?")
    parser.add_argument("values", nargs="*", type=ast.literal_eval)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--list", action="store_true")
    given = parser.parse_args()
    if given.list or given.name is None:
        for name in names():
            print(f"{name:40s} {attrgetter(name)(DEFAULT)}")
        return
    standing = attrgetter(given.name)(DEFAULT)
    print(f"{given.name:20s} " + " ".join(f"{kind:23s}" for kind in KINDS))
    for value in dict.fromkeys([standing, *given.values]):
        tuning = with_field(DEFAULT, given.name, type(standing)(value))
        row = " ".join(f"{figures(kind, given.seeds, tuning):23s}" for kind in KINDS)
        print(f"{value!s:20s} {row}{'  (standing)' if value == standing else ''}", flush=True)


if __name__ == "__main__":
    main()
