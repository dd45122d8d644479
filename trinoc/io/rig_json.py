"""rig.json: cameras, their covariance, and the status of the calibration."""

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trinoc.errors import InputError, list_names
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig, is_camera_name
from trinoc.io.atomic import read_text
from trinoc.io.formats.motions import checked_rotation
from trinoc.io.intrinsics_json import (
    CONVENTIONS,
    expect_apart,
    expect_readable,
    find_covariance_fault,
    intrinsics_from_block,
    intrinsics_to_block,
    load_intrinsics,
    load_lens_covariance,
)
from trinoc.io.json_document import (
    Block,
    document_text,
    parsed_json,
    read_document,
    write_document,
)

if TYPE_CHECKING:
    from trinoc.calib.result.calibration import CalibrationResult


CONVERGED = "converged"


class CameraStatus(NamedTuple):
    """Status of one camera's calibration.

    Attributes
    ----------
    status : str
        Status of the fit: "converged", "suspect" or another.
    notes : tuple of str
        Sentences for the user.
    """

    status: str
    notes: tuple[str, ...]


class RigStatus(NamedTuple):
    """Status of the calibration that wrote a rig.json. Empty fields if no calibration wrote it.

    Attributes
    ----------
    cameras : dict of CameraStatus
        Status of each camera that was calibrated.
    sigmas_include : tuple of str
        Names of the error sources that the covariance includes, such as "noise".
    """

    cameras: dict[str, CameraStatus]
    sigmas_include: tuple[str, ...]

    @property
    def doubts(self) -> dict[str, str]:
        """Reason for each camera whose status is not "converged", keyed by camera name."""
        return {
            name: camera.notes[0] if camera.notes else "its calibration gives no reason."
            for name, camera in self.cameras.items()
            if camera.status != CONVERGED
        }


def status_of_names(
    status: RigStatus, names: Sequence[str], *, sigmas: bool
) -> dict[str, Any] | None:
    """Object "status" of a new rig.json for the cameras `names`, from another file's status.

    `sigmas` is True if the new file has the covariance of the other file. None if no calibration
    reported a status of these cameras.
    """
    cameras = {
        name: {"status": status.cameras[name].status, "notes": list(status.cameras[name].notes)}
        for name in names
        if name in status.cameras
    }
    included = list(status.sigmas_include) if sigmas else []
    return {"cameras": cameras, "sigmas_include": included} if cameras else None


def status_to_block(result: "CalibrationResult") -> dict[str, Any]:
    """Convert the status of a calibration result to the JSON object "status"."""
    return {
        "cameras": {
            name: {
                "status": result.status[name].name.lower(),
                "notes": list(result.fits[name].notes or result.notes),
            }
            for name in result.rig.names
        },
        "sigmas_include": ["noise", *result.systematics],
    }


def status_of_document(document: Block) -> RigStatus:
    """Read the object "status" of a rig.json; empty fields if there is none.

    Raise `InputError` for invalid values.
    """
    if "status" not in document.values:
        return RigStatus({}, ())
    block = document.block("status")
    block.expect_keys(("cameras",), ("sigmas_include",))
    cameras = {}
    for name, camera in block.block("cameras").blocks():
        camera.expect_keys(("status",), ("notes",))
        notes = camera.texts("notes") if "notes" in camera.values else ()
        cameras[name] = CameraStatus(camera.text("status"), notes)
    included = block.texts("sigmas_include") if "sigmas_include" in block.values else ()
    return RigStatus(cameras, included)


FORMAT, VERSION = "trinoc-rig", 1
EXTRINSIC_KEYS = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm", "aim_mm")

# Numbers rounded by hand may differ this much, in a rotation entry and per mm of distance.
_CONSISTENT = 1e-6


def load_rig(path: str | os.PathLike[str]) -> Rig:
    """Read a rig.json with its covariance.

    Parameters
    ----------
    path : path
        File to read. Each camera has "extrinsics", "cam_from_world", or both if they agree.

    Returns
    -------
    Rig

    Raises
    ------
    InputError
        If the content is invalid. The message names file and key.
    """
    document = read_document(path, FORMAT, VERSION)
    document.expect_keys(
        ("format", "version", "cameras"), ("covariance", "status", "conventions", "provenance")
    )
    cameras = {name: _camera(block) for name, block in document.block("cameras").blocks()}
    if not cameras:
        raise document.error("cameras", "names no camera: add at least one.")
    for name in cameras:
        if not is_camera_name(name):
            problem = "is no name of printable characters: rename the camera."
            raise InputError(f'{document.file}: the key {name!r} of "cameras" {problem}')
    status_of_document(document)
    parameters, covariance = parse_covariance(document, cameras)
    expect_apart(cameras, document.file)
    rig = Rig(cameras, parameters=parameters, covariance=covariance)
    for name, block in document.block("cameras").blocks():
        if "sigma" in block.values:
            _check_sigma(block.block("sigma"), _sigmas(rig, name))
    return rig


