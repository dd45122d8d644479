"""What each kind of body gives to matched lines: recall and precision with and without it.

    python benchmarks/bodies.py FOLDER ...

FOLDER holds scenes of blocks that benchmarks/render_pictures.py rendered, a folder each; a third
of their bodies are cylinders. Recall is of the edges that two pictures show, precision of the
length put out within 1 mm of an edge. Lines whose mark of a silhouette is above .5 are not put
out; pieces of rims count as edges of the cylinders.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from matching_rendered import GREY_STEP, TOLERANCE_MM, _place, _samples
from shared_scenes import VIEWS

import trinoc
from trinoc.evaluation.scoring import score_lengths
from trinoc.io.rig_json import load_rig
from trinoc.match import improve
from trinoc.match.tracks.matches import Matches

WAYS = {
    "matched": (),
    "cylinders": ("cylinders",),
    "rims": ("rims",),
    "cylinders rims": ("cylinders", "rims"),
}


def put_out(matches: Matches) -> Matches:
    """Without what is likely an outline."""
    return matches.take(matches.marks.get("silhouette", np.zeros(len(matches))) <= 0.5)


def figures(folder: Path, steps: tuple, *, arcs: bool) -> tuple[float, float, float]:
    """(recall, precision, seconds of processor time of the steps) of one scene."""
    place = _place(folder, load_rig(folder / "rig.json"))
    segments = {view: trinoc.find_segments(place.pictures[view], arcs=arcs) for view in VIEWS}
    matches, began = trinoc.match_segments(segments, place.rig), time.process_time()
    matches, *_ = improve(
        matches,
        segments,
        place.rig,
        steps,
        pictures=place.pictures,
        arcs=lambda: {v: trinoc.find_segments(place.pictures[v], arcs=True) for v in VIEWS},
    )
    seconds, kept = time.process_time() - began, put_out(matches)
    samples = _samples(place, kept)
    precision = samples.length_mm[samples.right].sum() / samples.length_mm.sum()
    score = score_lengths(
        kept.lines_mm, place.truth, tolerance_mm=TOLERANCE_MM, grey_step=GREY_STEP
    )
    return score.recall, float(precision), seconds


def main() -> None:
    """Print a line for each way, and the change from the line above all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+")
    given = parser.parse_args()
    trinoc.io.enable_compile_cache()
    scenes = [path.parent for f in given.folders for path in sorted(f.glob("*/truth.json"))]
    for arcs in (False, True):
        first = None
        for name, steps in WAYS.items():
            found = np.mean([figures(scene, steps, arcs=arcs) for scene in scenes], axis=0)
            first = found if first is None else first
            recall, precision, seconds = found
            change = found - first
            print(
                f"{len(scenes)} scenes, {'chords kept' if arcs else 'plain':11s} {name:15s} "
                f"recall {recall:.3f} ({change[0]:+.3f})  precision {precision:.3f} "
                f"({change[1]:+.3f})  {seconds:.2f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
