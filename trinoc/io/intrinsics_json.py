"""Lenses as JSON: camera.json and the object "intrinsics" of rig.json.

Also checks that lenses and cameras are physically possible.
"""

import os
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import (
    FOLD_REMEDY,
    Intrinsics,
    describe_fold,
    describe_unusable_fold,
    describe_usable_fold,
)
from trinoc.geometry.lenses.registry import LENS_MODELS, promote_lens
from trinoc.geometry.rig import PARAMETER_NAMES, Rig, find_equal_centres
from trinoc.io.formats.motions import motion
from trinoc.io.json_document import LARGEST, Block, read_document, write_document
from trinoc.numerics.tables import is_covariance

# Focal length over the longer side of the picture: from nearly 180 degrees to a large telescope.
FOCAL_RANGE = (1e-3, 1e5)
# A pixel has a few micrometres; of some detectors for X-rays it has a fifth of a millimetre.
PITCH_RANGE_MM = (1e-4, 0.5)
# The valid radius of a file may differ by this share from that of its coefficients: another
# version may use lenses nearer to the fold.
_SAME_RADIUS = 0.05


def fold_notes(value: Rig | Intrinsics | Mapping[str, Intrinsics]) -> tuple[str, ...]:
    """Return a sentence for each lens whose distortion folds the image but leaves it usable.

    `value` is a lens, a rig, or lenses keyed by camera name.
    """
    if isinstance(value, Intrinsics):
        lenses = {"The distortion of the lens": value}
    else:
        by_camera = (
            {name: camera.intrinsics for name, camera in value.items()}
            if isinstance(value, Rig)
            else value
        )
        lenses = {f'The distortion of "{name}"': lens for name, lens in by_camera.items()}
    folds = {label: describe_usable_fold(lens) for label, lens in lenses.items()}
    return tuple(f"{label} {fold}." for label, fold in folds.items() if fold is not None)


def expect_lens(lens: Intrinsics, where: str) -> Intrinsics:
    """Return the lens, or raise `InputError` if no real lens has such parameters.

    Reasons are a pixel pitch, focal length or principal point of impossible size, or a distortion
    whose fold leaves too little of the image. `where` begins the message.
    """
    expect_pitch(lens.pixel_pitch_mm, f"{where} has pixels of")
    focal_px, side_px = np.asarray(lens.focal_length_px), max(lens.image_size_px)
    low, high = (factor * side_px for factor in FOCAL_RANGE)
    if not ((focal_px >= low) & (focal_px <= high)).all():
        raise InputError(
            f"{where} has a focal length of {focal_px[0]:.4g} x {focal_px[1]:.4g} px for pictures "
            f"{side_px} px wide, which no lens has: check the numbers and their units."
        )
    centre_px = np.asarray(lens.principal_point_px)
    if not (np.abs(centre_px) <= FOCAL_RANGE[1] * side_px).all():
        raise InputError(
            f"{where} has its principal point at {centre_px[0]:.4g}, {centre_px[1]:.4g} px, where "
            "no lens has it: check the numbers and their units."
        )
    fold = describe_unusable_fold(lens)
    if fold is not None:
        raise InputError(f"{where} has a distortion that {fold}: {FOLD_REMEDY}")
    return lens


def expect_pitch(pitch_mm: tuple[float, float] | None, where: str) -> None:
    """Raise `InputError` for a pixel pitch of impossible size, for example in micrometres.

    `where` begins the message.
    """
    if pitch_mm is None or all(PITCH_RANGE_MM[0] <= side <= PITCH_RANGE_MM[1] for side in pitch_mm):
        return
    problem = f"{where} {pitch_mm[0]:g} {pitch_mm[1]:g} mm"
    factor, unit = (1e-3, "micrometres") if max(pitch_mm) > PITCH_RANGE_MM[1] else (1e3, "metres")
    in_mm = [side * factor for side in pitch_mm]
    if all(PITCH_RANGE_MM[0] <= side <= PITCH_RANGE_MM[1] for side in in_mm):
        raise InputError(
            f"{problem}, which looks like {unit}: write {in_mm[0]:g} {in_mm[1]:g} millimetres."
        )
    raise InputError(f"{problem}, which no pixel has: give its width and height in millimetres.")


def expect_readable(value: Rig | Intrinsics, where: str) -> None:
    """Raise `InputError` for lenses, cameras or a covariance that a reader would refuse.

    Writers call this check, so that each file can be read again. `where` begins the message.
    """
    if isinstance(value, Intrinsics):
        expect_lens(value, f"{where}: the lens")
        return
    for name, camera in value.items():
        expect_lens(camera.intrinsics, f'{where}: the camera "{name}"')
        pose = np.asarray(camera.cam_from_world)
        motion(pose[:, :3], pose[:, 3], f'{where}: the pose of the camera "{name}"')
    expect_apart(dict(value.items()), where)
    fault = find_covariance_fault(value.parameters, np.asarray(value.covariance), value.names)
    if fault is not None:
        raise InputError(f'{where}: "covariance.{fault[0]}" {fault[1]}')


