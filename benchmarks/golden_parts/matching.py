"""Matches, and results from them: measured and straight lines, corners, frames, rims."""

import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from shared_scenes import VIEWS, load_scene

import trinoc
from golden_parts import records
from golden_parts.inputs import (
    blocks,
    calibrated_demo,
    demo_matches,
    demo_segments,
    five_view_rig,
)
from golden_parts.records import Values
from simulation import Detector, block_scene, loose_segments, simulate_segments
from simulation.scenes import see_through_boxes
from trinoc.io import demo_images, demo_truth
from trinoc.match import depth_map, match_many
from trinoc.segments import with_side_levels
from trinoc.synth import table1_rig

FILES = (
    *("table_clean", "table_0", "table_1", "random100_0", "boxes120_0", "random500_0"),
    *("boxes504_0", "boxes504_ej5", "boxes504_x4", "random500_x4", "random500_ej5"),
    "random2000_x4",
)


def matching() -> Values:
    """The demo's scene in two and three views, a made one in five; bare ends, noise, depths."""
    rig, segments = calibrated_demo().rig, demo_segments()
    yield from records.matches("three", demo_matches())
    two = {view: segments[view] for view in ("upper", "left")}
    yield from records.matches("two", trinoc.match_segments(two, rig))
    ends = {
        view: np.asarray(view_segments.endpoints_px).reshape(-1, 4)
        for view, view_segments in segments.items()
    }
    bare = trinoc.match_segments(ends, rig, sigma_px=0.7, depth_range_mm=(350.0, 600.0))
    yield from records.matches("bare", bare)
    five = five_view_rig()
    made, _ = simulate_segments(block_scene(900_004, count=6), five, Detector(), seed=5)
    yield from records.matches("five", trinoc.match_segments(made, five))
    yield "depth", depth_map(demo_matches(), rig, "upper")
    score = trinoc.evaluate(demo_matches(), demo_truth().edges_mm)
    yield "precision", score.precision
    yield "completeness", score.completeness
    yield "distance_mm", score.distance_mm


def made() -> Values:
    """Made scenes of fixed seeds, in three and two views and as a batch."""
    rig, frames = table1_rig(), {}
    for label, shape, detector in (
        ("table", block_scene(900_001, count=8), Detector()),
        ("boxes", see_through_boxes(900_002, count=12), Detector(cut_back_px=3.0)),
        ("loose", loose_segments(900_003, count=120), Detector()),
    ):
        frames[label], _ = simulate_segments(shape, rig, detector, seed=7)
        yield from records.matches(label, trinoc.match_segments(frames[label], rig))
        two = {view: frames[label][view] for view in ("upper", "left")}
        yield from records.matches(f"{label}.two", trinoc.match_segments(two, rig))
    batch = match_many(list(frames.values()), rig)
    for label, matches in zip(frames, batch.matches, strict=True):
        yield from records.matches(f"batch.{label}", matches)


def measured_lines() -> Values:
    """Lines of the demo measured in its pixels; the same pictures saturated, and as sRGB."""
    rig, segments, images = calibrated_demo().rig, demo_segments(), demo_images("scene")
    plain = demo_matches()
    bright = {view: _brighter(image) for view, image in images.items()}
    for label, pictures, options in (
        ("linear", images, {}),
        ("srgb", images, {"response": "srgb"}),
        ("saturated", bright, {}),
    ):
        matches = trinoc.match.measure_lines(plain, segments, rig, pictures, **options)
        yield from records.matches(label, matches)


def _brighter(image: np.ndarray) -> np.ndarray:
    return np.clip(1.5 * image.astype(float), 0, 255).astype(np.uint8)


def wire_frame() -> Values:
    """Straight lines, corners and wire frames of the demo and of a made table."""
    made, _ = blocks()
    for label, matches, rig in (
        ("demo", demo_matches(), calibrated_demo().rig),
        ("table", trinoc.match_segments(made, table1_rig()), table1_rig()),
    ):
        joined = trinoc.match.join_collinear(matches, rig)
        yield from records.fields(f"{label}.joined", joined, JOINED)
        yield from records.fields(f"{label}.corners", trinoc.match.snap_corners(joined), CORNERS)
        for flat in (True, False):
            frame = trinoc.match.wireframe(matches, rig, flat=flat)
            name = f"{label}.{'flat' if flat else 'free'}"
            yield from records.fields(name, frame, FRAME)
            yield f"{name}.let_go", _let_go(frame)
            yield f"{name}.faces", [str(np.asarray(face).tolist()) for face in frame.faces]


