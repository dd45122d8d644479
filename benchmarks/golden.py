"""Golden comparison: every output of the package on fixed inputs, frozen and compared again.

    python benchmarks/golden.py freeze FILE.npz [--only NAME ...]
    python benchmarks/golden.py compare FILE.npz [--only NAME ...] [--tolerance 1e-12]

Freeze before a change that must not move a number, compare after it. The inputs are the demo's
pictures, made scenes and pictures of fixed seeds and, where the environment names them by
TRINOC_DATA=DIR, the shared scenes and the photographs of Merton College. A difference counts
relative to the largest entry of its array; names, statuses and NaN must be equal. Compare on the
machine that froze: another one rounds otherwise. Takes about two minutes. Exits 1 where
something differs.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from intrinsics import LENS, image_of, random_poses
from shared_scenes import VIEWS, load_scene

import trinoc
from trinoc.io import demo_images, demo_pattern, demo_truth
from trinoc.match import depth_map, join_collinear, match_many, snap_corners
from trinoc.segments import find_junctions, with_side_levels
from trinoc.synth import (
    Detector,
    block_scene,
    loose_segments,
    see_through_boxes,
    simulate_segments,
    table1_lens,
    table1_rig,
)

EXACT = trinoc.Systematics()
Values = Iterator[tuple[str, Any]]

FILES = (
    *("table_clean", "table_0", "table_1", "random100_0", "boxes120_0", "random500_0"),
    *("boxes504_0", "boxes504_ej5", "boxes504_x4", "random500_x4", "random500_ej5"),
    "random2000_x4",
)


def calibration() -> Values:
    """The demo's sheet: detection, both methods, four and six parameters, systematics."""
    pattern, images, lens = demo_pattern(), demo_images("sheet"), table1_lens()
    for view, image in images.items():
        found = trinoc.detect_pattern(image, pattern)
        yield f"{view}.circle_index", found.circle_index
        yield f"{view}.centres_px", found.centres_px
        yield f"{view}.covariance_px2", found.covariance_px2
        yield f"{view}.lines_px", found.lines_px
    terms = trinoc.Systematics(print_scale_sigma=(0.0005, 0.0005), flatness_mm=0.1)
    for label, options in {
        "image": {"systematics": EXACT},
        "circles": {"systematics": EXACT, "method": "circles"},
        "six": {"systematics": EXACT, "parameters": 6},
        "typical": {},
        "systematics": {"systematics": terms},
    }.items():
        result = trinoc.calibrate(images, pattern, lens, **options)
        yield f"{label}.values", result.values
        yield f"{label}.covariance", result.covariance
        yield f"{label}.parameters", np.array(result.parameters)
        yield f"{label}.summary", np.array(result.summary())
        yield f"{label}.matrices_px", result.rig.matrices_px
        if label == "image":
            yield "epipolar_sigma", trinoc.epipolar_sigma(result.rig, "upper", "left").sigma_px
            yield "point_covariance", trinoc.point_covariance(result.rig, np.array([5.0, 9, 3]))


def _segments(prefix: str, segments: trinoc.Segments) -> Values:
    for field in ("endpoints_px", "covariance_px2", "polarity", "contrast", "support"):
        yield f"{prefix}.{field}", getattr(segments, field)
    if segments.side_levels is not None:
        yield f"{prefix}.side_levels", segments.side_levels


def _matches(prefix: str, matches: trinoc.Matches) -> Values:
    for field in ("index", "fragments_px", "fragments_covariance_px2", "covariance_mm2", "stage"):
        yield f"{prefix}.{field}", getattr(matches, field)
    for field in ("lines_mm", "posterior", "rival_posterior", "misfit", "viewpoint_dependent"):
        yield f"{prefix}.{field}", getattr(matches, field)


