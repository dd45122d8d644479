"""MC-Calib's calibrated_cameras_data.yml: `camera_0`, `camera_1`, ... in OpenCV's FileStorage.

`camera_pose_matrix` is the pose P of the camera in the frame of its group, x_group = P x_cam, in
the unit of the board. `distortion_type` is 0 for Brown's five coefficients, 1 for Kannala's four.

Source: Calibration::saveCamerasParams and Camera.cpp of MC-Calib.
"""

from pathlib import Path
from typing import Any

import numpy as np

from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.formats.cv_storage import read_storage, write_storage
from trinoc.io.formats.format import COVARIANCE, NAMES, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys
from trinoc.io.formats.lens_rows import LensNumbers, LensRow, list_lens_numbers, make_lens
from trinoc.io.formats.motions import from_homogeneous, homogeneous, inverse
from trinoc.io.formats.opencv_lens import flat_numbers, matrix_of_numbers
from trinoc.io.json_document import Block

TITLE = "MC-Calib's calibrated_cameras_data.yml"
ROWS = (
    LensRow("0", "brown_conrady", ("k1", "k2", "p1", "p2", "k3")),
    LensRow("1", "kannala_brandt", ("k1", "k2", "k3", "k4")),
)
KEYS = Keys(
    read=(
        *("camera_matrix", "distortion_vector", "distortion_type", "camera_group"),
        *("img_width", "img_height", "camera_pose_matrix"),
    )
)


def write_mc_calib(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write the cameras as one camera group whose frame is the world.

    Translations are in units of `unit_mm`.
    """
    document: dict[str, Any] = {"nb_camera": len(rig)}
    for number, (name, camera) in enumerate(rig.items()):
        numbers = list_lens_numbers(camera.intrinsics, ROWS, TITLE, name)
        world_from_cam = inverse(np.asarray(camera.cam_from_world))
        document[f"camera_{number}"] = {
            "camera_matrix": np.array(matrix_of_numbers(numbers)),
            "distortion_vector": np.array([numbers.coefficients]),
            "distortion_type": int(numbers.called),
            "camera_group": 0,
            "img_width": camera.image_size_px[0],
            "img_height": camera.image_size_px[1],
            "camera_pose_matrix": homogeneous(world_from_cam, unit_mm),
        }
    write_storage(document, path)


def read_mc_calib(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig:
    """Read the cameras of the file, whose world is the frame of their camera group.

    Raise `InputError` if the file has several camera groups.
    """
    document = read_storage(path)
    count = document.number("nb_camera")
    keys = [key for key in document.values if key.startswith("camera_")]
    expected = {f"camera_{number}" for number in range(len(keys))}
    if not keys or count != len(keys) or set(keys) != expected:
        raise document.error(
            "nb_camera",
            f"is {count:g}, but the file has {', '.join(keys) or 'no camera'}: MC-Calib wrote one "
            "group of cameras only. Take pictures that connect all cameras.",
        )
    blocks = [KEYS.take(document.block(f"camera_{number}")) for number in range(len(keys))]
    if len({str(block.values.get("camera_group")) for block in blocks}) > 1:
        raise blocks[0].error(
            "camera_group",
            "differs from the value of a camera below: take pictures that connect all cameras.",
        )
    cameras = {}
    for block in blocks:
        where = f'{block.file}: "{block.place}.camera_pose_matrix"'
        matrix = block.numbers("camera_pose_matrix", (4, 4))
        world_from_cam = from_homogeneous(matrix, unit_mm, where)
        cameras[block.place] = Camera(_lens(block), Pose(inverse(world_from_cam)))
    return Rig(cameras)


def _lens(block: Block) -> Intrinsics:
    (fx, skew, cx), (lower, fy, cy), last = block.numbers("camera_matrix", (3, 3)).tolist()
    # The last number is 0 in files of early versions.
    if skew or lower or last not in ([0, 0, 1], [0, 0, 0]):
        raise block.error("camera_matrix", "must be fx 0 cx, 0 fy cy, 0 0 1: correct it.")
    model_name = f"{block.number('distortion_type'):g}"
    if model_name not in (row.called for row in ROWS):
        raise block.error(
            "distortion_type", f"is {model_name}, but trinoc reads only 0 (Brown) and 1 (Kannala)."
        )
    sides = [block.number("img_width"), block.number("img_height")]
    numbers = LensNumbers(
        model_name,
        (fx, fy),
        (cx, cy),
        0.0,
        flat_numbers(block, "distortion_vector").tolist(),
    )
    size_px = Block({"size": sides}, block.file, block.place).image_size_px("size")
    return make_lens(numbers, size_px, ROWS, f'{block.file}: "{block.place}"')


mc_calib = Format(
    name="mc-calib",
    title=TITLE,
    holds=("rig",),
    reads=("rig",),
    endings=(".yml", ".yaml"),
    frames="pixel (0, 0) is the centre of the top-left pixel; x right, y down, z forward, as "
    "world_from_cam",
    loses=(NAMES, COVARIANCE, PIXEL_PITCH),
    write=write_mc_calib,
    read=read_mc_calib,
    keys={"camera_0, camera_1, ...": KEYS},
)
