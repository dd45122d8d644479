"""Kalibr's camchain, a YAML file with cam0, cam1, ...

Each camera has its pose relative to the previous camera, `T_cn_cnm1`, or to a common inertial unit,
`T_cam_imu`. The world is the first camera, and cameras have numbers instead of names. So the world
and the names of a rig are lost. Kalibr's radtan model has exactly k1, k2, p1, p2.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, METRE_MM, NAMES, PIXEL_PITCH, WORLD, Format, Lenses
from trinoc.io.formats.keys import Keys, Refused
from trinoc.io.formats.lens_rows import LensNumbers, LensRow, list_lens_numbers, make_lens
from trinoc.io.formats.motions import (
    chain_motions,
    from_homogeneous,
    homogeneous,
    inverse,
    rotation_vector,
)
from trinoc.io.formats.notations import read_yaml
from trinoc.io.formats.text_files import yaml_text
from trinoc.io.json_document import Block

TITLE = "Kalibr's camchain"
# How far two statements of one pose may differ: Kalibr computes one from the other.
_SAME_RAD, _SAME_MM = 1e-3, 1.0
_PAIR = re.compile(r"T_cam(\d+)_cam(\d+)")
KEYS = Keys(
    read=(
        *("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution"),
        *("T_cn_cnm1", "T_cam_imu"),
    ),
    refused={
        "line_delay": Refused(
            "the rows are exposed one after the other (rolling shutter), which trinoc does not "
            "model: take pictures with a global shutter",
            (0,),
        )
    },
)
ROWS = (
    LensRow("radtan", "brown_conrady", ("k1", "k2", "p1", "p2")),
    LensRow("equidistant", "kannala_brandt", ("k1", "k2", "k3", "k4")),
    LensRow("none", "none", ()),
)


def write_kalibr(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write the cameras as a Kalibr camchain; translations in units of `unit_mm`.

    Each pose is relative to the previous camera.
    """
    document, previous_pose = {}, None
    for number, (name, camera) in enumerate(rig.items()):
        numbers = list_lens_numbers(camera.intrinsics, ROWS, TITLE, name)
        entry: dict[str, Any] = {}
        pose = np.asarray(camera.cam_from_world)
        if previous_pose is not None:
            entry["T_cn_cnm1"] = homogeneous(
                chain_motions(pose, inverse(previous_pose)), unit_mm
            ).tolist()
        entry |= {
            "camera_model": "pinhole",
            "distortion_coeffs": numbers.coefficients,
            "distortion_model": numbers.called,
            "intrinsics": [*numbers.focal_px, *numbers.centre_px],
            "resolution": list(camera.image_size_px),
            "rostopic": f"/{name}/image_raw",
        }
        document[f"cam{number}"], previous_pose = entry, pose
    write_text(path, yaml_text(document))


def read_kalibr(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig:
    """Read a Kalibr camchain as a rig whose world is the frame of cam0."""
    document = read_yaml(path)
    if "cam0" not in document.values:
        raise document.error("cam0", "is missing: give the camchain that Kalibr writes.")
    blocks = []
    for number, name in enumerate(key for key in document.values if not _PAIR.fullmatch(key)):
        if name != f"cam{number}":
            raise document.error(
                name, f"is at the position of cam{number}: order the cameras by number."
            )
        blocks.append(KEYS.take(document.block(name)))
    poses = _poses(blocks, unit_mm)
    _expect_pairs(document, poses, unit_mm)
    return Rig(
        {
            block.place: Camera(_lens(block), Pose(pose))
            for block, pose in zip(blocks, poses, strict=True)
        }
    )


def _poses(blocks: list[Block], unit_mm: float) -> list[np.ndarray]:
    """Poses cam_from_cam0 (3, 4) of all cameras, in mm.

    Each pose comes from the chain `T_cn_cnm1`, or without that key from the inertial unit,
    `T_cam_imu`. Raise `InputError` if a camera has neither key, or both with different results.
    """
    from_imu = [
        _motion(block, "T_cam_imu", unit_mm) if "T_cam_imu" in block.values else None
        for block in blocks
    ]
    poses = [np.eye(3, 4)]
    for block, cam_from_imu in zip(blocks[1:], from_imu[1:], strict=True):
        imu_pose = None
        if from_imu[0] is not None and cam_from_imu is not None:
            imu_pose = chain_motions(cam_from_imu, inverse(from_imu[0]))
        if imu_pose is not None and "T_cn_cnm1" not in block.values:
            poses.append(imu_pose)
            continue
        pose = chain_motions(_motion(block, "T_cn_cnm1", unit_mm), poses[-1])
        if imu_pose is not None and not _is_same(pose, imu_pose):
            raise block.error(
                "T_cam_imu", "contradicts T_cn_cnm1: remove the wrong one of the two."
            )
        poses.append(pose)
    return poses


def _expect_pairs(document: Block, poses: list[np.ndarray], unit_mm: float) -> None:
    """Raise `InputError` if a key such as `T_cam1_cam0` contradicts `poses`.

    Some data sets add these keys to Kalibr's file.
    """
    for key in document.values:
        pair = _PAIR.fullmatch(key)
        if pair is None:
            continue
        second, first = map(int, pair.groups())
        stated = _motion(document, key, unit_mm)
        if max(first, second) >= len(poses) or not _is_same(
            stated, chain_motions(poses[second], inverse(poses[first]))
        ):
            raise document.error(
                key, "contradicts the chain of poses: remove the wrong one of the two."
            )


def _motion(block: Block, key: str, unit_mm: float) -> np.ndarray:
    where = f'{block.file}: "{f"{block.place}.{key}".lstrip(".")}"'
    return from_homogeneous(block.numbers(key, (4, 4)), unit_mm, where)


def _is_same(pose: np.ndarray, other: np.ndarray) -> bool:
    turn = rotation_vector(pose[:, :3].T @ other[:, :3])
    away = np.linalg.norm(pose[:, 3] - other[:, 3])
    return bool(np.linalg.norm(turn) < _SAME_RAD and away < _SAME_MM)


def _lens(block: Block) -> Intrinsics:
    if block.text("camera_model") != "pinhole":
        raise InputError(
            f'{block.file}: "{block.place}.camera_model" is {block.text("camera_model")}, but '
            "trinoc reads pinhole: calibrate with that model."
        )
    fx, fy, cx, cy = block.numbers("intrinsics", (4,)).tolist()
    model_name = block.text("distortion_model")
    coefficients = block.numbers("distortion_coeffs", (None,)).tolist()
    if model_name in ("radtan", "equidistant") and len(coefficients) != 4:
        raise block.error("distortion_coeffs", f"must be the four of {model_name}.")
    numbers = LensNumbers(model_name, (fx, fy), (cx, cy), 0.0, coefficients)
    where = f'{block.file}: "{block.place}"'
    return make_lens(numbers, block.image_size_px("resolution"), ROWS, where)


kalibr = Format(
    name="kalibr",
    title=TITLE,
    holds=("rig",),
    reads=("rig",),
    endings=(".yaml", ".yml"),
    unit_mm=METRE_MM,
    unit_is_fixed=True,
    frames="pixel (0, 0) is the centre of the top-left pixel; x right, y down, z forward; the "
    "world is the first camera",
    loses=(WORLD, NAMES, COVARIANCE, PIXEL_PITCH),
    write=write_kalibr,
    read=read_kalibr,
    keys={"cam0, cam1, ...": KEYS},
)
