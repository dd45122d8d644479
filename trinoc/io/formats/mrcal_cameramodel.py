"""mrcal's .cameramodel: a file for each camera; a rig is a folder of NAME.cameramodel files.

`extrinsics` contains the rotation vector and the translation of x_cam = R x_ref + t. mrcal's own
tools use metres, but any other unit works. A covariance is lost, because mrcal computes uncertainty
from its own optimization inputs.
"""

import ast
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, METRE_MM, ORDER, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys
from trinoc.io.formats.lens_rows import LensNumbers, LensRow, list_lens_numbers, make_lens
from trinoc.io.formats.motions import motion, rotation_of_vector, rotation_vector
from trinoc.io.formats.notations import Notation, make_block, parse_file
from trinoc.io.formats.text_files import atomic_folder, expect_file_names
from trinoc.io.json_document import Block

TITLE = "mrcal's .cameramodel"
ENDING = ".cameramodel"
_OPENCV = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
ROWS = (
    LensRow("LENSMODEL_PINHOLE", "none", ()),
    *(LensRow(f"LENSMODEL_OPENCV{n}", "brown_conrady", _OPENCV[:n]) for n in (4, 5, 8, 12)),
    *(LensRow(f"LENSMODEL_OPENCV{n}", "rational", _OPENCV[:n]) for n in (8, 12)),
    LensRow("LENSMODEL_OPENCV12", "thin_prism", _OPENCV),
)
# The key of the pose, as mrcal writes it now and wrote it before.
POSE_KEYS = ("extrinsics", "rt_cam_ref")


KEYS = Keys(
    read=("lensmodel", "intrinsics", "imagersize", *POSE_KEYS),
    left_out=("valid_intrinsics_region",),
)


def write_mrcal(value: Rig | Intrinsics, path: Path, unit_mm: float) -> None:
    """Write a lens as a file, or a rig as a folder of files.

    Translations are in units of `unit_mm`. A lens is written as a camera at the origin.
    """
    if isinstance(value, Intrinsics):
        write_text(path, _text(value, np.eye(3, 4), "", unit_mm))
        return
    expect_file_names(value, TITLE)
    texts = {
        name: _text(camera.intrinsics, np.asarray(camera.cam_from_world), name, unit_mm)
        for name, camera in value.items()
    }
    with atomic_folder(path) as folder:
        for name, text in texts.items():
            write_text(folder / f"{name}{ENDING}", text)


def read_mrcal(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig | Intrinsics:
    """Read the lens of a file, or the rig of a folder; a camera has the name of its file."""
    if not path.is_dir():
        return _camera(path, unit_mm).intrinsics
    files = sorted(path.glob(f"*{ENDING}"))
    if not files:
        raise InputError(f"{path} holds no {ENDING}: give a folder with one for each camera.")
    return Rig({file.stem: _camera(file, unit_mm) for file in files})


def _text(lens: Intrinsics, pose: np.ndarray, camera: str, unit_mm: float) -> str:
    numbers = list_lens_numbers(lens, ROWS, TITLE, camera)
    intrinsics = [*numbers.focal_px, *numbers.centre_px, *numbers.coefficients]
    extrinsics = [*rotation_vector(pose[:, :3]).tolist(), *(pose[:, 3] / unit_mm).tolist()]
    return (
        "{\n"
        f"    'lensmodel':  '{numbers.called}',\n\n"
        "    # focal lengths x, y; principal point x, y; distortion\n"
        f"    'intrinsics': {intrinsics!r},\n\n"
        "    # rotation vector and translation of x_cam = R x_ref + t\n"
        f"    'extrinsics': {extrinsics!r},\n\n"
        f"    'imagersize': {list(lens.image_size_px)!r},\n"
        "}\n"
    )


def _camera(path: Path, unit_mm: float) -> Camera:
    block = KEYS.take(_read_literal(path))
    intrinsics = block.numbers("intrinsics", (None,)).tolist()
    if len(intrinsics) < 4:
        raise block.error("intrinsics", "must begin with fx, fy, cx, cy: correct it.")
    model_name = block.text("lensmodel")
    numbers = LensNumbers(
        model_name,
        (intrinsics[0], intrinsics[1]),
        (intrinsics[2], intrinsics[3]),
        0.0,
        intrinsics[4:],
    )
    lens = make_lens(numbers, block.image_size_px("imagersize"), ROWS, str(path))
    key = next((key for key in POSE_KEYS if key in block.values), POSE_KEYS[0])
    vector = block.numbers(key, (6,))
    where = f'{path}: "{key}"'
    pose = motion(rotation_of_vector(vector[:3]), vector[3:] * unit_mm, where)
    return Camera(lens, Pose(pose))


def _read_literal(path: Path) -> Block:
    """Read the Python dictionary in a .cameramodel file without executing code."""
    block = make_block(parse_file(path, LITERAL), path)
    # The optimization inputs are binary; nothing here reads them.
    plain = {key: _lists(value) for key, value in block.values.items() if isinstance(key, str)}
    return Block({k: v for k, v in plain.items() if not isinstance(v, bytes)}, block.file, "")


LITERAL = Notation(f"a {ENDING} of mrcal", ast.literal_eval, (ValueError, SyntaxError, TypeError))


def _lists(value: object) -> object:
    return [_lists(item) for item in value] if isinstance(value, list | tuple) else value


mrcal = Format(
    name="mrcal",
    title=TITLE,
    holds=("rig", "lens"),
    reads=("rig", "lens"),
    place="file or folder",
    endings=(ENDING,),
    unit_mm=METRE_MM,
    loses=(COVARIANCE, PIXEL_PITCH, ORDER),
    write=write_mrcal,
    read=read_mrcal,
    keys={"a file": KEYS},
)
