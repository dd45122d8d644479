"""Matched lines before and after they are measured in the pictures, against the true edges.

    python benchmarks/measured_lines.py FOLDER...

FOLDER holds scenes of `benchmarks/render_pictures.py blocks`. A line is of the straight edge from
which four fifths of it are less than 1 mm away. Of each: the median error across the line (root
mean square of both ends), the share of errors in the claimed 95 % ellipsoid (four degrees of
freedom), and processor time. Lines whose images cross rows and columns often are counted apart:
rendered pictures are sampled four times a pixel, which moves edges along rows and columns.
"""

import argparse
import time
from collections import Counter
from pathlib import Path

import numpy as np
from joined_lines import edges_of_lines
from matching_rendered import RenderedScene, load_rendered_scene
from scipy.stats import chi2

import trinoc
import trinoc.synth
from trinoc.io.rig_json import load_rig
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.vectors import complete_axes
from trinoc.synth import table1_rig

SAMPLES_PER_PX, OFTEN = 4, 10


def errors(matches: Matches, edge: np.ndarray, edges_mm: np.ndarray) -> np.ndarray:
    """(n, 2) error across and its chi-square, of the lines of an edge."""
    rows = []
    for track in np.flatnonzero(edge >= 0):
        first, second = edges_mm[edge[track]]
        axes = complete_axes((second - first) / np.linalg.norm(second - first))
        error = ((matches.lines_mm[track] - first) @ axes.T).reshape(4)
        turn = np.kron(np.eye(2), axes)
        spread = turn @ matches.covariance_mm2[track] @ turn.T
        rows.append((np.sqrt(error @ error / 2), error @ np.linalg.solve(spread, error)))
    return np.array(rows).reshape(-1, 2)


def crosses_often(matches: Matches) -> np.ndarray:
    """(t,) mask of the lines whose every image crosses many of the renderer's samples."""
    often = np.ones(len(matches), dtype=bool)
    for view in range(len(matches.views)):
        step = np.abs(np.diff(matches.fragments_px[:, view], axis=1)[:, 0]).min(axis=1)
        often &= (matches.index[:, view] < 0) | (SAMPLES_PER_PX * step > OFTEN)
    return often


def of_scenes(name: str, scenes: list[RenderedScene]) -> None:
    """Print the figures of all these scenes."""
    rows, kinds, measure_counts, seconds = [], [], Counter(), np.zeros(2)
    for number, scene in enumerate(scenes):
        for _ in range(1 if number else 2):  # the first run compiles
            start = time.process_time()
            segments = {view: trinoc.find_segments(p) for view, p in scene.pictures.items()}
            matches = trinoc.match_segments(segments, scene.rig)
            middle = time.process_time()
            after = trinoc.match.measure_lines(matches, segments, scene.rig, scene.pictures)
            spent = np.array([middle - start, time.process_time() - middle])
        seconds += spent
        straight = np.array(scene.truth.edge_kinds) == "edge"
        edges_mm = scene.truth.edges_mm[straight]
        edge = edges_of_lines(matches.lines_mm, edges_mm)
        has_edge = edge >= 0
        pair = [errors(tracks, edge, edges_mm) for tracks in (matches, after)]
        rows.append(np.concatenate(pair, axis=1))
        three = (matches.index >= 0).sum(axis=1) > 2
        kinds.append(np.stack([has_edge, three, ~three, crosses_often(matches)], axis=1)[has_edge])
        measure_counts += Counter(after.marks["measure"][matches.index >= 0].tolist())
    table, kind = np.concatenate(rows), np.concatenate(kinds)
    limit = chi2.ppf(0.95, 4)
    labels = "all lines", "three views", "two views", "not along rows or columns"
    for column, label in enumerate(labels):
        part = table[kind[:, column]]
        if len(part):
            before, now = np.median(part[:, 0]), np.median(part[:, 2])
            print(
                f"{name:12s} {label:26s} {len(part):4d} lines, across {before:.3f} to {now:.3f} mm "
                f"({now / before:.2f}), in 95 % {np.mean(part[:, 1] < limit):.3f} to "
                f"{np.mean(part[:, 3] < limit):.3f}",
                flush=True,
            )
    print(f"{name:12s} {dict(measure_counts)}; {seconds[0]:.2f} + {seconds[1]:.2f} s", flush=True)


def main() -> None:
    """Print the figures of the demo and of all folders."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="*", type=Path)
    options = parser.parse_args()
    trinoc.io.enable_compile_cache()
    demo = Path(trinoc.synth.__file__).parent / "demo"
    of_scenes("demo", [load_rendered_scene(demo, table1_rig())])
    for folder in options.folders:
        paths = [path for path in sorted(folder.iterdir()) if (path / "truth.json").exists()]
        scenes = [load_rendered_scene(path, load_rig(path / "rig.json")) for path in paths]
        of_scenes(folder.name, scenes)


if __name__ == "__main__":
    main()
