"""MATLAB's `stereoParameters` as structs in a .mat file, for MATLAB or SciPy.

MATLAB stores pairs of cameras. Each camera after the first has a struct with the fields of
`toStruct`, for the pair of the first camera and this one. The struct is `stereoParams` for two
cameras, else `stereoParams_2`, `stereoParams_3`, ...; `stereoParameters(S.stereoParams_2)` creates
the object. Pixels count from 1, matrices are transposed (row vectors: x2 = x1 R + t), and each file
states its unit. Further variables preserve the rig: `camera_names`, `cam1_from_world` (4 x 4), and
`covariance`, in degrees and mm, with its `parameters` and its `matrix`.
"""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import atomic_write
from trinoc.io.formats.format import PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys, Refused
from trinoc.io.formats.lens_rows import LensNumbers, LensRow, list_lens_numbers, make_lens
from trinoc.io.formats.mat_file import mat_variables
from trinoc.io.formats.motions import chain_motions, from_homogeneous, homogeneous, inverse, motion
from trinoc.io.formats.notations import make_block
from trinoc.io.json_document import Block
from trinoc.io.rig_json import parse_covariance

TITLE = "MATLAB's stereoParameters"
UNITS_MM = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 10.0),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1000.0),
    **dict.fromkeys(("in", "inch", "inches"), 25.4),
    **dict.fromkeys(("ft", "foot", "feet"), 304.8),
}
PAIR_KEYS = Keys(
    read=("CameraParameters1", "CameraParameters2", "RotationOfCamera2", "TranslationOfCamera2"),
    left_out=("RectificationParams",),
)
LENS_KEYS = Keys(
    read=(
        *("IntrinsicMatrix", "K", "RadialDistortion", "TangentialDistortion", "ImageSize"),
        "WorldUnits",
    ),
    # `Skew` stands in the matrix, too.
    left_out=(
        *("EstimateSkew", "NumRadialDistortionCoefficients", "EstimateTangentialDistortion"),
        "Skew",
    ),
    refused={
        key: Refused(
            "trinoc does not support Scaramuzza's fisheye model: calibrate with another model"
        )
        for key in ("MappingCoefficients", "StretchMatrix")
    },
)
FIRST_PX = 1.0
VARIABLE = "stereoParams"
RADIAL, TANGENTIAL = ("k1", "k2", "k3"), ("p1", "p2")
ROWS = (LensRow("", "brown_conrady", (*RADIAL, *TANGENTIAL)),)