def _let_go(frame: trinoc.match.Wireframe) -> list[str]:
    rows = zip(frame.let_go.track, frame.let_go.reason, strict=True)
    return [f"{track} {reason}" for track, reason in rows]


JOINED = (
    *("lines_mm", "covariance_mm2", "chi_square", "degrees", "line_of_track", "place_mm"),
    *("px_per_mm", "posterior"),
)
CORNERS = (
    *("points_mm", "covariance_mm2", "chi_square", "degrees", "corner", "line", "end"),
    *("lines_mm", "lines_covariance_mm2"),
)
FRAME = (
    *("vertices_mm", "vertices_covariance_mm2", "lines_mm", "covariance_mm2", "corner"),
    *("vertex_chi_square", "vertex_degrees", "part", "joint_covariance_mm2", "edges", "posterior"),
    *("chi_square", "degrees", "edge_of_track", "planes", "planes_covariance"),
    *("face_chi_square", "face_degrees", "face_posterior"),
)


def rims() -> Values:
    """Rims: of the demo's pictures, and of a made table."""
    rig, segments, images = calibrated_demo().rig, demo_segments(), demo_images("scene")
    chords = {view: trinoc.find_segments(image, arcs=True) for view, image in images.items()}
    rims = trinoc.match.find_rims(trinoc.match_segments(chords, rig), chords, rig)
    yield from _rims("demo.rims", rims)
    added = trinoc.match.add_rims(demo_matches(), segments, rims, chords, rig)
    yield from records.matches("demo.with rims", added.matches)
    yield "demo.with rims.kept", added.kept
    made, _ = blocks(9_002)
    matches = trinoc.match_segments(made, table1_rig())
    yield from _rims("table.rims", trinoc.match.find_rims(matches, made, table1_rig()))


def _rims(prefix: str, rims: trinoc.match.Rims) -> Values:
    names = ("centre_mm", "normal", "radius_mm", "radius_sigma_mm", "covariance_mm2", "covered")
    yield from records.fields(prefix, rims, (*names, "rim", "view", "segment", "kept", "counts"))
    yield from records.matches(f"{prefix}.matches", rims.matches)


def _data_folder() -> Iterator[Path]:
    """The folder that TRINOC_DATA names, if it names one."""
    folder = os.environ.get("TRINOC_DATA")
    if folder is None:
        print("TRINOC_DATA is not set: the shared scenes and photographs are left out.")
    else:
        yield Path(folder)


def shared() -> Values:
    """The shared scenes of TRINOC_DATA."""
    for folder in _data_folder():
        for name in FILES:
            rig, segments, _ = load_scene(folder / "scenes", name)
            yield from records.matches(name, trinoc.match_segments(segments, rig))


def photographs() -> Values:
    """Merton College as published, and with the grey levels beside the segments."""
    for folder in _data_folder():
        data = np.load(folder / "vgg_merton1" / "merton1.npz")
        matrices = dict(zip(VIEWS, data["projection"], strict=True))
        rig = trinoc.Rig.from_matrices(matrices, (1024, 768))
        ends = {view: data[f"segments_{k}"] for k, view in enumerate(VIEWS)}
        yield from records.matches("merton1", trinoc.match_segments(ends, rig))
        sided = {}
        for k, view in enumerate(VIEWS):
            image = cv2.imread(str(folder / "vgg_merton1" / f"view{k}.jpg"), cv2.IMREAD_GRAYSCALE)
            sided[view] = with_side_levels(trinoc.Segments.from_endpoints(ends[view]), image)
            if k == 0:
                yield from records.segments("merton1.found", trinoc.find_segments(image))
        yield from records.matches("merton1.levels", trinoc.match_segments(sided, rig))
