"""nerfstudio's transforms.json: one frame for each camera, with its own lens.

Cameras look along -z with y up, as OpenGL's, and poses are world_from_cam. The world stays as it
is, Z up, as nerfstudio likes it. Pixels count from the corner of the top-left one, as in COLMAP,
from which nerfstudio takes its principal points. `file_path` is images/NAME.png: put the pictures
there.
"""

import json
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.lens_rows import LensNumbers, LensRow, list_lens_numbers, make_lens
from trinoc.io.formats.motions import from_homogeneous, homogeneous, inverse
from trinoc.io.formats.text_files import expect_file_name, read_json
from trinoc.io.json_document import Block

TITLE = "nerfstudio's transforms.json"
HALF_PX = 0.5
COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2")
ROWS = (
    LensRow("OPENCV", "brown_conrady", COEFFICIENTS),
    LensRow("OPENCV_FISHEYE", "kannala_brandt", ("k1", "k2", "k3", "k4")),
    LensRow("PINHOLE", "none", ()),
    LensRow("SIMPLE_PINHOLE", "none", ()),
)
# A camera that looks along -z with y up, from one that looks along z with y down.
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def write_nerfstudio(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write the frames."""
    frames = []
    for name, camera in rig.items():
        numbers = list_lens_numbers(camera.intrinsics, ROWS, TITLE, name, origin_px=HALF_PX)
        world_from_cam = homogeneous(inverse(np.asarray(camera.cam_from_world)), unit_mm)
        row = next(row for row in ROWS if row.called == numbers.called)
        frames.append(
            {
                "file_path": f"images/{expect_file_name(name, TITLE)}.png",
                "camera_model": numbers.called,
                "w": camera.image_size_px[0],
                "h": camera.image_size_px[1],
                "fl_x": numbers.focal_px[0],
                "fl_y": numbers.focal_px[1],
                "cx": numbers.centre_px[0],
                "cy": numbers.centre_px[1],
                **dict(zip(row.coefficients, numbers.coefficients, strict=True)),
                "transform_matrix": (world_from_cam @ FLIP).tolist(),
            }
        )
    document = {"camera_model": frames[0]["camera_model"], "frames": frames}
    write_text(path, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def read_nerfstudio(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig:
    """The frames as cameras, named by their pictures; what a frame lacks stands at the top."""
    document = read_json(path)
    frames = document.values.get("frames")
    if not isinstance(frames, list) or not frames:
        raise document.error("frames", "must be a list of frames: add one for each camera.")
    cameras: dict[str, Camera] = {}
    shared = {key: value for key, value in document.values.items() if key != "frames"}
    for number, frame in enumerate(frames):
        own: dict[str, Any] = frame if isinstance(frame, dict) else {}
        block = Block({**shared, **own}, document.file, f"frames[{number}]")
        name = PurePosixPath(block.text("file_path")).stem
        if not name or name in cameras:
            raise block.error("file_path", "names no picture, or one before it: correct it.")
        matrix = block.numbers("transform_matrix", (4, 4)) @ FLIP
        where = f'{document.file}: "frames[{number}].transform_matrix"'
        world_from_cam = from_homogeneous(matrix, unit_mm, where)
        cameras[name] = Camera(_lens(block), Pose(inverse(world_from_cam)))
    return Rig(cameras)


def _lens(block: Block) -> Intrinsics:
    called = block.text("camera_model") if "camera_model" in block.values else "OPENCV"
    row = next((row for row in ROWS if row.called == called), None)
    names = COEFFICIENTS if row is None else row.coefficients
    numbers = LensNumbers(
        called,
        (block.number("fl_x"), block.number("fl_y" if "fl_y" in block.values else "fl_x")),
        (block.number("cx"), block.number("cy")),
        0.0,
        [block.number(name) if name in block.values else 0.0 for name in names],
    )
    size = Block({"size": [block.number("w"), block.number("h")]}, block.file, block.place)
    where = f'{block.file}: "{block.place}"'
    return make_lens(numbers, size.image_size_px("size"), ROWS, where, origin_px=HALF_PX)


nerfstudio = Format(
    name="nerfstudio",
    title=TITLE,
    holds=("rig",),
    reads=("rig",),
    place="file",
    endings=(".json",),
    unit_mm=1.0,
    unit_is_fixed=False,
    frames="pixel (0, 0) is the corner of the top-left pixel, (0.5, 0.5) its centre; x right, "
    "y up, z back (OpenGL), as world_from_cam",
    loses=(COVARIANCE, PIXEL_PITCH),
    write=write_nerfstudio,
    read=read_nerfstudio,
)
