"""ROS `camera_info` YAML, as `camera_calibration` writes and `camera_info_manager` reads it.

A camera_info has no pose. A rig is written as a folder: NAME.yaml for each camera, and the poses in
`tf_static.yaml`. The rectification R is the identity and P is [K 0], because three cameras have no
common rectified plane. A pair that `camera_calibration` calibrated has such a plane: a folder
without `tf_static.yaml` is read by means of R and P.

Source: sensor_msgs/CameraInfo; REP 104.
"""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, METRE_MM, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys, Refused
from trinoc.io.formats.lens_rows import (
    LensNumbers,
    LensRow,
    list_lens_numbers,
    list_lenses,
    make_lens,
)
from trinoc.io.formats.motions import chain_motions, checked_rotation, inverse
from trinoc.io.formats.notations import read_yaml
from trinoc.io.formats.text_files import atomic_folder, expect_file_names, yaml_text
from trinoc.io.formats.tf_static import read_tf, write_tf
from trinoc.io.json_document import Block

TITLE = "ROS camera_info"
POSES = "tf_static.yaml"
_PLUMB_BOB = ("k1", "k2", "p1", "p2", "k3")
_RATIONAL = (*_PLUMB_BOB, "k4", "k5", "k6")
_BINNED = Refused(
    "the pictures are binned, but the lens is calibrated for the whole sensor: calibrate in the "
    "mode that is used, or take pictures without binning",
    (0, 1),
)
FILE_KEYS = Keys(
    read=(
        *("image_width", "image_height", "camera_matrix", "distortion_model"),
        *("distortion_coefficients", "rectification_matrix", "projection_matrix"),
    ),
    refused={"binning_x": _BINNED, "binning_y": _BINNED},
)
MESSAGE_KEYS = Keys(
    read=("width", "height", "distortion_model", *"kdrpKDRP", "roi"),
    refused={"binning_x": _BINNED, "binning_y": _BINNED},
)
ROI_KEYS = Keys(
    read=("x_offset", "y_offset", "width", "height"),
    refused={
        "do_rectify": Refused(
            "the message is for rectified pictures, but its lens is for the raw pictures: give the "
            "camera_info of the raw pictures",
            (False, 0),
        )
    },
)
ROWS = (
    LensRow("plumb_bob", "brown_conrady", _PLUMB_BOB),
    LensRow("rational_polynomial", "brown_conrady", _RATIONAL),
    LensRow("rational_polynomial", "rational", _RATIONAL),
    LensRow("rational_polynomial", "thin_prism", (*_RATIONAL, "s1", "s2", "s3", "s4")),
    LensRow("equidistant", "kannala_brandt", ("k1", "k2", "k3", "k4")),
)


def write_ros(value: Rig | Intrinsics, path: Path, unit_mm: float) -> None:
    """Write a lens as a file, or a rig as a folder of files with the poses in `tf_static.yaml`."""
    if isinstance(value, Intrinsics):
        write_text(path, _text(value, "camera"))
        return
    for name in value:
        expect_ros_name(name)
    expect_file_names((Path(POSES).stem, *value), TITLE)
    texts = {name: _text(lens, name) for name, lens in list_lenses(value).items()}
    with atomic_folder(path) as folder:
        for name, text in texts.items():
            write_text(folder / f"{name}.yaml", text)
        write_tf(value, folder / POSES, METRE_MM)


