"""A small valid file of every kind that is read, with its reader, for tests that damage it."""

import dataclasses
import importlib.util
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

import trinoc
from tests.io.formats.bench import bench_matches, bench_rig
from tests.io.formats.metashape import cameras_xml
from tests.io.made_rims import made_rims
from tests.io.made_wireframe import made_wireframe
from trinoc.calib import Detection
from trinoc.image.ideal_pictures import PictureMaps
from trinoc.io import (
    FORMATS,
    load_frames,
    load_intrinsics,
    load_scene_truth,
    load_shape,
    read_image,
)
from trinoc.io.frames_files import save_frames
from trinoc.io.rig_json import load_rig_status
from trinoc.recording.frame_table import FrameMatches, frames_of_table

RIG = bench_rig()


def made_detection() -> Detection:
    """Four discs of a plain grid, which looks the same turned."""
    covariance = np.tile(0.01 * np.eye(2), (4, 1, 1))
    return Detection(
        circle_index=np.arange(4),
        centres_px=np.array([[40.0, 40.0], [60.0, 40.0], [40.0, 60.0], [60.0, 60.0]]),
        covariance_px2=covariance,
        shape_px2=np.tile(25.0 * np.eye(2), (4, 1, 1)),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=(100, 80),
        ambiguity=np.array([[3, 2, 1, 0]]),
    )


class ValidFile(NamedTuple):
    """A file to damage, and what reads it (or the folder that it is a part of)."""

    path: Path
    load: Callable[[], Any]


def valid_files(folder: Path) -> dict[str, ValidFile]:
    """Write one valid file of every kind below a folder."""
    files: dict[str, ValidFile] = {}

    def add(kind: str, name: str, load: Callable[[Path], Any]) -> Path:
        path = folder / kind / name
        path.parent.mkdir(parents=True)
        files[kind] = ValidFile(path, lambda: load(path))
        return path

    trinoc.save(RIG, add("rig", "rig.json", trinoc.load_rig))
    trinoc.save(RIG, add("status", "rig.json", load_rig_status))
    trinoc.save(RIG["upper"].intrinsics, add("lens", "camera.json", load_intrinsics))
    pattern = trinoc.Pattern.cross_grid(rows=2, columns=2, pitch_mm=20.0, radius_mm=6.0)
    trinoc.save(pattern, add("pattern", "pattern.json", trinoc.load_pattern))
    matches = measured()
    trinoc.save(matches, add("matches", "matches.npz", trinoc.load_matches))
    trinoc.save(matches, add("any", "any.npz", trinoc.load))
    trinoc.save(made_wireframe(), add("wireframe", "wireframe.npz", trinoc.load))
    trinoc.save(made_rims(), add("rims", "rims.npz", trinoc.load))
    positions = np.linspace(-1, 5, 12, dtype=np.float32).reshape(3, 4)
    trinoc.save(PictureMaps(positions, 1 - positions, (5, 4)), add("maps", "maps.npz", trinoc.load))
    trinoc.save(made_detection(), add("detection", "detection.npz", trinoc.load))
    ends = np.random.default_rng(2).uniform(0, 400, (5, 4))
    segments = trinoc.Segments.from_endpoints(ends)
    trinoc.save(segments, add("segments", "segments.npz", trinoc.load_segments))
    np.savetxt(add("table", "segments.csv", trinoc.load_segments), ends, delimiter=",")
    np.save(add("array", "segments.npy", trinoc.load_segments), ends)
    results = [FrameMatches("1", "ok", matches), FrameMatches("2", "has no picture.", None)]
    save_frames(results, matches.views, add("frames", "matches-000000.npz", load_frames))
    if importlib.util.find_spec("pyarrow"):
        file = add("frames in parquet", "matches-000000.parquet", load_frames)
        save_frames(results, matches.views, file)
    listed = add("frame table", "frames.csv", _frame_table)
    listed.write_text("frame,upper,left\n1,a.png,b.png\n2,c/a.png,\n")
    add("shape", "shape.obj", load_shape).write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nl 1 2\n")
    add("edges", "edges.csv", load_shape).write_text("0,0,0,1,1,1\n2,2,2,3,4,5\n")
    truth = Path(trinoc.__file__).parent / "synth" / "demo" / "truth.json"
    shutil.copy(truth, add("truth", "truth.json", load_scene_truth))
    image = np.random.default_rng(3).integers(0, 256, (12, 16), np.uint8)
    for ending in ("png", "tif", "jpg", "bmp", "pgm", "webp"):
        encoded = cv2.imencode(f".{ending}", image)[1].tobytes()
        add(ending, f"picture.{ending}", read_image).write_bytes(encoded)
    files |= _of_other_tools(folder, segments)
    return files


def measured() -> trinoc.Matches:
    """Matches with all fields, like those of the matcher."""
    plain = bench_matches(4)
    random = np.random.default_rng(9)
    root = random.normal(size=(*plain.index.shape, 4, 4))
    covariance = root @ root.swapaxes(-1, -2)
    covariance[plain.index < 0] = np.nan
    return dataclasses.replace(
        plain,
        fragments_covariance_px2=covariance,
        misfit=np.ones(len(plain)),
        viewpoint_dependent=np.zeros(len(plain), dtype=bool),
        notes=("a note.",),
    )


def _frame_table(path: Path) -> Any:
    from trinoc.io.atomic import read_text

    return frames_of_table(read_text(path), ("upper", "left"), str(path))


def _of_other_tools(folder: Path, segments: trinoc.Segments) -> dict[str, ValidFile]:
    """Files of the readable formats of other tools. A folder contributes each of its files."""
    files = {}
    lenses = {name: camera.intrinsics for name, camera in RIG.items()}
    for name, form in FORMATS.items():
        if not form.reads:
            continue
        below = folder / f"of {name}"
        below.mkdir(parents=True)
        rig = bench_rig(0 if name.startswith("colmap") else 4)
        value = segments if "segments" in form.reads else rig
        target = below / f"rig{(form.endings or ('.txt',))[0]}"
        if form.write is None:
            target.write_text(cameras_xml(), encoding="utf-8")
            load = lambda form=form, target=target: form.load(target)  # noqa: E731
            files[f"{name} {target.name}"] = ValidFile(target, load)
            continue
        if form.place == "folder" or ("folder" in form.place and "rig" in form.reads):
            target = below / "rig"
        form.save(value, target)
        for path in sorted(target.rglob("*")) if target.is_dir() else [target]:
            if path.is_file():
                load = lambda form=form, target=target: form.load(target, lenses=lenses)  # noqa: E731
                files[f"{name} {path.name}"] = ValidFile(path, load)
    return files
