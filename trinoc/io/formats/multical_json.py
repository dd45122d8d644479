"""multical's calibration.json: lenses under `cameras`, and poses under `camera_poses`.

`R` and `T` are those of x_cam = R x_rig + T. multical writes the first camera at the origin. The
other cameras have the key `NAME_to_FIRST`, which contains the motion from FIRST to NAME. `dist` is
a row for perspective lenses. A column of four numbers belongs to multical's fisheye, which `model`
does not name.

Source: io/export_calib.py, io/import_calib.py and camera_fisheye.py of multical.
"""

import json
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, METRE_MM, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys, Refused
from trinoc.io.formats.lens_rows import list_lens_numbers
from trinoc.io.formats.motions import motion
from trinoc.io.formats.notations import read_json
from trinoc.io.formats.opencv_lens import FISHEYE, WRITTEN, matrix_of_numbers, read_opencv_lens
from trinoc.io.json_document import Block

TITLE = "multical's calibration.json"
TO = "_to_"
# multical's names of the perspective lenses that trinoc writes, by the model.
MODELS = {"brown_conrady": "standard", "rational": "rational", "thin_prism": "thin_prism"}
KNOWN = ("standard", "rational", "thin_prism", "tilted")
KEYS = Keys(
    read=("model", "image_size", "K", "dist"),
    refused={
        "has_skew": Refused("trinoc reads no skew here: calibrate without it", (False, 0)),
    },
)
POSE_KEYS = Keys(read=("R", "T"))


def write_multical(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write lenses and poses; every pose is relative to the world, in units of `unit_mm`."""
    cameras, poses = {}, {}
    for name, camera in rig.items():
        if TO in name:
            raise InputError(
                f'The name of the camera "{name}" contains "{TO}", which marks a pair of cameras '
                f"in {TITLE}: rename the camera."
            )
        numbers = list_lens_numbers(camera.intrinsics, WRITTEN[:-1], TITLE, name)
        pose = np.asarray(camera.cam_from_world)
        cameras[name] = {
            "model": MODELS.get(camera.intrinsics.lens.model, "standard"),
            "image_size": list(camera.image_size_px),
            "K": matrix_of_numbers(numbers),
            "dist": [numbers.coefficients],
        }
        poses[name] = {"R": pose[:, :3].tolist(), "T": (pose[:, 3] / unit_mm).tolist()}
    document = {"cameras": cameras, "camera_poses": poses}
    write_text(path, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def read_multical(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig:
    """Read the cameras and their poses.

    A pose may be relative to another camera only if that camera is at the world origin.
    """
    document = read_json(path)
    if "camera_poses" not in document.values:
        raise document.error(
            "camera_poses",
            "is missing, as in intrinsic.json: give the calibration.json of a rig.",
        )
    cameras = {name: KEYS.take(block) for name, block in document.block("cameras").blocks()}
    poses = _poses(document.block("camera_poses"), unit_mm)
    for name in [*poses, *cameras]:
        if name not in poses or name not in cameras:
            where = "cameras" if name in poses else "camera_poses"
            raise document.error(where, f'lacks "{name}": calibrate all cameras together.')
    return Rig({name: Camera(_lens(block), Pose(poses[name])) for name, block in cameras.items()})


def _poses(document: Block, unit_mm: float) -> dict[str, np.ndarray]:
    from_world, from_first = {}, {}
    for key, pose in document.blocks():
        block = POSE_KEYS.take(pose)
        rotation = block.numbers("R", (3, 3))
        translation = block.numbers("T", (3,))
        matrix = motion(rotation, translation * unit_mm, f'{block.file}: "{block.place}.R"')
        name, to, first = key.partition(TO)
        (from_first if to else from_world)[key] = matrix
    for key, matrix in from_first.items():
        name, _, first = key.partition(TO)
        origin = from_world.get(first)
        if origin is None or not np.array_equal(origin, np.eye(3, 4)):
            raise document.error(
                key, f'must contain the identity as the pose of "{first}": export with one master.'
            )
        if name in from_world:
            raise document.error(key, f'is a second pose of "{name}": remove one of the two.')
        from_world[name] = matrix
    return from_world


def _lens(block: Block) -> Intrinsics:
    model = block.text("model") if "model" in block.values else "standard"
    if model not in KNOWN:
        raise block.error(
            "model", f'is "{model}", but trinoc reads {", ".join(KNOWN)} here: use one of these.'
        )
    value = block.values.get("dist")
    column = isinstance(value, list) and len(value) == 4 and all(isinstance(x, list) for x in value)
    return read_opencv_lens(
        block,
        "K",
        "dist",
        block.image_size_px("image_size"),
        FISHEYE.called if column else "",
        f'{block.file}: "{block.place}"',
    )


multical = Format(
    name="multical",
    title=TITLE,
    holds=("rig",),
    reads=("rig",),
    endings=(".json",),
    unit_mm=METRE_MM,
    loses=(COVARIANCE, PIXEL_PITCH),
    write=write_multical,
    read=read_multical,
    keys={"cameras.NAME": KEYS, "camera_poses.NAME": POSE_KEYS},
)