def find_covariance_fault(
    parameters: Sequence[str], matrix: Float[np.ndarray, "p p"], cameras: Collection[str]
) -> tuple[str, str] | None:
    """Return the first fault of a rig's covariance, or None if it is valid.

    Parameters
    ----------
    parameters : sequence of str
        Names of the rows of `matrix`.
    matrix : (p, p)
        Covariance.
    cameras : collection of str
        Names of the cameras of the rig.

    Returns
    -------
    (str, str) or None
        Key in the file, "parameters" or "matrix", and the end of the error message.
    """
    for parameter in parameters:
        camera, _, name = parameter.rpartition(".")
        if name in PARAMETER_NAMES and camera not in cameras:
            return (
                "parameters",
                f'names "{parameter}", but there is no camera "{camera}": correct it.',
            )
    if len(set(parameters)) < len(parameters):
        return "parameters", "names a parameter twice: remove one with its row."
    if not np.isfinite(matrix).all():
        return (
            "matrix",
            "is not finite: calibrate so that all parameters are determined, or drop the "
            "covariance.",
        )
    if not ((np.abs(matrix) <= LARGEST).all() and is_covariance(matrix[None]).all()):
        return (
            "matrix",
            "is no covariance (symmetric, nowhere negative): calibrate again, or drop it.",
        )
    return None


def expect_apart(cameras: Mapping[str, Camera], where: str) -> None:
    """Raise `InputError` if two cameras have the same centre, so that depth is unknown.

    `where` begins the message.
    """
    pair = find_equal_centres(cameras)
    if pair is not None:
        raise InputError(
            f'{where}: the cameras "{pair[0]}" and "{pair[1]}" have the same position, so depth is '
            "unknown: calibrate these cameras again, or remove one."
        )


CONVENTIONS = (
    "World: right-handed, mm, Z up out of the sheet Z = 0. Camera: x right, y down, z forward; "
    "x_cam = cam_from_world (X, Y, Z, 1). Pixel (u, v) = (column, row), (0, 0) is the centre of "
    "the top-left pixel. Pan is the azimuth of the camera from -Y toward +X, tilt its elevation "
    "above Z = 0, swing turns the picture's x toward its y, distance is from the point aim of the "
    "sheet, on the optical axis, to the camera's centre. Distortion brown_conrady: k1, k2, p1, "
    "p2, k3 on normalised coordinates; rational and thin_prism: OpenCV's 8 and 12 coefficients; "
    "kannala_brandt: k1 to k4 of OpenCV's fisheye; splined_ before a name: its coefficients, then "
    "the logarithms of half the extent of a grid in focal lengths, and 10 rows of 12 control "
    "points (px) of a cubic B-spline for du, and for dv, by which its pixels are moved. "
    "Covariance: degrees and mm."
)


FORMAT, VERSION = "trinoc-camera", 1


def load_intrinsics(path: str | os.PathLike[str]) -> Intrinsics:
    """Read the lens of a camera.json.

    Raise `InputError`, which names file and key, for invalid content.
    """
    document = read_document(path, FORMAT, VERSION)
    _expect_keys(document)
    return intrinsics_from_block(document.block("intrinsics"), document.image_size_px())


def load_lens_covariance(path: str | os.PathLike[str]) -> np.ndarray | None:
    """Read the covariance (q, q) of the lens parameters from a camera.json; None if it has none.

    Rows are the `parameter_names` of the lens model: fx, fy, cx, cy and the coefficients. For a
    lens without distortion they are those of Brown-Conrady. Raise `InputError` for invalid content.
    """
    document = read_document(path, FORMAT, VERSION)
    _expect_keys(document)
    if "covariance" not in document.values:
        return None
    block = document.block("covariance")
    block.expect_keys(("parameters", "matrix"))
    lens = intrinsics_from_block(document.block("intrinsics"), document.image_size_px()).lens
    names = promote_lens(lens).parameter_names
    if block.texts("parameters") != names:
        raise block.error("parameters", f"must be {', '.join(names)}, in this order.")
    matrix = block.numbers("matrix", (len(names), len(names)))
    if not is_covariance(matrix[None]).all():
        raise block.error(
            "matrix",
            "is no covariance (symmetric, nowhere negative): write the file again.",
        )
    return matrix


