"""Number of mixed-up sets of segments that are caught, and of right ones that are accused.

    python benchmarks/mixed_sets.py [--seeds 4] [--first 21] [--only "right|shifted"] [--data DIR]

Made scenes of three kinds, right in four ways and mixed up in thirteen; with DIR, photographs of
the VGG sets too. Rows: how a set was made; how many of its sets are SUSPECT; how many of these name
a cause; tracks with a posterior above .9; how many of those are wrong: of no one edge, or of a
view that is not as its camera took it; processor time of a set over that without any doubt.
"""

import argparse
import re
import time
from collections.abc import Iterator
from itertools import product, starmap
from pathlib import Path
from typing import NamedTuple

import numpy as np

from simulation import Detector, block_scene, loose_segments, simulate_segments
from simulation.scenes import see_through_boxes
from trinoc import Matches, Rig, Segments, match_segments
from trinoc.match.tracks.matches import MatchStatus
from trinoc.synth import table1_rig

VIEWS = ("upper", "left", "right")
SIZE = np.array([512.0, 480.0])
MADE = {
    "boxes": lambda seed, few: see_through_boxes(seed, count=3 if few else 20),
    "loose": lambda seed, few: loose_segments(seed, count=40 if few else 240),
    "blocks": lambda seed, few: block_scene(seed, count=3 if few else 8),
}
ONE = np.eye(2)
# Of a picture: the segments' ends times a matrix, and a shift.
CHANGES = {
    "one shifted by (37, 23)": (ONE, [37.0, 23.0]),
    "one shifted by (6, 4)": (ONE, [6.0, 4.0]),
    "one shifted by (-4, 3)": (ONE, [-4.0, 3.0]),
    "one shifted by (12, -3)": (ONE, [12.0, -3.0]),
    "one upside down": (-ONE, SIZE - 1),
    "one mirrored": (np.diag([-1.0, 1.0]), [SIZE[0] - 1, 0.0]),
    "one of half size": (ONE / 2, [-0.25, -0.25]),
    "one of twice the size": (ONE * 2, [0.5, 0.5]),
}
RIGHT = ("right", "right, few", "right, noise understated", "right, little overlap")
HOW = (
    *(*RIGHT, "two exchanged", "three exchanged", "all of half size"),
    *("one of another scene", "three scenes", *CHANGES),
)


class Made(NamedTuple):
    """Segments of a scene, their edge numbers, and the edges' middles (e, 3)."""

    segments: dict[str, Segments]
    edge: dict[str, np.ndarray]
    middle_mm: np.ndarray

    def take(self, view: str, rows: np.ndarray, ends: np.ndarray | None = None) -> None:
        """Keep some of a view's segments, and replace their ends if `ends` is given."""
        ends = np.asarray(self.segments[view].endpoints_px) if ends is None else ends
        self.segments[view] = Segments.from_endpoints(ends[rows])
        self.edge[view] = self.edge[view][rows]


class Case(NamedTuple):
    """A set, its rig, the stated sigma, and the views that were changed; `edge` is the edge
    number of each segment, None if unknown."""

    segments: dict[str, Segments]
    rig: Rig
    sigma_px: float | None
    edge: dict[str, np.ndarray] | None
    changed: tuple[str, ...]


def make_scene(kind: str, seed: int, *, few: bool = False) -> Made:
    scene = MADE[kind](seed, few)
    segments, truth = simulate_segments(scene, table1_rig(), Detector(shortest_px=8.0), seed=seed)
    edge = {view: np.asarray(truth.edge_of[view]) for view in VIEWS}
    return Made(dict(segments), edge, np.asarray(scene.edges_mm).mean(axis=1))