def write_matlab(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write one struct of stereoParameters for each pair of the first camera and another camera.

    Translations are in units of `unit_mm`. Raise `InputError` for a rig of one camera.
    """
    if len(rig) < 2:
        raise InputError(f"{TITLE} is for two cameras: give a rig of two or more.")
    unit = next((name for name, mm in UNITS_MM.items() if mm == unit_mm), f"{unit_mm!r} mm")
    lenses = [_to_struct(camera.intrinsics, name, unit) for name, camera in rig.items()]
    poses = [np.asarray(camera.cam_from_world) for camera in rig.cameras]
    variables: dict[str, Any] = {
        "camera_names": np.array(rig.names, dtype=object),
        "cam1_from_world": homogeneous(poses[0], unit_mm),
    }
    for number in range(2, len(rig) + 1):
        second_from_first = chain_motions(poses[number - 1], inverse(poses[0]))
        name = VARIABLE if len(rig) == 2 else f"{VARIABLE}_{number}"
        variables[name] = {
            "CameraParameters1": lenses[0],
            "CameraParameters2": lenses[number - 1],
            "RotationOfCamera2": second_from_first[:, :3].T,
            "TranslationOfCamera2": second_from_first[:, 3][None] / unit_mm,
        }
    if rig.parameters:
        parameters = np.array(rig.parameters, dtype=object)
        variables["covariance"] = {"parameters": parameters, "matrix": np.asarray(rig.covariance)}
    with atomic_write(path) as file:
        scipy.io.savemat(file, variables)


def read_matlab(path: Path, unit_mm: float | None, lenses: Lenses | None) -> Rig:
    """Read a rig from one or several structs of stereoParameters.

    Without the variable `cam1_from_world`, the world is the frame of the first camera. `unit_mm` is
    needed only if the file does not state its unit.
    """
    document = make_block(mat_variables(path), path)
    pairs = [name for name in document.values if name.startswith(VARIABLE)]
    if not pairs:
        raise document.error(VARIABLE, "is missing: save toStruct(stereoParams) under that name.")
    blocks = [PAIR_KEYS.take(document.block(name)) for name in pairs]
    units = {
        _stated_unit_mm(block.block(key), unit_mm)
        for block in blocks
        for key in ("CameraParameters1", "CameraParameters2")
    }
    if len(units) > 1:
        raise document.error(VARIABLE, "states two WorldUnits: calibrate both cameras in one.")
    unit_mm = units.pop()
    first_pose = np.eye(3, 4)
    if "cam1_from_world" in document.values:
        matrix = document.numbers("cam1_from_world", (4, 4))
        first_pose = from_homogeneous(matrix, unit_mm, f'{path}: "cam1_from_world"')
    first = _lens(blocks[0].block("CameraParameters1"))
    cameras = [Camera(first, Pose(first_pose))]
    for block in blocks:
        if not _alike(_lens(block.block("CameraParameters1")), first):
            raise block.error("CameraParameters1", "differs between pairs: give pairs of one rig.")
        rotation = block.numbers("RotationOfCamera2", (3, 3)).T
        translation = block.numbers("TranslationOfCamera2", (1, 3))[0] * unit_mm
        where = f'{path}: "{block.place}.RotationOfCamera2"'
        pose = chain_motions(motion(rotation, translation, where), first_pose)
        cameras.append(Camera(_lens(block.block("CameraParameters2")), Pose(pose)))
    names = [f"camera{number}" for number in range(1, len(cameras) + 1)]
    if "camera_names" in document.values:
        names = list(document.texts("camera_names"))
        if len(set(names)) != len(cameras):
            raise document.error("camera_names", f"must be {len(cameras)} different names.")
    named = dict(zip(names, cameras, strict=True))
    parameters, covariance = parse_covariance(document, named)
    return Rig(named, parameters=parameters, covariance=covariance)


def _to_struct(lens: Intrinsics, camera: str, unit: str) -> dict[str, Any]:
    numbers = list_lens_numbers(lens, ROWS, TITLE, camera, origin_px=FIRST_PX, skew=True)
    (fx, fy), (cx, cy) = numbers.focal_px, numbers.centre_px
    radial, tangential = numbers.coefficients[:3], numbers.coefficients[3:]
    terms = 3 if radial[2] else 2
    return {
        "RadialDistortion": np.array([radial[:terms]]),
        "TangentialDistortion": np.array([tangential]),
        "WorldPoints": np.zeros((0, 2)),
        "WorldUnits": unit,
        "EstimateSkew": bool(numbers.skew_px),
        "NumRadialDistortionCoefficients": float(terms),
        "EstimateTangentialDistortion": any(tangential),
        "TranslationVectors": np.zeros((0, 3)),
        "RotationVectors": np.zeros((0, 3)),
        "ReprojectionErrors": np.zeros((0, 2)),
        "ImageSize": np.array([lens.image_size_px[::-1]], dtype=np.float64),
        "IntrinsicMatrix": np.array([[fx, 0, 0], [numbers.skew_px, fy, 0], [cx, cy, 1]]),
    }


def _stated_unit_mm(lens: Block, unit_mm: float | None) -> float:
    """Unit of a file's lengths, in mm.

    `unit_mm` is the unit that the caller gives, or None. Raise `InputError` if the unit is unknown,
    or if file and caller contradict each other.
    """
    stated = lens.values.get("WorldUnits")
    if not stated:
        return 1.0 if unit_mm is None else unit_mm
    name = lens.text("WorldUnits").strip()
    number, _, rest = name.partition(" ")
    file_unit_mm = UNITS_MM.get(name.lower())
    if file_unit_mm is None and rest == "mm":
        with contextlib.suppress(ValueError):
            length_mm = float(number)
            file_unit_mm = length_mm if 0 < length_mm < float("inf") else None
    if file_unit_mm is None and unit_mm is None:
        raise lens.error("WorldUnits", f'is "{name}": give the length of this unit with --unit-mm.')
    if file_unit_mm is not None and unit_mm is not None and unit_mm != file_unit_mm:
        raise lens.error(
            "WorldUnits", f'is "{name}", but --unit-mm is {unit_mm:g}: omit --unit-mm.'
        )
    return file_unit_mm or unit_mm or 1.0


def _lens(lens: Block) -> Intrinsics:
    block = LENS_KEYS.take(lens)
    if "IntrinsicMatrix" in block.values:
        matrix = block.numbers("IntrinsicMatrix", (3, 3)).T
    else:
        matrix = block.numbers("K", (3, 3))
    if matrix[1, 0] or not np.array_equal(matrix[2], (0, 0, 1)):
        raise block.error("IntrinsicMatrix", "must be fx 0 0, skew fy 0, cx cy 1: correct it.")
    radial = block.numbers("RadialDistortion", (1, None))[0]
    tangential = block.numbers("TangentialDistortion", (1, 2))[0]
    if len(radial) > len(RADIAL):
        raise block.error("RadialDistortion", "must have two or three numbers: correct it.")
    coefficients = [*radial, *np.zeros(3 - len(radial)), *tangential]
    size = block.numbers("ImageSize", (1, 2))[0, ::-1]
    size_px = Block({"size": size.tolist()}, block.file, block.place).image_size_px("size")
    numbers = LensNumbers(
        "", (matrix[0, 0], matrix[1, 1]), (matrix[0, 2], matrix[1, 2]), matrix[0, 1], coefficients
    )
    return make_lens(numbers, size_px, ROWS, f'{block.file}: "{block.place}"', origin_px=FIRST_PX)


def _alike(lens: Intrinsics, other: Intrinsics) -> bool:
    return (
        lens.image_size_px == other.image_size_px
        and np.array_equal(lens.focal_length_px, other.focal_length_px)
        and np.array_equal(lens.principal_point_px, other.principal_point_px)
        and np.array_equal(lens.distortion, other.distortion)
    )


matlab = Format(
    name="matlab",
    title=TITLE,
    holds=("rig",),
    reads=("rig",),
    endings=(".mat",),
    states_unit=True,
    frames="pixel (1, 1) is the centre of the top-left pixel; x right, y down, z forward; row "
    "vectors (x R + t)",
    loses=(PIXEL_PITCH,),
    write=write_matlab,
    read=read_matlab,
    keys={"stereoParams": PAIR_KEYS, "CameraParameters1 and 2": LENS_KEYS},
)