def read_ros(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig | Intrinsics:
    """Read the lens of a file, or the rig of a folder.

    Poses come from `tf_static.yaml`. Without that file, the folder must contain a rectified stereo
    pair: the poses then come from R and P, and the world is the frame of the first camera.
    """
    if not path.is_dir():
        return _read_info(path).lens
    files = sorted(file for file in path.glob("*.yaml") if file.name != POSES)
    if not files:
        raise InputError(
            f"{path} must hold a camera_info for each camera (NAME.yaml), and their poses in "
            f"{POSES} or by R and P: give one camera_info file to read a lens alone."
        )
    infos = {file.stem: _read_info(file) for file in files}
    if not (path / POSES).is_file():
        return _rectified_rig(infos, path)
    return read_tf(path / POSES, METRE_MM, {name: info.lens for name, info in infos.items()})


def expect_ros_name(name: str) -> None:
    """Raise `InputError` for a camera name that ROS does not accept."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise InputError(
            f'The camera "{name}" has no name that ROS takes: rename it with letters, digits and _.'
        )


def _text(lens: Intrinsics, camera: str) -> str:
    numbers = list_lens_numbers(lens, ROWS, TITLE, camera)
    (fx, fy), (cx, cy) = numbers.focal_px, numbers.centre_px
    matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    document = {
        "image_width": lens.image_size_px[0],
        "image_height": lens.image_size_px[1],
        "camera_name": camera,
        "camera_matrix": _matrix(3, 3, matrix),
        "distortion_model": numbers.called,
        "distortion_coefficients": _matrix(1, len(numbers.coefficients), numbers.coefficients),
        "rectification_matrix": _matrix(3, 3, np.eye(3).ravel().tolist()),
        "projection_matrix": _matrix(
            3, 4, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
        ),
    }
    return yaml_text(document)


def _matrix(rows: int, columns: int, data: list[float]) -> dict[str, Any]:
    return {"rows": rows, "cols": columns, "data": data}


class _Info(NamedTuple):
    """Content of a camera_info.

    Attributes
    ----------
    lens : Intrinsics
        The lens of the raw images.
    rectified_from_cam : (3, 3)
        Rectification R; the identity if the file has none.
    projection : (3, 4)
        Projection P of the rectified images, in px and metres; zeros if the file has none.
    """

    lens: Intrinsics
    rectified_from_cam: np.ndarray
    projection: np.ndarray


def _read_info(path: Path) -> _Info:
    """Read a calibration file, or a camera_info message as `ros2 topic echo` prints it."""
    document = read_yaml(path)
    if "camera_matrix" in document.values:
        block = FILE_KEYS.take(document)
        size = [block.number("image_width"), block.number("image_height")]
        matrix = block.block("camera_matrix").numbers("data", (9,))
        coefficients = block.block("distortion_coefficients").numbers("data", (None,))
        rectification, projection = (
            block.block(key).numbers("data", (count,)) if key in block.values else None
            for key, count in (("rectification_matrix", 9), ("projection_matrix", 12))
        )
    else:
        block = MESSAGE_KEYS.take(document)
        d, k, r, p = "dkrp" if "k" in block.values else "DKRP"
        size = [block.number("width"), block.number("height")]
        matrix, coefficients = block.numbers(k, (9,)), block.numbers(d, (None,))
        rectification, projection = (
            block.numbers(key, (count,)) if key in block.values else None
            for key, count in ((r, 9), (p, 12))
        )
        if "roi" in block.values:
            _expect_whole_picture(ROI_KEYS.take(block.block("roi")), size)
    if not matrix.any():
        raise InputError(
            f"{path} has a camera matrix of zeros, as of a camera that is not calibrated: "
            "calibrate it, or give the message after its calibration is loaded."
        )
    (fx, skew, cx), (lower, fy, cy), last = matrix.reshape(3, 3).tolist()
    if skew or lower or last != [0, 0, 1]:
        raise document.error("camera_matrix", "must be fx 0 cx, 0 fy cy, 0 0 1: correct it.")
    numbers = LensNumbers(
        block.text("distortion_model"), (fx, fy), (cx, cy), 0.0, coefficients.tolist()
    )
    size_px = Block({"size": size}, document.file, "").image_size_px("size")
    return _Info(
        make_lens(numbers, size_px, ROWS, str(path)),
        np.eye(3) if rectification is None else rectification.reshape(3, 3),
        np.zeros((3, 4)) if projection is None else projection.reshape(3, 4),
    )


def _expect_whole_picture(roi: Block, size: list[float]) -> None:
    """Raise `InputError` if a message's region of interest is only a part of the image.

    `size` is the size (width, height) of the whole image, which the lens belongs to.
    """
    part = [roi.number(key) if key in roi.values else 0.0 for key in ROI_KEYS.read]
    if part not in ([0.0, 0.0, 0.0, 0.0], [0.0, 0.0, *size]):
        raise InputError(
            f'{roi.file}: "roi" is a part of the picture ({part[2]:g} x {part[3]:g} at '
            f"{part[0]:g}, {part[1]:g}): use whole pictures, or calibrate with pictures of this "
            "part."
        )


def _rectified_rig(infos: dict[str, _Info], path: Path) -> Rig:
    """Rig of cameras that were rectified together; the world is the frame of the first camera.

    The projection P of each camera is K' [I | t]. t is the translation from the common rectified
    frame to the rectified frame of the camera, in metres.
    """
    names = list(infos)
    shifts_mm = {}
    for name, info in infos.items():
        fx, fy = info.projection[0, 0], info.projection[1, 1]
        if not (fx > 0 and fy > 0 and info.projection[2].tolist() == [0, 0, 1, 0]):
            raise InputError(f"{path / name}.yaml has an invalid projection_matrix: correct it.")
        shift = [info.projection[0, 3] / fx, info.projection[1, 3] / fy, 0.0]
        shifts_mm[name] = np.array(shift) * METRE_MM
    if len(names) < 2 or not any(shift.any() for shift in shifts_mm.values()):
        raise InputError(
            f"{path} has no {POSES}, and its files have no R and P of a stereo pair: add the "
            "poses, or give one camera_info file to read a lens alone."
        )
    poses = {}
    for name, info in infos.items():
        where = f"{path / name}.yaml, rectification_matrix,"
        cam_from_rectified = checked_rotation(info.rectified_from_cam, where).T
        shift = cam_from_rectified @ shifts_mm[name]
        poses[name] = np.concatenate([cam_from_rectified, shift[:, None]], axis=1)
    to_first = inverse(poses[names[0]])
    return Rig(
        {
            name: Camera(info.lens, Pose(chain_motions(poses[name], to_first)))
            for name, info in infos.items()
        }
    )


ros = Format(
    name="ros",
    title=TITLE,
    holds=("rig", "lens"),
    reads=("rig", "lens"),
    place="file or folder",
    endings=(".yaml", ".yml"),
    unit_mm=METRE_MM,
    unit_is_fixed=True,
    frames="pixel (0, 0) is the centre of the top-left pixel; optical frames: x right, y down, "
    "z forward",
    loses=(COVARIANCE, PIXEL_PITCH),
    write=write_ros,
    read=read_ros,
    keys={"a file": FILE_KEYS, "a message": MESSAGE_KEYS, "roi of a message": ROI_KEYS},
)