class KnownLens(NamedTuple):
    """A lens with the covariance of its parameters.

    Attributes
    ----------
    intrinsics : Intrinsics
        The lens.
    covariance : (q, q) or None
        Covariance of the parameters of the lens model; None if the file has none. For a lens
        without distortion the parameters are those of Brown-Conrady.
    """

    intrinsics: Intrinsics
    covariance: np.ndarray | None


def load_lens(path: str | os.PathLike[str], camera: str | None = None) -> KnownLens:
    """Read a lens from a camera.json, or the lens of one camera from a rig.json.

    `camera` is the name of the camera in the rig. It may be None if the rig has only one. Raise
    `InputError` for invalid content, or if the rig has no such camera.
    """
    values = parsed_json(read_text(path), path)
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        return KnownLens(load_intrinsics(path), load_lens_covariance(path))
    rig = load_rig(path)
    name = camera if camera in tuple(rig) else next(iter(rig)) if len(rig) == 1 else None
    if name is None:
        raise InputError(
            f"{path} is a rig of {list_names(rig)}, "
            + ("a lens is that of one: " if camera is None else f'none of which is "{camera}": ')
            + "write NAME=rig.json with one of these names, or give a camera.json."
        )
    lens = rig[name].intrinsics
    names = [f"{name}.{each}" for each in promote_lens(lens.lens).parameter_names]
    rows_known = [row for row, each in enumerate(names) if each in rig.parameters]
    if not rows_known:
        return KnownLens(lens, None)
    rows = [rig.parameters.index(names[row]) for row in rows_known]
    covariance = np.zeros((len(names), len(names)))
    covariance[np.ix_(rows_known, rows_known)] = np.asarray(rig.covariance)[np.ix_(rows, rows)]
    return KnownLens(lens, covariance)


def load_rig_status(path: str | os.PathLike[str]) -> RigStatus:
    """Read the status of the calibration that wrote a rig.json.

    Raise `InputError` for invalid content.
    """
    return status_of_document(read_document(path, FORMAT, VERSION))


def save_rig(
    rig: Rig,
    path: str | os.PathLike[str],
    *,
    provenance: Mapping[str, Any] | None = None,
    status: Mapping[str, Any] | None = None,
) -> None:
    """Write a rig.json.

    Parameters
    ----------
    rig : Rig
        The rig.
    path : path
        File to write.
    provenance : mapping, optional
        Source of the rig, such as the command and its inputs.
    status : mapping, optional
        The object "status" of `status_to_block`.

    Raises
    ------
    InputError
        If `load_rig` would refuse a lens, a camera or the covariance.
    """
    expect_readable(rig, f"{path} was not written")
    write_document(path, _rig_to_values(rig, provenance, status))


def rig_text(rig: Rig) -> str:
    """Text of a rig.json without status and provenance; equal rigs give equal texts."""
    return document_text(_rig_to_values(rig, None, None))


def _rig_to_values(
    rig: Rig, provenance: Mapping[str, Any] | None, status: Mapping[str, Any] | None
) -> dict[str, Any]:
    covariance = np.asarray(rig.covariance, dtype=np.float64)
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "cameras": {name: _camera_to_block(rig, name) for name in rig},
    }
    if rig.parameters:
        document["covariance"] = {
            "parameters": list(rig.parameters),
            "matrix": covariance.tolist(),
        }
    if status is not None:
        document["status"] = dict(status)
    document["conventions"] = CONVENTIONS
    document["provenance"] = dict(provenance or {})
    return document


def _camera_to_block(rig: Rig, name: str) -> dict[str, Any]:
    camera = rig[name]
    # A rotation rounded to a few digits is brought to the nearest one: extrinsics and matrix agree.
    pose = np.asarray(camera.cam_from_world)
    rotation = checked_rotation(pose[:, :3], f'The pose of the camera "{name}"')
    if (rotation != pose[:, :3]).any():
        camera = Camera(camera.intrinsics, Pose(np.column_stack([rotation, pose[:, 3]])))
    block: dict[str, Any] = {
        "image_size_px": list(camera.image_size_px),
        "intrinsics": intrinsics_to_block(camera.intrinsics),
    }
    extrinsics = {key: getattr(camera, key) for key in EXTRINSIC_KEYS}
    # A camera whose axis does not meet the sheet in front of it has only a matrix.
    if np.isfinite(extrinsics["distance_mm"]):
        block["extrinsics"] = {**extrinsics, "aim_mm": list(extrinsics["aim_mm"])}
    sigmas = _sigmas(rig, name)
    if sigmas:
        block["sigma"] = sigmas
    block["cam_from_world"] = np.asarray(camera.cam_from_world).tolist()
    return block


