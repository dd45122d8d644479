"""Effect of the rims of round bodies on matched lines of rendered pictures.

    python benchmarks/rims.py FOLDER ...

FOLDER holds scenes of blocks that benchmarks/render_pictures.py rendered, a folder each; a third
of their bodies are cylinders. Of each folder: precision of length at 1 mm (in brackets, lines along
shadows count neither way), recall of length (edges of 8 grey levels, rims included), recall of
straight edges that three views show and two, expected calibration error of the posteriors, and
processor time of a scene. With rims, tracks that these mark as outlines are not put out.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from matching import _calibration_error as calibration_error
from matching_rendered import RenderedScene, load_rendered_scene, score_scene

import trinoc
from trinoc.io.rig_json import load_rig
from trinoc.match import improve
from trinoc.match.tracks.matches import Matches

WAYS = {"matched": (), "with rims": ("rims",)}


def match_scene(scene: RenderedScene, steps: tuple) -> Matches:
    """The tracks of a scene after some steps, without what is likely an outline."""
    segments = {view: trinoc.find_segments(image) for view, image in scene.pictures.items()}
    matches, *_ = improve(
        trinoc.match_segments(segments, scene.rig),
        segments,
        scene.rig,
        steps,
        arcs=lambda: {
            view: trinoc.find_segments(image, arcs=True) for view, image in scene.pictures.items()
        },
    )
    return matches.take(matches.marks.get("silhouette", np.zeros(len(matches))) <= 0.5)


def row_of_scenes(scenes: list[RenderedScene], steps: tuple) -> str:
    """The figures of all these scenes."""
    scores, views, outcomes, seconds = [], np.zeros(4), [], 0.0
    for scene in scenes:
        for _ in range(1 if scores else 2):  # the first run compiles
            began = time.process_time()
            matches = match_scene(scene, steps)
            spent = time.process_time() - began
        seconds += spent
        score, by_views, outcome = score_scene(scene, matches)
        scores.append(score)
        views += by_views
        outcomes += outcome
    precision, without_shadows, recall = np.mean(scores, axis=0)
    error = calibration_error([(p, right) for p, right, _ in outcomes])
    return (
        f"precision {precision:.3f} ({without_shadows:.3f})  recall {recall:.3f}  "
        f"three views {views[0] / views[1]:.3f}  two {views[2] / max(views[3], 1e-9):.3f}  "
        f"calibration error {error:.3f}  {seconds / len(scenes):.2f} s"
    )


def main() -> None:
    """Print a line for each method."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+")
    options = parser.parse_args()
    trinoc.io.enable_compile_cache()
    for folder in options.folders:
        scenes = [path.parent for path in sorted(folder.glob("*/truth.json"))]
        rendered_scenes = [
            load_rendered_scene(scene, load_rig(scene / "rig.json")) for scene in scenes
        ]
        for name, steps in WAYS.items():
            print(f"{folder.name:10s} {len(rendered_scenes)} scenes  {name:10s} ", end="")
            print(row_of_scenes(rendered_scenes, steps), flush=True)


if __name__ == "__main__":
    main()
