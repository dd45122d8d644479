"""How many mixed-up sets of segments are caught, and how many right ones are accused.

    python benchmarks/mixed_sets.py [--seeds 4] [--first 21]

Made scenes of three kinds, right and mixed up in ten ways. Rows: how a set was made; how many of
its sets are SUSPECT; how many of these name the cause; tracks with a posterior above .9, which are
wrong in a mixed set; processor time of a set over that without decoys (their cost).
"""

import argparse
import time

import numpy as np

from trinoc import Segments, match_segments
from trinoc.match.tracks.matches import MatchStatus
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.tables import with_field
from trinoc.synth import Detector, block_scene, loose_segments, simulate_segments, table1_rig
from trinoc.synth.scenes import see_through_boxes

VIEWS = ("upper", "left", "right")
SIZE = np.array([512.0, 480.0])
KINDS = {
    "boxes": lambda seed: see_through_boxes(seed, count=20),
    "loose": lambda seed: loose_segments(seed, count=240),
    "blocks": lambda seed: block_scene(seed, count=8),
}
ALONE = with_field(DEFAULT, "decoys.clear_share", 0.0)


def segments_of_scene(kind: str, seed: int) -> dict[str, Segments]:
    scene = KINDS[kind](seed)
    return dict(simulate_segments(scene, table1_rig(), Detector(shortest_px=8.0), seed=seed)[0])


def change(segments: Segments, matrix: np.ndarray, shift_px: np.ndarray) -> Segments:
    """The segments elsewhere, those that are still in the picture."""
    ends = np.asarray(segments.endpoints_px) @ matrix.T + shift_px
    inside = ((ends > -0.5) & (ends < SIZE - 0.5)).all(axis=(1, 2))
    return Segments.from_endpoints(ends[inside])


def mix(kind: str, how: str, seed: int) -> dict[str, Segments]:
    """A set of one scene, wrong as `how` says in one view or two of them."""
    found = segments_of_scene(kind, seed)
    first, second = (VIEWS[k] for k in np.random.default_rng(seed).choice(3, 2, replace=False))
    one = np.eye(2)
    changes = {
        "one shifted by (37, 23)": (one, np.array([37.0, 23.0])),
        "one shifted by (6, 4)": (one, np.array([6.0, 4.0])),
        "one upside down": (-one, SIZE - 1),
        "one mirrored": (np.diag([-1.0, 1.0]), (SIZE - 1) * [1, 0]),
        "one of half size": (one / 2, np.zeros(2)),
    }
    if how in changes:
        found[first] = change(found[first], *changes[how])
    elif how == "all of half size":
        found = {view: change(own, one / 2, np.zeros(2)) for view, own in found.items()}
    elif how == "two exchanged":
        found[first], found[second] = found[second], found[first]
    elif how == "three exchanged":
        found = {view: found[VIEWS[(k + 1) % 3]] for k, view in enumerate(VIEWS)}
    elif how == "one of another scene":
        found[first] = segments_of_scene(kind, seed + 1000)[first]
    elif how == "three scenes":
        for k, view in enumerate((first, second)):
            found[view] = segments_of_scene(kind, seed + 1000 * (k + 1))[view]
    return found


HOW = (
    *("right", "two exchanged", "three exchanged", "all of half size", "one of half size"),
    *("one of another scene", "three scenes", "one shifted by (37, 23)", "one shifted by (6, 4)"),
    *("one upside down", "one mirrored"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=21)
    options = parser.parse_args()
    print(f"{'set':26} {'suspect':>9} {'cause named':>12} {'sure tracks':>12} {'times':>6}")
    for how in HOW:
        suspect, named, sure, taken, alone, sets = 0, 0, 0, 0.0, 0.0, 0
        for kind in KINDS:
            for seed in range(options.first, options.first + options.seeds):
                segments = mix(kind, how, seed)
                begin = time.process_time()
                plain = match_segments(segments, table1_rig(), tuning=ALONE)
                middle = time.process_time()
                matches = match_segments(segments, table1_rig())
                taken, alone = taken + time.process_time() - middle, alone + middle - begin
                assert len(plain) == len(matches)
                is_suspect = matches.status is MatchStatus.SUSPECT
                suspect, sets = suspect + is_suspect, sets + 1
                named += is_suspect and "Most likely" in matches.notes[0]
                sure += int((matches.posterior > 0.9).sum())
        print(
            f"{how:26} {suspect:5}/{sets:3} {named:12} {sure:12} {taken / alone:6.2f}", flush=True
        )


if __name__ == "__main__":
    main()