def scene() -> Values:
    """The demo's scene: segments, junctions, matches, straight lines, corners, refinement."""
    images = demo_images("scene")
    sheets = demo_images("sheet")
    calibrated = trinoc.calibrate(sheets, demo_pattern(), table1_lens(), systematics=EXACT)
    segments = {view: trinoc.find_segments(image) for view, image in images.items()}
    for view, found in segments.items():
        yield from _segments(view, found)
        yield f"{view}.junctions", find_junctions(found).uv_px
    arcs = trinoc.find_segments(images["upper"], arcs=True, tolerance_px=1.0)
    yield from _segments("arcs", arcs)
    colour = np.stack([images["upper"], images["left"], images["right"]], axis=-1)
    yield from _segments("colour", trinoc.find_segments(colour))
    matches = trinoc.match_segments(segments, calibrated.rig)
    yield from _matches("matches", matches)
    joined = join_collinear(matches, calibrated.rig)
    yield "joined.lines_mm", joined.lines_mm
    yield "joined.covariance_mm2", joined.covariance_mm2
    snapped = snap_corners(joined)
    yield "snapped.lines_mm", snapped.lines_mm
    yield "snapped.covariance_mm2", snapped.lines_covariance_mm2
    yield "depth", depth_map(matches, calibrated.rig, "upper")
    score = trinoc.evaluate(matches, demo_truth().edges_mm)
    yield "precision", score.precision
    yield "completeness", score.completeness
    yield "distance_mm", np.array(score.distance_mm)
    refined = trinoc.refine(calibrated, matches)
    yield "refined.values", refined.values
    yield "refined.covariance", refined.covariance
    yield "refined.ends_mm", refined.lines.ends_mm
    yield "refined.log_posterior", np.array(refined.log_posterior)
    yield "refined.status", np.array(refined.status.name)


def made() -> Values:
    """Made scenes of fixed seeds: two and three views, a batch, a knocked camera."""
    kinds = {
        "table": (block_scene(900_001, count=8), Detector()),
        "boxes": (see_through_boxes(900_002, count=12), Detector(cut_back_px=3.0)),
        "loose": (loose_segments(900_003, count=120), Detector()),
    }
    rig = table1_rig()
    frames = []
    for label, (shape, detector) in kinds.items():
        segments, _ = simulate_segments(shape, rig, detector, seed=7)
        yield from _matches(label, trinoc.match_segments(segments, rig))
        two = {view: segments[view] for view in ("upper", "left")}
        yield from _matches(f"{label}.two", trinoc.match_segments(two, rig))
        frames.append(segments)
    for label, matches in zip(kinds, match_many(frames, rig).matches, strict=True):
        yield from _matches(f"batch.{label}", matches)
    knocked = dict(rig.items())
    camera = knocked["left"]
    knocked["left"] = trinoc.Camera.from_degrees(
        camera.intrinsics,
        pan_deg=camera.pan_deg + 0.1,
        tilt_deg=camera.tilt_deg - 0.05,
        swing_deg=camera.swing_deg,
        distance_mm=camera.distance_mm + 0.3,
    )
    segments, _ = simulate_segments(kinds["boxes"][0], rig, Detector(), seed=8)
    before = trinoc.Rig(knocked)
    refined = trinoc.refine(
        before, trinoc.match_segments(segments, before, sigma_px=1.0), moved=["left"]
    )
    yield "knocked.values", refined.values
    yield "knocked.covariance", refined.covariance
    yield "knocked.status", np.array(refined.status.name)


def lens() -> Values:
    """A lens from five made pictures of the sheet, and one camera from points off the plane."""
    images = [np.round(image_of(LENS, pose)) for pose in random_poses(5, 5)]
    images = [image.astype(np.uint8) for image in images]
    result = trinoc.calibrate_intrinsics(images, trinoc.Pattern.default())
    yield "values", result.values
    yield "covariance", result.covariance
    yield "summary", np.array(result.summary())
    generator = np.random.default_rng(3)
    points = generator.uniform(-80, 80, (60, 3))
    camera = table1_rig()["right"]
    image = points @ camera.matrix_px[:, :3].T + camera.matrix_px[:, 3]
    uv = image[:, :2] / image[:, 2:] + 0.1 * generator.standard_normal((60, 2))
    placed = trinoc.calibrate_points(points, uv, table1_lens())
    yield "points.covariance", placed.covariance
    yield "points.matrix_px", placed.camera.matrix_px


