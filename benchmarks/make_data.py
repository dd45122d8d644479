"""Make the scenes of segments that the benchmarks read, and list the other data sets.

    python benchmarks/make_data.py DIR [--only NAME ...]

Writes DIR/scenes/NAME.npz and NAME.gt.npz (see shared_scenes.py) with the rig of the paper's
Table 1, drawn by `simulation` from fixed seeds; a file that stands there is left as it is. Then
lists every other data set that a benchmark looks for under DIR, with the benchmark, and whether
it is there. Takes a few seconds. Afterwards set TRINOC_DATA=DIR.

The scenes are of the kinds and sizes that docs/measurements.md reports on, drawn from other
seeds: the figures of other matchers quoted there belong to the original files.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from shared_scenes import VIEWS

from simulation import Detector, block_scene, loose_segments, simulate_segments
from simulation.scenes import Scene, see_through_boxes
from trinoc.synth import table1_rig


class Recipe(NamedTuple):
    """A scene, the errors of its detector, and the subdivisions of a pixel along a side."""

    scene: Scene
    detector: Detector
    resolution: int = 1


class DataSet(NamedTuple):
    """A public data set: its folder under DIR, one of its files, description, and readers."""

    folder: str
    file: str
    content: str
    readers: str


CLEAN = Detector(0.1, 0.0, 0.0, 0.0)
CUT_BACK = Detector(cut_back_px=5.0, shortest_px=3.0)
FINE = Detector(shortest_px=32.0)

PUBLIC = (
    DataSet(
        "vgg_merton1",
        "merton1.npz",
        "Merton College 1 of the VGG multi-view sets (Oxford): merton1.npz with projection "
        "(3, 3, 4), segments_0 .. 2 (n, 4), line_matches (m, 3), points3d (p, 3), point_matches "
        "(p, 3), corners_0 .. 2 (c, 2); its photographs view0.jpg .. view2.jpg, 1024 x 768",
        "matching.py, segments.py, refine.py, golden.py",
    ),
    DataSet(
        "vgg_corridor",
        "corridor.npz",
        "the corridor of the same sets: corridor.npz with segments_0 .. 10 (n, 4) beside the "
        "above; its photographs view00.png .. view10.png, 512 x 512",
        "matching.py, mixed_sets.py, segments.py, sweep.py, tests/segments/test_accept.py",
    ),
    DataSet(
        "vgg_house",
        "house.npz",
        "the model house of the same sets: house.npz with segments_0 .. 9 (n, 4); its "
        "photographs view00.png .. view09.png, 768 x 576",
        "segments.py, sweep.py, tests/segments/test_accept.py",
    ),
    DataSet(
        "york_urban",
        "york.npz",
        "every fourth picture of the York Urban database: york.npz with segments_0 .. 25 (n, 4) "
        "that were marked by hand; its photographs view00.jpg .. view25.jpg, 640 x 480",
        "segments.py, sweep.py",
    ),
    DataSet(
        "vgg_merton2",
        "merton2.npz",
        "Merton College 2 of the same sets, merton2.npz as above; no photographs",
        "matching.py",
    ),
    DataSet(
        "circle_grids",
        "opencv_circles1.png",
        "photographs of circle grids: opencv_circlesN.png and opencv_acirclesN.png (samples of "
        "OpenCV), boofcv_image0000N.jpg (samples of BoofCV)",
        "tests/calib/detection/test_photographs.py",
    ),
    DataSet(
        "myptv_rig",
        "correspondences.npz",
        "three cameras and a dot target on three planes (example of MyPTV): correspondences.npz "
        "with rows u v X Y Z of each camera",
        "tests/calib/test_calibrate_points.py",
    ),
)


def recipes() -> dict[str, Recipe]:
    """Recipe of every scene, by name; the numbers in the names are seeds."""
    return {
        "table_clean": Recipe(block_scene(130_000, count=8), CLEAN),
        "table_0": Recipe(block_scene(130_000, count=8), Detector()),
        "table_1": Recipe(block_scene(130_001, count=8), Detector()),
        "random100_0": Recipe(loose_segments(130_002, count=100), Detector()),
        "random500_0": Recipe(loose_segments(130_003, count=500), Detector()),
        "random500_ej5": Recipe(loose_segments(130_003, count=500), CUT_BACK),
        "random500_x4": Recipe(loose_segments(130_003, count=500), FINE, 4),
        "random2000_x4": Recipe(loose_segments(130_004, count=2000), FINE, 4),
        "boxes120_0": Recipe(see_through_boxes(130_005, count=10), Detector()),
        "boxes504_0": Recipe(see_through_boxes(130_006, count=42), Detector()),
        "boxes504_ej5": Recipe(see_through_boxes(130_006, count=42), CUT_BACK),
        "boxes504_x4": Recipe(see_through_boxes(130_006, count=42), FINE, 4),
    }


def write_scene(folder: Path, name: str, recipe: Recipe) -> None:
    """Both files of one scene, as `shared_scenes.load_scene` reads them."""
    rig = table1_rig(resolution=recipe.resolution)
    segments, truth = simulate_segments(recipe.scene, rig, recipe.detector, seed=130_000)
    size = np.array(rig[VIEWS[0]].image_size_px, dtype=float)
    endpoints = {
        f"segs_{k}": segments[view].endpoints_px.reshape(-1, 4) for k, view in enumerate(VIEWS)
    }
    edge_of = {f"gid_{k}": truth.edge_of[view] for k, view in enumerate(VIEWS)}
    extent = {f"gt_{k}": truth.extent[view] for k, view in enumerate(VIEWS)}
    matrices = np.stack([rig[view].matrix_px for view in VIEWS])
    np.savez_compressed(
        folder / f"{name}.gt.npz", X=truth.edges_mm.reshape(-1, 6), **edge_of, **extent
    )
    np.savez_compressed(folder / f"{name}.npz", P=matrices, size=size, **endpoints)


def main() -> None:
    """Make the missing scenes, and list the data sets that exist or are missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--only", nargs="*", choices=list(recipes()), default=list(recipes()))
    options = parser.parse_args()
    scenes = options.folder / "scenes"
    scenes.mkdir(parents=True, exist_ok=True)
    for name, recipe in recipes().items():
        if name not in options.only:
            continue
        there = (scenes / f"{name}.npz").exists()
        if not there:
            write_scene(scenes, name, recipe)
        print(f"{'is there' if there else 'made':9s} scenes/{name}.npz")
    for data in PUBLIC:
        there = (options.folder / data.folder / data.file).exists()
        print(f"{'is there' if there else 'missing':9s} {data.folder}/: {data.content}")
        print(f"{'':9s} read by {data.readers}")


if __name__ == "__main__":
    main()
