"""nerfstudio's transforms.json: one frame for each camera, with its own lens.

Cameras look along -z with y up, as in OpenGL, and poses are world_from_cam. The world is unchanged,
with Z up. The pixel origin is the corner of the top-left pixel, as in COLMAP, from which nerfstudio
takes its principal points. `file_path` is images/NAME.png, where the user must put the images.
Files of instant-ngp, whose focal length is an angle of view, are read, too.

Source: nerfstudio_dataparser.py and cameras.py of nerfstudio, nerf_loader.cu of instant-ngp.
"""

import json
import math
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys, Refused
from trinoc.io.formats.lens_rows import LensNumbers, LensRow, list_lens_numbers, make_lens
from trinoc.io.formats.motions import from_homogeneous, homogeneous, inverse
from trinoc.io.formats.notations import read_json
from trinoc.io.formats.text_files import expect_file_names
from trinoc.io.json_document import Block

TITLE = "nerfstudio's transforms.json"
HALF_PX = 0.5
COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2")
FISHEYE = "OPENCV_FISHEYE"
_FISHEYE_ROW = LensRow(FISHEYE, "kannala_brandt", ("k1", "k2", "k3", "k4"))
WRITTEN = (
    LensRow("OPENCV", "brown_conrady", COEFFICIENTS),
    _FISHEYE_ROW,
    LensRow("PINHOLE", "none", ()),
)
# nerfstudio takes the coefficients whatever the perspective model is called.
_PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
READ = (
    *(LensRow(name, "brown_conrady", COEFFICIENTS) for name in _PERSPECTIVE),
    _FISHEYE_ROW,
)
_NO_SUCH_LENS = "trinoc has no such lens model: convert the pictures to a perspective camera first"
KEYS = Keys(
    read=(
        *("file_path", "transform_matrix", "camera_model", "is_fisheye"),
        *("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y"),
        *(*COEFFICIENTS, "distortion_params"),
    ),
    left_out=(
        *("applied_scale", "scale", "aabb_scale", "orientation_override"),
        *("depth_unit_scale_factor", "integer_depth_scale", "auto_scale_poses_override"),
        *("fisheye_crop_radius", "camera_label"),
    ),
    refused={
        "rolling_shutter": Refused(
            "the rows are exposed one after the other (rolling shutter), which trinoc does not "
            "model: take pictures with a global shutter, or with the camera at rest",
            ([0, 0, 0, 0], [0, 0, 0], False),
        ),
        "equirectangular": Refused(_NO_SUCH_LENS, (False,)),
        "latlong": Refused(_NO_SUCH_LENS, (False,)),
        "orthographic": Refused(_NO_SUCH_LENS, (False,)),
        **{f"ftheta_p{k}": Refused(_NO_SUCH_LENS) for k in range(5)},
    },
)
# A camera that looks along -z with y up, from one that looks along z with y down.
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def write_nerfstudio(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write one frame for each camera; translations in units of `unit_mm`."""
    expect_file_names(rig, TITLE)
    frames = []
    for name, camera in rig.items():
        numbers = list_lens_numbers(camera.intrinsics, WRITTEN, TITLE, name, origin_px=HALF_PX)
        world_from_cam = homogeneous(inverse(np.asarray(camera.cam_from_world)), unit_mm)
        row = next(row for row in WRITTEN if row.called == numbers.called)
        frames.append(
            {
                "file_path": f"images/{name}.png",
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
    """Read each frame as a camera.

    A camera has the name of its image file without ending, or the path if two images have the same
    name. Values that a frame lacks are taken from the top level of the file.
    """
    document = read_json(path)
    frames = document.values.get("frames")
    if not isinstance(frames, list) or not frames:
        raise document.error("frames", "must be a list of frames: add one for each camera.")
    cameras: dict[str, Camera] = {}
    shared = {key: value for key, value in document.values.items() if key != "frames"}
    blocks = []
    for number, frame in enumerate(frames):
        frame_values: dict[str, Any] = frame if isinstance(frame, dict) else {}
        blocks.append(
            KEYS.take(Block({**shared, **frame_values}, document.file, f"frames[{number}]"))
        )
    pictures = [PurePosixPath(block.text("file_path")) for block in blocks]
    stems_differ = len({picture.stem for picture in pictures}) == len(pictures)
    for number, (block, picture) in enumerate(zip(blocks, pictures, strict=True)):
        name = picture.stem if stems_differ else str(picture.with_suffix(""))
        if not picture.stem or name in cameras:
            raise block.error(
                "file_path",
                "is not the name of a picture, or repeats an earlier one: correct this name.",
            )
        matrix = block.numbers("transform_matrix", (4, 4)) @ FLIP
        where = f'{document.file}: "frames[{number}].transform_matrix"'
        world_from_cam = from_homogeneous(matrix, unit_mm, where)
        cameras[name] = Camera(_lens(block), Pose(inverse(world_from_cam)))
    return Rig(cameras)


def _lens(block: Block) -> Intrinsics:
    for key in ("w", "h"):
        if key not in block.values:
            raise block.error(key, "is missing: add w and h, the size of the pictures in px.")
    size_px = Block({"size": [block.number("w"), block.number("h")]}, block.file, block.place)
    width, height = size_px.image_size_px("size")
    model_name = _called(block)
    row = next((row for row in READ if row.called == model_name), None)
    names = COEFFICIENTS if row is None else row.coefficients
    coefficients: dict[str, float] = {
        key: block.number(key) for key in COEFFICIENTS if key in block.values
    }
    if "distortion_params" in block.values:
        if coefficients:
            raise block.error(
                "distortion_params",
                "is given in addition to k1 or another single coefficient: remove one of the two.",
            )
        values = block.numbers("distortion_params", (len(COEFFICIENTS),)).tolist()
        coefficients = dict(zip(COEFFICIENTS, values, strict=True))
    for key, value in coefficients.items():
        if value and key not in names:
            raise block.error(key, f"is {value:g}, which {model_name} does not have: correct it.")
    numbers = LensNumbers(
        model_name,
        _focal_px(block, width, height),
        (_centre(block, "cx", width), _centre(block, "cy", height)),
        0.0,
        [coefficients.get(name, 0.0) for name in names],
    )
    where = f'{block.file}: "{block.place}"'
    return make_lens(numbers, (width, height), READ, where, origin_px=HALF_PX)


def _called(block: Block) -> str:
    """Name of the camera model in `READ`, from `camera_model` or from instant-ngp's `is_fisheye`.

    The default is "OPENCV".
    """
    model_name = block.text("camera_model") if "camera_model" in block.values else ""
    if not block.values.get("is_fisheye"):
        return model_name or "OPENCV"
    if model_name not in ("", FISHEYE):
        raise block.error(
            "is_fisheye", f"is true, but camera_model is {model_name}: correct one of the two."
        )
    return FISHEYE


def _focal_px(block: Block, width: int, height: int) -> tuple[float, float]:
    """Focal lengths along u and v, px.

    Files of instant-ngp may have angles of view instead, from which the focal lengths are computed.
    """
    if "fl_x" in block.values or "camera_angle_x" not in block.values:
        if "fl_x" not in block.values:
            raise block.error("fl_x", "is missing: add fl_x, fl_y, cx and cy, in px.")
        fl_x = block.number("fl_x")
        return fl_x, block.number("fl_y") if "fl_y" in block.values else fl_x
    fl_x = _focal_of_angle(block, "camera_angle_x", width)
    both = "camera_angle_y" in block.values
    return fl_x, _focal_of_angle(block, "camera_angle_y", height) if both else fl_x


def _focal_of_angle(block: Block, key: str, side_px: int) -> float:
    angle_rad = block.number(key)
    if not 0 < angle_rad < math.pi:
        raise block.error(key, f"is {angle_rad:g}, but must be an angle in rad: correct it.")
    return side_px / 2 / math.tan(angle_rad / 2)


def _centre(block: Block, key: str, side_px: int) -> float:
    """Coordinate `key` ("cx" or "cy") of the principal point, px.

    In a file that has an angle of view instead of a focal length, the default is the image centre.
    """
    if key not in block.values and "fl_x" not in block.values:
        return side_px / 2
    return block.number(key)


nerfstudio = Format(
    name="nerfstudio",
    title=TITLE,
    holds=("rig",),
    reads=("rig",),
    endings=(".json",),
    frames="pixel (0, 0) is the corner of the top-left pixel, (0.5, 0.5) its centre; x right, "
    "y up, z back (OpenGL), as world_from_cam",
    loses=(COVARIANCE, PIXEL_PITCH),
    write=write_nerfstudio,
    read=read_nerfstudio,
    keys={"frames[], and the file": KEYS},
)
