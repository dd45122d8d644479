"""Comparison of a calibration with an earlier one: moved cameras and swapped images."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.propagation import field_grid_px, projection_sigma
from trinoc.errors import list_names
from trinoc.geometry.camera import Camera
from trinoc.geometry.projection import project_points, unproject_pixels
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.numerics.tails import chi_square_tail, normal_limit

# numerical: smaller tails lose digits before they are zero.
_LEAST_TAIL = 1e-304


class CameraChange(NamedTuple):
    """Change of one camera between two calibrations.

    Attributes
    ----------
    moved_mm : displacement of the centre of projection.
    turned_deg : angle of the rotation between both orientations.
    sigmas : significance of the change, in sigmas, from the covariances of both calibrations; NaN
        without covariances.
    moved : whether the change is significant.
    field_px : root mean square distance, over the image, between the pixels of the same 3-D points
        in both calibrations. The points are as far from the camera as the origin of the world. NaN
        if the image sizes differ, or if the camera is at the origin.
    field_sigmas : root mean square of these distances divided by their standard deviations; 1 on
        average if the camera did not change, NaN without covariances.
    """

    moved_mm: float
    turned_deg: float
    sigmas: float
    moved: bool
    field_px: float
    field_sigmas: float


class RigComparison(NamedTuple):
    """Comparison of two calibrations of a rig.

    Attributes
    ----------
    cameras : change of each camera that both rigs have, by name.
    swapped : pairs (name, other name): the camera stands at the earlier pose of the other camera,
        so that their images were probably exchanged.
    sentences : sentences for the user. There is always at least one.
    """

    cameras: dict[str, CameraChange]
    swapped: tuple[tuple[str, str], ...]
    sentences: tuple[str, ...]


def compare_rigs(
    result: CalibrationResult | Rig,
    earlier: CalibrationResult | Rig,
    *,
    tuning: CalibTuning = TUNING,
) -> RigComparison:
    """Compare a calibration with an earlier one from the same sheet, to find cameras that moved.

    The sheet must not have moved in between, since it defines the world.

    Parameters
    ----------
    result, earlier : new and earlier calibration, or their rigs.
    tuning : constants of calibration; a benchmark or a study changes them.

    Returns
    -------
    The change of each camera that both rigs have, the exchanged images, and sentences on both.

    Notes
    -----
    Errors that both calibrations have in common, for instance those of the same sheet or lens,
    cancel in the change. The sigmas nevertheless contain them and are therefore upper bounds.
    """
    now = result.rig if isinstance(result, CalibrationResult) else result
    before = earlier.rig if isinstance(earlier, CalibrationResult) else earlier
    common = [name for name in now if name in before.names]
    cameras = {name: _change(now, before, name, tuning) for name in common}
    swapped = _find_swaps(now, before, common, tuning)
    sentences = [
        f'Camera "{name}" stands at the earlier pose of "{other}": the images were swapped.'
        for name, other in swapped
    ]
    exchanged = {name for name, _ in swapped}
    moved = [name for name in common if cameras[name].moved and name not in exchanged]
    for name in moved:
        change = cameras[name]
        size = "" if np.isnan(change.sigmas) else f" ({change.sigmas:.1f} sigma)"
        sentences.append(
            f'Camera "{name}" moved by {change.moved_mm:.3f} mm and turned by '
            f"{change.turned_deg:.4f} deg{size}."
        )
    if len(common) > 1 and len(moved) == len(common):
        sentences.append("Every camera changed: the sheet may have moved instead.")
    for name in common:
        one, other = (" x ".join(map(str, rig[name].image_size_px)) for rig in (now, before))
        if one != other:
            sentences.append(
                f'The images of "{name}" have {one} px, but the images for the earlier rig had '
                f"{other} px."
            )
    new, missing = ([name for name in rig if name not in common] for rig in (now, before))
    if new:
        sentences.append("{} {} not in the earlier rig.".format(*_subject(new)))
    if missing:
        sentences.append("{} of the earlier rig {} missing.".format(*_subject(missing)))
    return RigComparison(cameras, swapped, tuple(sentences or ["No camera moved."]))


def _subject(names: Sequence[str]) -> tuple[str, str]:
    """Subject and verb for a sentence about one or several cameras."""
    return (f'Camera "{names[0]}"', "is") if len(names) == 1 else (list_names(names), "are")


def _change(now: Rig, before: Rig, name: str, tuning: CalibTuning) -> CameraChange:
    moved_mm, turned_deg = _displacement_and_rotation(now[name], before[name])
    sigmas = _sigmas_of_change(now, before, name)
    limits = tuning.rig_check
    is_large = moved_mm > limits.quiet_mm or turned_deg > limits.quiet_deg
    moved = is_large if np.isnan(sigmas) else sigmas > limits.moved_sigmas
    field_px, field_sigmas = _change_over_field(now, before, name)
    return CameraChange(moved_mm, turned_deg, sigmas, moved, field_px, field_sigmas)


def _change_over_field(now: Rig, before: Rig, name: str) -> tuple[float, float]:
    """Root mean square change of pixels over the image of one camera, in px and in sigmas.

    now, before : new and earlier rig. name : name of the camera.
    """
    one, other = now[name], before[name]
    distance_mm = float(np.linalg.norm(other.centre_world_mm))
    if one.image_size_px != other.image_size_px or not distance_mm > 0:
        return float("nan"), float("nan")
    pixels = field_grid_px(other.image_size_px).reshape(-1, 2)
    rays = np.asarray(unproject_pixels(other.intrinsics.lens, pixels))
    points = other.centre_world_mm + distance_mm * rays @ np.asarray(other.pose.rotation)
    images = np.asarray(project_points(one.pose, one.intrinsics.lens, points))
    squared = np.sum((images - pixels) ** 2, axis=1)
    is_imaged = np.isfinite(squared)
    if not (now.parameters and before.parameters):
        return float(np.sqrt(np.mean(squared[is_imaged]))), float("nan")
    variance = sum(projection_sigma(rig, name, distance_mm).sigma_px ** 2 for rig in (now, before))
    has_sigma = is_imaged & (np.asarray(variance) > 0)
    if not has_sigma.any():
        return float(np.sqrt(np.mean(squared[is_imaged]))), float("nan")
    over_variance = squared[has_sigma] / (2 * np.asarray(variance)[has_sigma])
    return float(np.sqrt(np.mean(squared[is_imaged]))), float(np.sqrt(np.mean(over_variance)))


def _displacement_and_rotation(first: Camera, second: Camera) -> tuple[float, float]:
    """Distance between the centres of two cameras, mm, and angle between their orientations,
    degrees.
    """
    distance = float(np.linalg.norm(first.centre_world_mm - second.centre_world_mm))
    matrix = np.asarray(first.pose.rotation) @ np.asarray(second.pose.rotation).T
    turn = scipy.spatial.transform.Rotation.from_matrix(matrix)
    return distance, float(np.degrees(turn.magnitude()))


def _sigmas_of_change(now: Rig, before: Rig, name: str) -> float:
    """Significance, in sigmas, of the change of a camera's parameters; NaN without covariances.

    now, before : new and earlier rig. name : name of the camera.
    """
    keys = [f"{name}.{parameter}" for parameter in PARAMETER_NAMES]
    keys = [key for key in keys if key in now.parameters and key in before.parameters]
    if not keys:
        return float("nan")
    total = now.covariance_of(keys) + before.covariance_of(keys)
    change = np.array([now.value(key) - before.value(key) for key in keys])
    change[:3] = (change[:3] + 180.0) % 360.0 - 180.0
    scale = np.sqrt(np.diag(total))
    if not np.isfinite(total).all() or not (scale > 0).all():
        return float("nan")
    whitened = np.linalg.solve(total / np.outer(scale, scale), change / scale)
    return sigmas_of_chi_square(max(float(whitened @ (change / scale)), 0.0), len(change))


def sigmas_of_chi_square(chi_square: float, freedom: int) -> float:
    """Convert a chi-square to sigmas: two-sided standard normal deviation of the same tail
    probability.
    """
    tail = float(chi_square_tail(chi_square, freedom))
    # Beyond the smallest numbers the degrees of freedom hardly matter; no change is 0, not -0.
    return abs(float(normal_limit(tail / 2) if tail > _LEAST_TAIL else np.sqrt(chi_square)))


def _find_swaps(
    now: Rig, before: Rig, names: list[str], tuning: CalibTuning
) -> tuple[tuple[str, str], ...]:
    """Pairs (name, other name): a camera stands much nearer to the earlier pose of another camera.

    now, before : new and earlier rig. names : names of the cameras that both rigs have.
    """
    swaps = []
    for name in names:
        gaps_mm = {other: _gap(now[name], before[other]) for other in names}
        nearest = min(gaps_mm, key=lambda other: gaps_mm[other])
        if nearest != name and gaps_mm[name] > tuning.rig_check.swap_ratio * gaps_mm[nearest]:
            swaps.append((name, nearest))
    return tuple(swaps)


def _gap(first: Camera, second: Camera) -> float:
    """Difference of two poses as one length, mm: displacement plus rotation angle times distance.

    The distance is that of the second camera from the origin.
    """
    moved_mm, turned_deg = _displacement_and_rotation(first, second)
    return moved_mm + float(np.radians(turned_deg)) * float(np.linalg.norm(second.centre_world_mm))
