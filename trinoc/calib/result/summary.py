"""Text summary of a calibration: parameters with their sigmas, fits, and notes."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.status import Status
from trinoc.calib.result.camera_pairs import CameraPair
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import IN_SET_NAMES, board_names, list_boards
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.lenses.splined import SPLINE_PARAMETERS
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import PARAMETER_NAMES

if TYPE_CHECKING:
    from trinoc.calib.result.calibration import CalibrationResult, CameraFit


def summarise(result: "CalibrationResult") -> str:
    """Text of a result: a table for images of a sheet, else one paragraph per camera."""
    return _summarise_sheet(result) if _is_of_sheet(result) else _summarise_shots(result)


def _is_of_sheet(result: "CalibrationResult") -> bool:
    return result.target is not None and not result.views


def _summarise_sheet(result: "CalibrationResult") -> str:
    """Text for a sheet: warnings, a table with one row per camera, then advice and notes."""
    values = dict(zip(result.parameters, result.values, strict=True))
    columns = [
        name
        for name in PARAMETER_NAMES
        if any(f"{camera}.{name}" in values for camera in result.rig.names)
    ]
    header = [
        "camera",
        *(name.replace("_deg", " (deg)").replace("_mm", " (mm)") for name in columns),
    ]
    rows = [[*header, "circles", "rms (px)", "noise/floor"]]
    remarks, warnings = [], []
    for camera, status in result.status.items():
        if camera not in result.rig.names:
            remarks.append(f"{camera}: {result.failures.get(camera, status.value)}")
            continue
        fit = result.fits[camera]
        cells = [
            _with_sigma(values[f"{camera}.{name}"], result.sigma(f"{camera}.{name}"))
            for name in columns
        ]
        circles = f"{int(fit.used.sum())} of {len(result.pattern)}"
        rows.append([camera, *cells, circles, f"{fit.rms_px:.4f}", _noise(fit)])
        remarks.extend(f"{camera}: {note}" for note in fit.notes)
        if status is Status.SUSPECT:
            warnings.append(f"SUSPECT {camera}: {fit.notes[0]}")
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    included = ", ".join(("noise", *result.systematics))
    advice = [result.advice] if result.advice else []
    return "\n".join(
        [*warnings, *lines, f"sigmas include {included}.", *advice, *result.notes, *remarks]
    )


def _noise(fit: "CameraFit") -> str:
    """Text "noise / noise floor" of the image, in grey levels."""
    if fit.image is None:
        return "circles only"
    return f"{fit.image.noise:.2f} / {fit.image.noise_floor:.2f}"


def _with_sigma(value: float, sigma: float) -> str:
    """Text "value +- sigma", both rounded to two significant digits of the sigma."""
    if not np.isfinite(sigma) or sigma <= 0:
        return f"{value:.4f} +- ?"
    decimals = max(0, 1 - int(np.floor(np.log10(sigma))))
    return f"{value:.{decimals}f} +- {sigma:.{decimals}f}"


def _summarise_shots(result: "CalibrationResult") -> str:
    """Text for shots or points: one paragraph per camera, then the board, the camera pairs and the
    notes.
    """
    lines = [f"SUSPECT: {result.notes[0]}"] if result.overall_status is Status.SUSPECT else []
    for camera, fit in result.fits.items():
        lines.append(_fit_sentence(result, camera, fit))
        lines += [
            f"  {key:12} {_value(result, name)}"
            for name in result.parameters
            for owner, _, key in (name.rpartition("."),)
            if owner == camera and result.sigma(name) != 0.0 and key not in SPLINE_PARAMETERS
        ]
    lines += [
        f"{name:14} {_value(result, name)}"
        for name in result.parameters
        if name.startswith("board.")
        and name.rpartition(".")[2] not in IN_SET_NAMES
        and result.sigma(name) != 0.0
    ]
    lines += fixed_boards(result)
    if result.views and not result.is_lens:
        lines.append(f"world: {result.world}")
    lines += [_pair_sentence(pair) for pair in result.pairs[: len(result.cameras) - 1]]
    if result.target is not None and not result.is_lens:
        lines.append(
            f"scale: taken from the board, {_extent(result.target)} mm from the first to the last "
            "corner or circle centre; no image can check it"
        )
    if result.is_lens:
        lines += _lens_sentence(result)
    elif result.pixel_sigma is not None:
        lines.append(result.pixel_sigma.sentence)
    if result.halves is not None:
        lines.append(
            f"halves of the shots differ by {result.halves.ratio:.2f} claimed sigmas over "
            f"{result.halves.parameters} parameters (most in {result.halves.worst}: "
            f"{result.halves.worst_ratio:.1f})"
        )
    if result.cross_validation is not None:
        lines.append(result.cross_validation.sentence)
    lines.append(f"sigmas include {', '.join(('noise', *result.systematics))}.")
    lines += [*result.notes, *result.refused]
    lines += [f"{where}: {reason}" for where, reason in result.failures.items()]
    return "\n".join(lines)


def _fit_sentence(result: "CalibrationResult", camera: str, fit: "CameraFit") -> str:
    """Line with the number of observations of one camera, their residuals and their
    sigma factor.
    """
    if result.target is None:
        return f"{camera}: {int(fit.used.sum())} of {len(fit.used)} points, rms {fit.rms_px:.3f} px"
    camera_index = result.cameras.index(camera)
    views = [view for view in result.views if view.camera == camera_index and view.used.any()]
    count = sum(int(view.used.sum()) for view in views)
    kind = "circles" if isinstance(result.target, Pattern) else "corners"
    return (
        f"{camera}: {count} {kind} in {len({view.shot for view in views})} images, "
        f"rms {fit.rms_px:.3f} px, sigmas x {fit.sigma_factor:.2f}"
    )


def _lens_sentence(result: "CalibrationResult") -> list[str]:
    sigma_px = result.field_sigma_px
    sigma_px = sigma_px[np.isfinite(sigma_px)]
    if not len(sigma_px):
        return []
    return [
        f"the lens images a ray to {np.median(sigma_px):.2g} px (one sigma, median over the "
        f"image, a turn of the camera taken out; {sigma_px.max():.2g} px at the worst place)"
    ]


def fixed_boards(result: "CalibrationResult") -> tuple[str, ...]:
    """Sentence on the pose of each board of a set relative to the first board, with sigmas.

    Empty for a single board, or if there is no rig.
    """
    if not result.has_rig or result.target is None:
        return ()
    reference, *others = board_names(result.target)
    return tuple(
        _board_sentence(result, name, reference, pose)
        for name, pose in zip(others, result.reference_from_board[1:], strict=True)
    )


def _pair_sentence(pair: CameraPair) -> str:
    """Line with the baseline and the relative rotation of two cameras, with sigmas."""
    baseline = format_with_sigma(pair.baseline_mm, pair.baseline_sigma_mm)
    if pair.size_sigma_mm > pair.rest_sigma_mm:
        baseline += (
            f" mm ({_two_digits(pair.size_sigma_mm)} by the board's size, "
            f"{_two_digits(pair.rest_sigma_mm)} by everything else)"
        )
    else:
        baseline += " mm"
    turns = ", ".join(
        f"{axis} {format_with_sigma(value, sigma)}"
        for axis, value, sigma in zip("xyz", pair.turn_deg, pair.turn_sigma_deg, strict=True)
    )
    angle = format_with_sigma(pair.angle_deg, pair.angle_sigma_deg)
    return (
        f"{pair.first} to {pair.second}: baseline {baseline}, rotation "
        f"{angle} degrees ({turns} about the axes of {pair.first})"
    )


def _two_digits(value: float) -> str:
    """Text of a positive number with two significant digits, without an exponent."""
    if not (np.isfinite(value) and value > 0.0):
        return "0"
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(value))))}f}"


def _extent(target: AbstractTarget) -> str:
    sides = [np.ptp(board.centres_mm, axis=0) for board in list_boards(target)]
    return ", ".join(" x ".join(f"{side:.6g}" for side in extent) for extent in sides)


def _value(result: "CalibrationResult", name: str) -> str:
    return format_with_sigma(result.value(name), result.sigma(name))


def _board_sentence(
    result: "CalibrationResult",
    name: str,
    reference: str,
    reference_from_board: Float[np.ndarray, "3 4"],
) -> str:
    """Sentence on the position and rotation of the board `name` in the frame of the board
    `reference`.
    """
    pose = Pose(reference_from_board)
    cosine = np.clip(0.5 * (np.trace(pose.rotation) - 1.0), -1.0, 1.0)
    position = ", ".join(
        f"{axis} {format_with_sigma(value, result.sigma(f'board.{name}.{axis}_mm'))}"
        for axis, value in zip("xyz", pose.translation_mm, strict=True)
    )
    turns = ", ".join(f"{result.sigma(f'board.{name}.turn_{axis}_deg'):.2g}" for axis in "xyz")
    return (
        f'"{name}" lies at {position} mm in the frame of "{reference}", turned by '
        f"{np.degrees(np.arccos(cosine)):.2f} degrees (+- {turns} about x, y, z)"
    )


def format_with_sigma(value: float, sigma: float) -> str:
    """Text "value +- sigma", rounded to two significant digits of the sigma.

    Three decimals for a sigma of 0; "not determined" for NaN.
    """
    if not (np.isfinite(value) and np.isfinite(sigma)):
        return "not determined"
    decimals = max(0, 1 - int(np.floor(np.log10(sigma)))) if sigma > 0 else 3
    return f"{value:.{decimals}f} +- {sigma:.{decimals}f}"