def _folder() -> Path | None:
    folder = os.environ.get("TRINOC_DATA")
    if folder is None:
        print("TRINOC_DATA is not set: the shared scenes and photographs are left out.")
    return None if folder is None else Path(folder)


def shared() -> Values:
    """The shared scenes of TRINOC_DATA."""
    folder = _folder()
    for name in FILES if folder else ():
        rig, segments, _ = load_scene(folder / "scenes", name)
        yield from _matches(name, trinoc.match_segments(segments, rig))


def photographs() -> Values:
    """Merton College as published, and with the grey levels beside the segments."""
    folder = _folder()
    if folder is None:
        return
    data = np.load(folder / "vgg_merton1" / "merton1.npz")
    matrices = dict(zip(VIEWS, data["projection"], strict=True))
    rig = trinoc.Rig.from_matrices(matrices, (1024, 768))
    ends = {view: data[f"segments_{k}"] for k, view in enumerate(VIEWS)}
    yield from _matches("merton1", trinoc.match_segments(ends, rig))
    sided = {}
    for k, view in enumerate(VIEWS):
        image = cv2.imread(str(folder / "vgg_merton1" / f"view{k}.jpg"), cv2.IMREAD_GRAYSCALE)
        sided[view] = with_side_levels(trinoc.Segments.from_endpoints(ends[view]), image)
        if k == 0:
            yield from _segments("merton1.found", trinoc.find_segments(image))
    yield from _matches("merton1.levels", trinoc.match_segments(sided, rig))


PARTS: dict[str, Callable[[], Values]] = {
    part.__name__: part for part in (calibration, scene, made, lens, shared, photographs)
}


def outputs(only: list[str]) -> dict[str, np.ndarray]:
    """Every output by name."""
    values = {}
    for name in only or PARTS:
        began = time.perf_counter()
        values |= {f"{name}.{key}": np.asarray(value) for key, value in PARTS[name]()}
        print(f"{name}: {time.perf_counter() - began:.1f} s", flush=True)
    return values


def difference(now: np.ndarray, before: np.ndarray) -> float:
    """Largest difference over the largest entry; infinity for another shape, word or NaN."""
    if now.shape != before.shape:
        return float("inf")
    if now.dtype.kind not in "fiub" or before.dtype.kind not in "fiub":
        return 0.0 if np.array_equal(now, before) else float("inf")
    now, before = now.astype(np.float64), before.astype(np.float64)
    known = np.isfinite(before)
    if not np.array_equal(now[~known], before[~known], equal_nan=True):
        return float("inf")
    if not known.any() or np.array_equal(now[known], before[known]):
        return 0.0
    largest = np.abs(before[known]).max()
    change = np.abs(now[known] - before[known]).max()
    return float(change / largest) if largest > 0 else float("inf")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("verb", choices=("freeze", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", nargs="*", default=[], choices=PARTS)
    parser.add_argument("--tolerance", type=float, default=1e-12)
    options = parser.parse_args()
    now = outputs(options.only)
    if options.verb == "freeze":
        np.savez_compressed(options.file, **now)
        print(f"{len(now)} outputs frozen in {options.file}")
        return 0
    with np.load(options.file) as file:
        frozen = {name: file[name] for name in file.files}
    if options.only:
        frozen = {k: v for k, v in frozen.items() if k.split(".")[0] in options.only}
    apart = {name: difference(now[name], frozen[name]) for name in now.keys() & frozen.keys()}
    missing = sorted(now.keys() ^ frozen.keys())
    worse = {name: value for name, value in sorted(apart.items()) if value > options.tolerance}
    for name, value in worse.items():
        print(f"{name:45s} {value:.3g}")
    for name in missing:
        print(f"{name:45s} only {'now' if name in now else 'before'}")
    equal = sum(value == 0 for value in apart.values())
    print(f"{len(apart)} outputs: {equal} bit for bit, {len(worse)} beyond {options.tolerance:g}")
    return 1 if worse or missing else 0


if __name__ == "__main__":
    sys.exit(main())
