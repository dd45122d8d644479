"""Cylinders by their outlines beside the true ones, and tracks that hold an outline.

    python benchmarks/cylinders.py [--seeds N] [--first SEED] [--rendered FOLDER ...]

Made scenes are tables with eight solids (`block_scene`), whose cylinders show their outlines;
FOLDER holds scenes of blocks that benchmarks/render_pictures.py rendered, a folder each. A
cylinder is wanted where segments of 8 px or more lie on four of its outlines or more (within
1.5 px), two of them in one view. It is found where its axis, abreast of the middle, and its radius
lie within 1 mm of a true one. Errors in units of their sigmas are root mean squares.
"""

import argparse
import json
import time
from collections import Counter
from pathlib import Path

import numpy as np
from matching_rendered import TOLERANCE_MM, Place, _place, _samples
from scipy.stats import chi2
from shared_scenes import VIEWS

import trinoc
from simulation import Detector, block_scene, simulate_segments
from simulation.solids import Cylinder
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.io.rig_json import load_rig
from trinoc.match import Cylinders, find_cylinders
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.vectors import complete_axes
from trinoc.synth import table1_rig

NEAR_PX, SHORTEST_PX = 1.5, 8.0
WIDE_MM = 5.0


class Tally:
    """Counts and errors of several scenes."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.count: Counter[str] = Counter()
        self.error_mm: list[np.ndarray] = []
        self.square: list[float] = []
        self.outcome: list[tuple[float, bool]] = []

    def add(
        self,
        found: Cylinders,
        rig: Rig,
        segments: dict[str, Segments],
        solids: tuple[Cylinder, ...],
        right: np.ndarray,
        matches: Matches,
    ) -> None:
        """One scene; `right` says which tracks are of an edge."""
        on = {name: outlines_of(solids, rig, name, segments[name]) for name in matches.views}
        wanted = np.array([_is_wanted(on, number) for number in range(len(solids))], dtype=bool)
        best = np.zeros(len(solids), dtype=bool)
        for row in range(len(found)):
            errors = [error_of(found, row, solid) for solid in solids]
            nearest = int(np.argmin([np.abs(e).max() for e, _ in errors])) if errors else -1
            good = nearest >= 0 and np.abs(errors[nearest][0]).max() < TOLERANCE_MM
            if nearest >= 0 and np.abs(errors[nearest][0]).max() < WIDE_MM:
                self.error_mm.append(errors[nearest][0])
                self.square.append(errors[nearest][1])
            self.count["again"] += bool(good and best[nearest])
            self.count["extra"] += not good
            if good:
                best[nearest] = True
            self.outcome.append((float(found.posterior[row]), good))
        self.count["wanted"] += int(wanted.sum())
        self.count["found"] += int(best.sum())
        self.count["found of wanted"] += int((best & wanted).sum())
        self.count["there"] += len(solids)
        silhouette = np.zeros(len(matches), dtype=bool)
        for view, name in enumerate(matches.views):
            held = matches.index[:, view]
            silhouette |= (held >= 0) & (on[name][np.maximum(held, 0)] >= 0)
        marked = found.silhouette > 0.5
        self.count["silhouettes"] += int((silhouette & ~right).sum())
        self.count["silhouettes marked"] += int((silhouette & ~right & marked).sum())
        self.count["right"] += int(right.sum())
        self.count["right marked"] += int((right & marked).sum())
        self.count["scenes"] += 1

    def text(self) -> str:
        """A line."""
        n, square = self.count, np.array(self.square)
        error = np.abs(np.array(self.error_mm)).reshape(-1, 5)
        outcome = np.array(self.outcome).reshape(-1, 2)
        return (
            f"found {n['found']} of {n['there']}, of wanted {n['found of wanted']} of "
            f"{n['wanted']}; extra {n['extra']}, again {n['again']}; posterior "
            f"{outcome[:, 0].mean():.3f}, right {outcome[:, 1].mean():.3f}; median error of the "
            f"axis {np.median(np.hypot(error[:, 0], error[:, 1])):.3f} mm, radius "
            f"{np.median(error[:, 4]):.3f} mm; normalised {np.sqrt(np.mean(square / 5)):.2f}, in "
            f"the 95 % region {np.mean(square < chi2.ppf(0.95, 5)):.2f} of {len(square)}; tracks "
            f"with an outline marked {n['silhouettes marked']} of {n['silhouettes']}, right ones "
            f"{n['right marked']} of {n['right']}; {1e3 * self.seconds / n['scenes']:.0f} ms"
        )

    seconds = 0.0


def error_of(found: Cylinders, row: int, solid: Cylinder) -> tuple[np.ndarray, float]:
    """(offset of the axis at its middle, mm, and its tilt times half its length, each in two
    directions, and of the radius; chi-square of all)."""
    first, second = found.axis_mm[row]
    length = float(np.linalg.norm(second - first))
    across = complete_axes((second - first) / length)
    up = np.array([0.0, 0.0, 1.0])
    at = []
    for end in (first, second):
        way = (second - first) / length
        # Where the true axis crosses the plane across this end.
        reach = ((end - solid.base_centre_mm) @ way) / (up @ way)
        at.append(across @ (end - solid.base_centre_mm - reach * up))
    middle, tilt = 0.5 * (at[0] + at[1]), 0.5 * (at[1] - at[0])
    error = np.concatenate([middle, tilt, [found.radius_mm[row] - solid.radius_mm]])
    zero = np.zeros_like(across)
    take = np.zeros((5, 7))
    take[:2, :6] = 0.5 * np.concatenate([across, across], axis=1)
    take[2:4, :6] = 0.5 * np.concatenate([zero - across, across], axis=1)
    take[4, 6] = 1.0
    return error, float(error @ np.linalg.solve(take @ found.covariance_mm2[row] @ take.T, error))


def outlines_of(
    solids: tuple[Cylinder, ...], rig: Rig, name: str, segments: Segments
) -> np.ndarray:
    """(n,) twice the number of the cylinder and which outline each segment lies on, or -1."""
    ends = np.asarray(segments.endpoints_px)
    on = np.full(len(ends), -1)
    camera = rig[name]
    for number, solid in enumerate(solids):
        for side, line in enumerate(solid.silhouette_mm(np.asarray(camera.centre_world_mm))):
            image = line @ camera.matrix_px[:, :3].T + camera.matrix_px[:, 3]
            first, second = image[:, :2] / image[:, 2:]
            length = np.linalg.norm(second - first)
            way = (second - first) / length
            off = ends - first
            across = np.abs(off[..., 1] * way[0] - off[..., 0] * way[1]).max(axis=1)
            along = off @ way
            inside = (along.mean(axis=1) > 0) & (along.mean(axis=1) < length)
            long = np.ptp(along, axis=1) >= SHORTEST_PX
            on[(across < NEAR_PX) & inside & long] = 2 * number + side
    return on


def _is_wanted(on: dict[str, np.ndarray], number: int) -> bool:
    shown = [len({0, 1} & set((each - 2 * number).tolist())) for each in on.values()]
    return sum(shown) >= 4 and max(shown) == 2


def made(first: int, seeds: int) -> Tally:
    """Tables with eight solids."""
    tally, rig = Tally(), table1_rig()
    for seed in range(first, first + seeds):
        scene = block_scene(seed, count=8)
        segments, truth = simulate_segments(scene, rig, Detector(), seed=seed)
        matches = trinoc.match_segments(segments, rig)
        members = [
            np.where(matches.index[:, v] >= 0, truth.edge_of[name][matches.index[:, v]], -9)
            for v, name in enumerate(matches.views)
        ]
        edge = np.max(members, axis=0)
        right = (edge >= 0) & np.all([(own == edge) | (own == -9) for own in members], axis=0)
        _add(tally, matches, segments, rig, scene.solids, right)
    return tally


def rendered(folder: Path) -> Tally:
    """Scenes of pictures."""
    tally = Tally()
    for path in sorted(path.parent for path in folder.glob("*/truth.json")):
        place = _place(path, load_rig(path / "rig.json"))
        segments = {view: trinoc.find_segments(place.pictures[view]) for view in VIEWS}
        matches = trinoc.match_segments(segments, place.rig)
        seed = json.loads((path / "truth.json").read_text())["seed"]
        right = right_tracks(place, matches)
        _add(tally, matches, segments, place.rig, block_scene(seed).solids, right)
    return tally


def right_tracks(place: Place, matches: Matches) -> np.ndarray:
    """Whether more than half of each line lies on an edge."""
    samples = _samples(place, matches)
    count = np.bincount(samples.owner, minlength=len(matches))
    return np.bincount(samples.owner, samples.right, minlength=len(matches)) > 0.5 * count


def _add(tally: Tally, matches, segments, rig, solids, right) -> None:
    start = time.process_time()
    found = find_cylinders(matches, segments, rig)
    tally.seconds += time.process_time() - start
    round_ones = tuple(solid for solid in solids if isinstance(solid, Cylinder))
    tally.add(found, rig, segments, round_ones, right, matches)


def main() -> None:
    """Print a line for each kind."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=9000)
    parser.add_argument("--rendered", type=Path, nargs="*", default=[])
    given = parser.parse_args()
    trinoc.io.enable_compile_cache()
    if given.seeds:
        print(
            f"made, seeds from {given.first}: {made(given.first, given.seeds).text()}", flush=True
        )
    for folder in given.rendered:
        print(f"rendered, {folder.name}: {rendered(folder).text()}", flush=True)


if __name__ == "__main__":
    main()
