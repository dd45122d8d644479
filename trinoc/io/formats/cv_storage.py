"""OpenCV's FileStorage, as YAML or JSON, with the keys of OpenCV's calibration samples.

A lens has the keys `camera_matrix`, `distortion_coefficients`, `image_width` and `image_height`,
and `fisheye_model: 1` for `cv2.fisheye`. A rig has a list `cameras`. Each entry has these keys, a
`name`, and `R` and `T` of x_cam = R x_world + T. A rig of two cameras also has the keys of
`cv2.stereoRectify`: `M1`, `D1`, `M2`, `D2`, and `R`, `T` from the first to the second camera. All
three forms are read. The covariance of a rig is stored under `covariance`, in degrees and mm, as in
rig.json.
"""

import itertools
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import MOST_BYTES, write_text
from trinoc.io.formats.format import PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys, Refused
from trinoc.io.formats.lens_rows import list_lens_numbers
from trinoc.io.formats.motions import chain_motions, inverse, motion
from trinoc.io.formats.notations import Notation, make_block, parse_file
from trinoc.io.formats.opencv_lens import (
    FISHEYE,
    WRITTEN,
    flat_numbers,
    matrix_of_numbers,
    read_opencv_lens,
)
from trinoc.io.formats.text_files import scalar_or_list
from trinoc.io.images import silent_opencv
from trinoc.io.json_document import Block, show_value
from trinoc.io.rig_json import parse_covariance

TITLE = "OpenCV's FileStorage"
# Words of other programs that write FileStorage, by the row of lenses.
_LENS_WORDS = {
    **dict.fromkeys(("fisheye", "equidistant", "kannala_brandt"), FISHEYE.called),
    **dict.fromkeys(
        ("", "pinhole", "perspective", "opencv", "brown_conrady", "radtan", "plumb_bob",
         "rational_polynomial", "brown-conrady", "standard"), ""
    ),
}  # fmt: skip
_WORD_KEYS = ("distortion_model", "camera_model", "model", "lens_model")
# As FileStorage gives a number, and in words.
_YES, _NO = ("1", "1.0", "true", "yes", "on"), ("0", "0.0", "false", "no", "off")
_FISHEYE_KEYS = ("fisheye_model", "fisheye", "is_fisheye")
_MATRIX_KEYS = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K")
_DISTORTION_KEYS = (
    *("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D"),
)
_WIDTH_KEYS = ("image_width", "image_Width")
_HEIGHT_KEYS = ("image_height", "image_Height")
_NO_MIRROR = (
    "it is the mirror parameter of cv2.omnidir's unified model, which trinoc does not support: "
    "calibrate with cv2.fisheye"
)
_REFUSED = {
    **{key: Refused(_NO_MIRROR, (0, [[0]])) for key in ("xi", "xi1", "xi2", "Xi")},
    **{
        key: Refused("trinoc does not support this parameter: calibrate without it", (0, [[0]]))
        for key in ("alpha", "skew")
    },
}
# What samples of OpenCV say of the board and of how they calibrated.
_LEFT_OUT = (
    "rectification_matrix",
    "projection_matrix",
    "fix_k3",
    "fix_aspect_ratio",
    "image_scale",
    "units",
    "unit",
    "square_unit",
)
LENS_KEYS = Keys(
    read=(
        *("name", "R", "T", *_MATRIX_KEYS, *_DISTORTION_KEYS, *_WIDTH_KEYS, *_HEIGHT_KEYS),
        *(*_FISHEYE_KEYS, *_WORD_KEYS),
    ),
    left_out=_LEFT_OUT,
    refused=_REFUSED,
)
_STEREO = tuple(
    (f"{matrix}1", f"{distortion}1", f"{matrix}2", f"{distortion}2")
    for matrix, distortion in itertools.product(("M", "K", "cameraMatrix"), ("D", "distCoeffs"))
)


PAIR_KEYS = Keys(
    read=(
        *("cameras", "covariance", "R", "T", *dict.fromkeys(itertools.chain(*_STEREO))),
        *(*_WIDTH_KEYS, *_HEIGHT_KEYS, *_FISHEYE_KEYS, *_WORD_KEYS),
    ),
    # cv2.stereoRectify's: of rectified pictures, R, T, M and D are those of the raw ones.
    left_out=(*_LEFT_OUT, "P1", "P2", "R1", "R2", "rectified_roi1", "rectified_roi2",
              "roi1", "roi2", "validRoi1", "validRoi2", "valid_roi1", "valid_roi2"),
    refused=_REFUSED,
)  # fmt: skip