def mix(kind: str, how: str, seed: int) -> Case:
    """A set of segments of one scene; `how` names the views that are made wrong, if any."""
    made = make_scene(kind, seed, few=how == "right, few")
    first, second = (VIEWS[k] for k in np.random.default_rng(seed).choice(3, 2, replace=False))
    changed: tuple[str, ...] = ()
    if how == "right, little overlap":
        # Two views show seven edges in ten each, from either side.
        along = made.middle_mm[:, 0]
        low, high = np.quantile(along, [0.3, 0.7])
        for view, shown in ((first, along < high), (second, along > low)):
            edge = made.edge[view]
            made.take(view, np.where(edge >= 0, shown[np.maximum(edge, 0)], True))
    elif how in CHANGES or how == "all of half size":
        matrix, shift = CHANGES.get(how, CHANGES["one of half size"])
        changed = (first,) if how in CHANGES else VIEWS
        for view in changed:
            ends = np.asarray(made.segments[view].endpoints_px) @ matrix.T + shift
            inside = ((ends > -0.5) & (ends < SIZE - 0.5)).all(axis=(1, 2))
            made.take(view, inside, ends)
    elif how in ("two exchanged", "three exchanged"):
        changed = (first, second) if how == "two exchanged" else VIEWS
        before = Made(dict(made.segments), dict(made.edge), made.middle_mm)
        for view, other in zip(changed, changed[1:] + changed[:1], strict=True):
            made.segments[view], made.edge[view] = before.segments[other], before.edge[other]
    elif how in ("one of another scene", "three scenes"):
        changed = (first,) if how == "one of another scene" else (first, second)
        for number, view in enumerate(changed):
            other = make_scene(kind, seed + 1000 * (number + 1))
            made.segments[view], made.edge[view] = other.segments[view], other.edge[view]
    sigma_px = 0.25 if how == "right, noise understated" else None
    return Case(made.segments, table1_rig(), sigma_px, made.edge, changed)


def photographs(folder: Path) -> Iterator[Case]:
    """Unchanged sets of photographs: two of a building, and triples of views of a corridor."""
    corridor = [(0, 1, 2), (0, 3, 6), (2, 5, 8), (4, 7, 10), (0, 5, 10), (6, 8, 10), (1, 2, 9)]
    building = [("merton1", (0, 1, 2)), ("merton2", (0, 1, 2))]
    for name, views in (*building, *(("corridor", views) for views in corridor)):
        data = np.load(folder / f"vgg_{name}" / f"{name}.npz")
        size = (512, 512) if name == "corridor" else (1024, 768)
        matrices = {str(view): data["projection"][view] for view in views}
        segments = {view: data[f"segments_{view}"] for view in matrices}
        yield Case(segments, Rig.from_matrices(matrices, image_size_px=size), None, None, ())


def is_wrong(matches: Matches, case: Case) -> np.ndarray:
    """Mask of the wrong tracks; all False if the truth is unknown."""
    if case.edge is None:
        return np.zeros(len(matches), dtype=bool)
    is_member = matches.index >= 0
    edge = np.stack(
        [
            case.edge[view][np.maximum(segments, 0)]
            for view, segments in zip(VIEWS, matches.index.T)
        ],
        axis=1,
    )
    first_edge = edge[np.arange(len(edge)), is_member.argmax(axis=1)]
    differs = (edge != first_edge[:, None]) & is_member
    touched = is_member & np.isin(VIEWS, case.changed)
    return (first_edge < 0) | differs.any(axis=1) | touched.any(axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=21)
    parser.add_argument("--only", default="", help="rows whose name matches this expression")
    parser.add_argument("--data", type=Path, help="folder of vgg_merton1 and the others")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    cases: dict[str, Iterator[Case]] = {
        how: starmap(mix, product(MADE, (how,), seeds)) for how in HOW
    }
    if options.data:
        cases["right, photographs"] = photographs(options.data)
    print(f"{'set':26} {'suspect':>9} {'cause':>6} {'sure':>6} {'wrong':>6} {'times':>6}")
    for how in [how for how in cases if re.search(options.only, how)]:
        suspect, named, sure, wrong, taken, alone, sets = 0, 0, 0, 0, 0.0, 0.0, 0
        for case in cases[how]:
            inputs = case.segments, case.rig
            begin = time.process_time()
            match_segments(*inputs, sigma_px=case.sigma_px, verify="off")
            middle = time.process_time()
            matches = match_segments(*inputs, sigma_px=case.sigma_px)
            taken, alone = taken + time.process_time() - middle, alone + middle - begin
            is_suspect = matches.status is MatchStatus.SUSPECT
            suspect, sets = suspect + is_suspect, sets + 1
            named += is_suspect and "Most likely" in matches.notes[0]
            sure += int((matches.posterior > 0.9).sum())
            wrong += int(((matches.posterior > 0.9) & is_wrong(matches, case)).sum())
        print(
            f"{how:26} {suspect:5}/{sets:3} {named:6} {sure:6} {wrong:6} {taken / alone:6.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
