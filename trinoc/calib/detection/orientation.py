"""Orientation of a rotationally symmetric sheet.

A plain grid of discs has two possible labellings, a square grid four. Each is valid for one image:
they differ by a rotation of the world's X and Y axes. The cameras of a rig need the same labelling,
which the images do not determine. The user must therefore state it.
"""

from collections.abc import Mapping
from typing import Literal

import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detection.detection import Detection, build_detection
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.rig import Rig
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit

Orientation = Literal["upright"] | Rig | None


def resolve_orientation(
    detections: Mapping[str, Detection],
    pattern: Pattern,
    orientation: Orientation,
    *,
    tuning: CalibTuning = TUNING,
) -> tuple[dict[str, Detection], dict[str, str]]:
    """Select one labelling for each detection of a rotationally symmetric sheet.

    Parameters
    ----------
    detections : detections by the name of the camera.
    pattern : the sheet.
    orientation : rule of the selection. "upright": the labelling whose X axis points most to the
        right in the image. A rig from an earlier calibration: the labelling that agrees best with
        its camera of the same name. None: no selection.
    tuning : tuned constants of calibration.

    Returns
    -------
    Detections by camera, and a message for each camera whose labelling remains ambiguous.

    Raises
    ------
    InputError : `orientation` has another value.
    """
    if not (orientation is None or isinstance(orientation, Rig) or orientation == "upright"):
        raise InputError(
            f'orientation is {orientation!r}: give "upright", an earlier Rig, or None.'
        )
    resolved, failures = dict(detections), {}
    for name, detection in detections.items():
        choice = _choose_labelling(detection, pattern, orientation, name, tuning)
        if isinstance(choice, str):
            failures[name] = choice
        else:
            resolved[name] = _with_labelling(detection, pattern, choice)
    return resolved, failures


def _choose_labelling(
    detection: Detection,
    pattern: Pattern,
    orientation: Orientation,
    name: str,
    tuning: CalibTuning,
) -> Int[np.ndarray, "m"] | str:
    """Point indices of the selected labelling, or a message if the labelling is ambiguous.

    name : name of the camera.
    """
    if detection.ambiguity is None or orientation == "upright":
        return detection.circle_index
    choices = detection.labellings
    turn = 360 // len(choices)
    sheet = f"the sheet {pattern.name!r} looks the same when rotated by {turn} degrees"
    if orientation is None:
        return (
            f'{sheet}: state its orientation with orientation="upright" (X points right in '
            "every image) or with an earlier rig, or print a sheet with rings."
        )
    if name not in orientation.names:
        return f"{sheet}, and the earlier rig has no camera {name!r}: give a rig with this camera."
    errors_px = [_error_px(orientation[name], detection, pattern, index) for index in choices]
    order = np.argsort(errors_px)
    if not errors_px[order[0]] * tuning.detection.orientation_ratio < errors_px[order[1]]:
        return (
            f"{sheet}, and the earlier rig does not determine the orientation: the best two "
            f"orientations have errors of {errors_px[order[0]]:.0f} and {errors_px[order[1]]:.0f} "
            "px. Give a newer rig."
        )
    return choices[order[0]]


def _error_px(
    camera: Camera, detection: Detection, pattern: Pattern, index: Int[np.ndarray, "m"]
) -> float:
    """Median distance of the circles from their positions predicted by an earlier camera.

    index : (m,) pattern index of each circle in one labelling.
    """
    predicted = _centres_px(camera, pattern.centres_mm[index], pattern.radius_mm[index])
    error_px = np.linalg.norm(np.asarray(predicted) - detection.centres_px, axis=1)
    return float(np.median(np.where(np.isfinite(error_px), error_px, np.inf)))


@kept_jit
def _centres_px(
    camera: Camera, centres_mm: Float[ArrayLike, "m 2"], radius_mm: Float[ArrayLike, "m"]
) -> Float[ArrayLike, "m 2"]:
    return jax.vmap(image_of_circle_centre, in_axes=(None, 0, 0))(camera, centres_mm, radius_mm)


def _with_labelling(
    detection: Detection, pattern: Pattern, index: Int[np.ndarray, "m"]
) -> Detection:
    """Copy of a detection with a single labelling.

    Its crossed lines are exchanged if the labelling is rotated by a quarter turn.
    """
    first, second = (
        pattern.centres_mm[labelling] - pattern.centres_mm[labelling].mean(axis=0)
        for labelling in (detection.circle_index, index)
    )
    turned = abs(np.sum(first * second)) < abs(np.sum(first * second[:, ::-1] * [1.0, -1.0]))
    return build_detection(
        index[None],
        detection.centres_px,
        detection.covariance_px2,
        detection.image_size_px,
        detection.shape_px2,
        detection.lines_px[::-1] if turned else detection.lines_px,
    )