def save_intrinsics(
    intrinsics: Intrinsics,
    path: str | os.PathLike[str],
    *,
    covariance: np.ndarray | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write a lens to a camera.json.

    Parameters
    ----------
    intrinsics : Intrinsics
        The lens.
    path : path
        File to write.
    covariance : (q, q), optional
        Covariance of the lens parameters; zero for parameters that were fixed. For a lens without
        distortion the parameters are those of Brown-Conrady.
    provenance : mapping, optional
        Source of the lens, such as the command and its inputs.

    Raises
    ------
    InputError
        If a reader would refuse the lens or the covariance.
    """
    expect_readable(intrinsics, f"{path} was not written")
    if covariance is not None and not is_covariance(np.asarray(covariance)[None]).all():
        raise InputError(
            f"{path} was not written: the covariance of the lens is not a covariance "
            "matrix (finite, symmetric, nowhere negative): calibrate again, or omit the covariance."
        )
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "image_size_px": list(intrinsics.image_size_px),
        "intrinsics": intrinsics_to_block(intrinsics),
    }
    if covariance is not None:
        sigmas, names = np.sqrt(np.diag(covariance)), promote_lens(intrinsics.lens).parameter_names
        document["sigma"] = dict(zip(names, sigmas.tolist(), strict=True))
        document["covariance"] = {
            "parameters": list(names),
            "matrix": np.asarray(covariance).tolist(),
        }
    document["conventions"] = CONVENTIONS
    document["provenance"] = dict(provenance or {})
    write_document(path, document)


def _expect_keys(document: Block) -> None:
    document.expect_keys(
        ("format", "version", "image_size_px", "intrinsics"),
        ("sigma", "covariance", "conventions", "provenance"),
    )


def intrinsics_to_block(intrinsics: Intrinsics) -> dict[str, Any]:
    """Convert a lens to the JSON object "intrinsics".

    If the pixel pitch is known, the object has "focal_length_mm" and "pixel_pitch_mm". It has
    "focal_length_px" if the pitch is unknown, or if the focal lengths along u and v do not give one
    length in mm. "skew_px" is left out if it is 0. "valid_radius_px" exists only if the distortion
    folds inside the image.
    """
    focal_px = np.asarray(intrinsics.focal_length_px, dtype=np.float64)
    block: dict[str, Any] = {}
    pitch_mm = intrinsics.pixel_pitch_mm
    if pitch_mm is not None:
        # Fifteen digits bring back 16 from 16 / 0.0162 * 0.0162.
        focal_mm = float(f"{focal_px[0] * pitch_mm[0]:.15g}")
        if np.allclose(focal_mm / np.array(pitch_mm), focal_px, rtol=1e-15, atol=0):
            block["focal_length_mm"] = focal_mm
        else:
            block["focal_length_px"] = focal_px.tolist()
        block["pixel_pitch_mm"] = list(pitch_mm)
    else:
        block["focal_length_px"] = focal_px.tolist()
    block["principal_point_px"] = np.asarray(intrinsics.principal_point_px).tolist()
    if float(intrinsics.skew_px) != 0:
        block["skew_px"] = float(intrinsics.skew_px)
    block["distortion"] = {
        "model": intrinsics.lens.model,
        "coefficients": np.asarray(intrinsics.lens.coefficients).tolist(),
    }
    if describe_fold(intrinsics) is not None:
        block["valid_radius_px"] = intrinsics.valid_radius_px
    return block


def intrinsics_from_block(block: Block, image_size_px: tuple[int, int]) -> Intrinsics:
    """Convert the JSON object "intrinsics" to a lens. Raise `InputError` for invalid values."""
    block.expect_keys(
        (),
        (
            "focal_length_mm",
            "pixel_pitch_mm",
            "focal_length_px",
            "principal_point_px",
            "skew_px",
            "distortion",
            "valid_radius_px",
        ),
    )
    values, focal_key = block.values, "focal_length_mm"
    model, coefficients = None, None
    if "distortion" in values:
        model, coefficients = _distortion(block.block("distortion"))
    try:
        lens = Intrinsics(
            image_size_px=image_size_px,
            focal_length_mm=block.number(focal_key) if focal_key in values else None,
            pixel_pitch_mm=_pair_or_none(block, "pixel_pitch_mm"),
            focal_length_px=_pair_or_none(block, "focal_length_px"),
            principal_point_px=_pair_or_none(block, "principal_point_px"),
            skew_px=block.number("skew_px") if "skew_px" in values else 0.0,
            distortion=coefficients,
            distortion_model=model,
        )
    except InputError as error:
        if str(error).startswith(block.file):
            raise
        raise InputError(f'{block.file}: "{block.place}": {error}') from error
    expect_lens(lens, f'{block.file}: "{block.place}"')
    if "valid_radius_px" in values:
        _expect_radius(block, lens)
    return lens


def _expect_radius(block: Block, lens: Intrinsics) -> None:
    """Raise `InputError` if "valid_radius_px" differs from the valid radius of the distortion."""
    radius_px = lens.valid_radius_px
    if not abs(block.number("valid_radius_px") - radius_px) <= _SAME_RADIUS * radius_px < np.inf:
        raise block.error(
            "valid_radius_px",
            f"differs from the radius up to which the distortion is one to one, {radius_px:.6g} "
            "px: remove the key, it is only a reading aid.",
        )


def _pair_or_none(block: Block, key: str) -> tuple[float, float] | None:
    if key not in block.values:
        return None
    first, second = block.numbers(key, (2,))
    return float(first), float(second)


def _distortion(block: Block) -> tuple[str, np.ndarray | None]:
    block.expect_keys(("model", "coefficients"))
    model, coefficients = block.text("model"), block.numbers("coefficients", (None,))
    if model not in LENS_MODELS:
        raise block.error("model", f"must be one of {', '.join(LENS_MODELS)}.")
    if LENS_MODELS[model].coefficient_names:
        return model, coefficients
    if coefficients.any():
        raise block.error(
            "coefficients",
            f'must be empty for the model "{model}": name the lens model of these coefficients.',
        )
    return model, None