def _sigmas(rig: Rig, name: str) -> dict[str, float]:
    """Standard deviation of each parameter of one camera, keyed by name, such as "pan_deg"."""
    split_names = ((parameter, *parameter.rpartition(".")) for parameter in rig.parameters)
    return {
        key: rig.sigma(parameter) for parameter, camera, _, key in split_names if camera == name
    }


def _camera(block: Block) -> Camera:
    block.expect_keys(("image_size_px", "intrinsics"), ("extrinsics", "sigma", "cam_from_world"))
    intrinsics = intrinsics_from_block(block.block("intrinsics"), block.image_size_px())
    if "extrinsics" not in block.values and "cam_from_world" not in block.values:
        raise block.error("extrinsics", "is missing: add it, or cam_from_world.")
    if "cam_from_world" not in block.values:
        extrinsics = _extrinsics(block.block("extrinsics"))
        return Camera.from_degrees(intrinsics, **extrinsics)
    camera = Camera(intrinsics, Pose(_rigid_motion(block)))
    if "extrinsics" in block.values:
        extrinsics = _extrinsics(block.block("extrinsics"))
        _check_consistent(block, camera, Camera.from_degrees(intrinsics, **extrinsics))
    return camera


def _extrinsics(block: Block) -> dict[str, Any]:
    block.expect_keys(("pan_deg", "tilt_deg", "swing_deg", "distance_mm"), ("aim_mm",))
    numbers = {key: block.number(key) for key in EXTRINSIC_KEYS if key != "aim_mm"}
    if numbers["distance_mm"] <= 0:
        raise block.error("distance_mm", "must be positive: it is a distance in mm.")
    aim = block.numbers("aim_mm", (2,)) if "aim_mm" in block.values else (0.0, 0.0)
    return {**numbers, "aim_mm": (float(aim[0]), float(aim[1]))}


def _rigid_motion(block: Block) -> np.ndarray:
    matrix = block.numbers("cam_from_world", (3, 4))
    try:
        rotation = checked_rotation(matrix[:, :3], "cam_from_world")
    except InputError as error:
        raise block.error(
            "cam_from_world",
            "must be [R | t] with a rotation R, but its first three columns are not a rotation: "
            "correct them, or remove the key if extrinsics are given.",
        ) from error
    return np.column_stack([rotation, matrix[:, 3]])


def _check_consistent(block: Block, camera: Camera, other: Camera) -> None:
    difference = np.abs(np.asarray(camera.cam_from_world) - np.asarray(other.cam_from_world))
    distance_mm = np.linalg.norm(other.centre_world_mm)
    if difference[:, :3].max() > _CONSISTENT or difference[:, 3].max() > _CONSISTENT * max(
        float(distance_mm), 1.0
    ):
        raise block.error(
            "extrinsics",
            "and cam_from_world describe different cameras: remove the wrong one of the two.",
        )


def parse_covariance(
    document: Block, cameras: Mapping[str, Camera]
) -> tuple[tuple[str, ...], np.ndarray | None]:
    """Read the object "covariance": (parameter names, matrix); ((), None) if there is none.

    Raise `InputError` for invalid values.
    """
    if "covariance" not in document.values:
        return (), None
    block = document.block("covariance")
    block.expect_keys(("parameters", "matrix"))
    parameters = block.texts("parameters")
    matrix = block.numbers("matrix", (len(parameters), len(parameters)))
    fault = find_covariance_fault(parameters, matrix, cameras)
    if fault is not None:
        raise block.error(*fault)
    return parameters, matrix


def _check_sigma(block: Block, expected: Mapping[str, float]) -> None:
    for key in block.values:
        if key not in expected:
            raise block.error(
                key, "has no row in the covariance: add the row, or remove this sigma."
            )
        if abs(block.number(key) - expected[key]) > 1e-3 * expected[key]:
            raise block.error(
                key,
                f"differs from the covariance, which gives {expected[key]:.6g}: remove this sigma, "
                "which is only for readers.",
            )