def write_opencv(value: Rig | Intrinsics, path: Path, unit_mm: float) -> None:
    """Write a lens or a rig as a FileStorage file; translations are in units of `unit_mm`."""
    if isinstance(value, Intrinsics):
        document = _lens_to_map(value, "")
    else:
        cameras = [
            {
                "name": name,
                **_lens_to_map(camera.intrinsics, name),
                "R": np.asarray(camera.cam_from_world)[:, :3],
                "T": np.asarray(camera.cam_from_world)[:, 3:] / unit_mm,
            }
            for name, camera in value.items()
        ]
        document = {"cameras": cameras, **_stereo(value, cameras, unit_mm), **_covariance(value)}
    write_storage(document, path)


def read_opencv(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig | Intrinsics:
    """Read a rig, or a lens if the file contains no poses."""
    document = read_storage(path)
    if "cameras" in document.values:
        return _list_cameras(PAIR_KEYS.take(document), unit_mm)
    # With its distortion where the file has one: without, the lenses are ideal.
    for keys in sorted(_STEREO, key=lambda keys: keys[1] not in document.values):
        if keys[0] in document.values:
            return _pair(PAIR_KEYS.take(document), keys, unit_mm)
    if not any(key in document.values for key in _MATRIX_KEYS):
        raise document.error(
            "camera_matrix", "is missing, and so are cameras and M1: give a calibration file."
        )
    return _lens_from_map(LENS_KEYS.take(document))


def _lens_to_map(lens: Intrinsics, camera: str) -> dict[str, Any]:
    numbers = list_lens_numbers(lens, WRITTEN, TITLE, camera)
    return {
        "image_width": lens.image_size_px[0],
        "image_height": lens.image_size_px[1],
        "camera_matrix": np.array(matrix_of_numbers(numbers)),
        "distortion_coefficients": np.array([numbers.coefficients]),
        **({"fisheye_model": 1} if numbers.called == FISHEYE.called else {}),
    }


def _stereo(rig: Rig, cameras: list[dict[str, Any]], unit_mm: float) -> dict[str, Any]:
    """Entries M1, D1, M2, D2, R, T of OpenCV's stereo sample for a rig of two cameras.

    Empty for other rigs, and for fisheye lenses, which these keys cannot describe.
    """
    if len(cameras) != 2 or any("fisheye_model" in camera for camera in cameras):
        return {}
    poses = [np.asarray(camera.cam_from_world) for camera in rig.cameras]
    second_from_first = chain_motions(poses[1], inverse(poses[0]))
    return {
        "M1": cameras[0]["camera_matrix"],
        "D1": cameras[0]["distortion_coefficients"],
        "M2": cameras[1]["camera_matrix"],
        "D2": cameras[1]["distortion_coefficients"],
        "image_width": cameras[0]["image_width"],
        "image_height": cameras[0]["image_height"],
        "R": second_from_first[:, :3],
        "T": second_from_first[:, 3:] / unit_mm,
    }


def _covariance(rig: Rig) -> dict[str, Any]:
    if not rig.parameters:
        return {}
    matrix = np.asarray(rig.covariance, dtype=np.float64)
    return {"covariance": {"parameters": list(rig.parameters), "matrix": matrix}}


def _list_cameras(document: Block, unit_mm: float) -> Rig:
    entries = document.values["cameras"]
    if not isinstance(entries, list) or not entries:
        raise document.error("cameras", "must be a list of cameras: add one at least.")
    cameras: dict[str, Camera] = {}
    for number, entry in enumerate(entries):
        block = Block({"": entry}, document.file, "cameras").block("")
        block = LENS_KEYS.take(Block(block.values, document.file, f"cameras[{number}]"))
        name = block.text("name")
        if name in cameras:
            raise block.error(
                "name",
                f'is "{name}", the name of an earlier camera: rename one of the two cameras.',
            )
        lens = _lens_from_map(block)
        cameras[name] = Camera(lens, Pose(_pose(block, unit_mm)))
    parameters, covariance = parse_covariance(document, cameras)
    return Rig(cameras, parameters=parameters, covariance=covariance)


def _pair(document: Block, keys: tuple[str, str, str, str], unit_mm: float) -> Rig:
    first = _lens_from_map(document, keys[0], keys[1])
    second = _lens_from_map(document, keys[2], keys[3])
    left = Camera(first, Pose(np.eye(3, 4)))
    return Rig({"left": left, "right": Camera(second, Pose(_pose(document, unit_mm)))})


def _pose(block: Block, unit_mm: float) -> np.ndarray:
    translation = flat_numbers(block, "T")
    if translation.shape != (3,):
        raise block.error("T", "must have three numbers: correct it.")
    return motion(block.numbers("R", (3, 3)), translation * unit_mm, f'{block.file}: "R"')


def _lens_from_map(
    block: Block,
    matrix_key: str | None = None,
    distortion_key: str | None = None,
) -> Intrinsics:
    """Read a lens from a YAML map that contains its matrix and distortion coefficients.

    Default keys are those that OpenCV and other programs use for one camera.
    """
    matrix_key = matrix_key or _first_key(block, _MATRIX_KEYS)
    distortion_key = distortion_key or _first_key(block, _DISTORTION_KEYS)
    side_keys = [_first_key(block, keys) for keys in (_WIDTH_KEYS, _HEIGHT_KEYS)]
    for key in side_keys:
        if key not in block.values:
            raise block.error(
                key, "is missing: add the width and the height of the pictures in px."
            )
    sides = [block.number(key) for key in side_keys]
    size = Block({"size": sides}, block.file, block.place).image_size_px("size")
    return read_opencv_lens(block, matrix_key, distortion_key, size, _called(block), block.file)


def _first_key(block: Block, keys: tuple[str, ...]) -> str:
    """Return the first of several keys that `block` contains, or keys[0] if it contains none."""
    return next((key for key in keys if key in block.values), keys[0])


def _called(block: Block) -> str:
    """Name of the lens model in `opencv_lens.READ`: "fisheye", or "" for the other models.

    OpenCV has no key for the model, but other programs add one. Raise `InputError` for unknown or
    contradicting names.
    """
    named: dict[str, str] = {}
    for key in _FISHEYE_KEYS:
        if key in block.values:
            word = str(block.values[key]).lower()
            if word not in (*_YES, *_NO):
                raise block.error(key, f"is {show_value(block.values[key])}: write 1 or 0.")
            named[key] = FISHEYE.called if word in _YES else ""
    for key in _WORD_KEYS:
        if key in block.values:
            word = block.text(key)
            if word.lower() not in _LENS_WORDS:
                models = ", ".join(filter(None, _LENS_WORDS))
                raise block.error(key, f'is "{word}", but trinoc reads {models} here: convert it.')
            named[key] = _LENS_WORDS[word.lower()]
    if len(set(named.values())) > 1:
        first, second = list(named)[:2]
        raise block.error(
            second, f"belongs to another lens model than {first}: correct one of the two."
        )
    return next(iter(named.values()), "")


opencv = Format(
    name="opencv",
    title=TITLE,
    holds=("rig", "lens"),
    reads=("rig", "lens"),
    endings=(".yml", ".yaml", ".json"),
    loses=(PIXEL_PITCH,),
    write=write_opencv,
    read=read_opencv,
    keys={"one lens, or cameras[]": LENS_KEYS, "two cameras, or the file": PAIR_KEYS},
)


def write_storage(document: dict[str, Any], path: Path) -> None:
    """Write a dictionary for `cv2.FileStorage`, as JSON if the file ends in .json, else as YAML.

    NumPy arrays become OpenCV matrices.
    """
    as_json = path.suffix.lower() == ".json"
    write_text(path, _json(document) if as_json else "%YAML:1.0\n---\n" + _yaml(document, ""))


def read_storage(path: Path) -> Block:
    """Read a file of `cv2.FileStorage` as a `Block`; matrices become lists of rows.

    Raise `InputError` if OpenCV cannot read the file.
    """
    return make_block(parse_file(path, STORAGE), path)


def _parse_storage(text: str) -> Any:
    with silent_opencv():
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        values = _plain(storage.root())
        storage.release()
    return values


STORAGE = Notation(
    "a file of cv2.FileStorage (YAML or JSON)", _parse_storage, (cv2.error, SystemError), MOST_BYTES
)


def _plain(node: Any) -> Any:
    if node.isMap():
        keys = node.keys()
        if {"rows", "cols", "dt", "data"} <= set(keys):
            matrix = node.mat()
            return None if matrix is None else np.atleast_2d(matrix).tolist()
        return {key: _plain(node.getNode(key)) for key in keys}
    if node.isSeq():
        return [_plain(node.at(index)) for index in range(node.size())]
    if node.isString():
        return node.string()
    return node.real() if node.isInt() or node.isReal() else None


def _yaml(values: dict[str, Any], indent: str) -> str:
    lines = []
    for key, value in values.items():
        if isinstance(value, dict):
            lines.append(f"{indent}{key}:\n{_yaml(value, indent + '   ')}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            inner = indent + "      "
            items = (f"{indent}   -\n{_yaml(item, inner)}" for item in value)
            lines.append(f"{indent}{key}:\n{''.join(items)}")
        elif isinstance(value, np.ndarray):
            data = scalar_or_list(value.ravel().tolist())
            lines.append(
                f"{indent}{key}: !!opencv-matrix\n{indent}   rows: {value.shape[0]}\n"
                f"{indent}   cols: {value.shape[1]}\n{indent}   dt: d\n{indent}   data: {data}\n"
            )
        else:
            lines.append(f"{indent}{key}: {scalar_or_list(value)}\n")
    return "".join(lines)


def _json(document: dict[str, Any]) -> str:
    def matrix(value: np.ndarray) -> dict[str, Any]:
        rows, columns = value.shape
        data = value.ravel().tolist()
        return {"type_id": "opencv-matrix", "rows": rows, "cols": columns, "dt": "d", "data": data}

    return json.dumps(document, default=matrix, indent=2, ensure_ascii=False) + "\n"
