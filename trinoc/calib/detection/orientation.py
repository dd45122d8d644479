"""Which way round a sheet lies that looks the same when it is turned.

A plain grid of discs can be labelled in two ways, a square one in four. Each is a right answer
about one picture, with the world's X and Y turned; but the cameras of a rig must agree, and no
picture says how. So nobody chooses unless the user says by what.
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
    """Every detection with one labelling, and a sentence for each that leaves it open.

    orientation : None leaves it open; "upright" takes the labelling in which X points to the
        right in the picture, as nearly as it can; an earlier rig, for each camera that it
        holds, the labelling that lies nearest to where that camera saw the sheet.
    """
    if not (orientation is None or isinstance(orientation, Rig) or orientation == "upright"):
        raise InputError(
            f'orientation is {orientation!r}, but must be "upright", an earlier Rig, or None.'
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
    """The labelling to take, or why none can be."""
    if detection.ambiguity is None or orientation == "upright":
        return detection.circle_index
    choices = detection.labellings
    turn = 360 // len(choices)
    sheet = f"the sheet {pattern.name!r} looks the same turned by {turn} degrees"
    if orientation is None:
        return (
            f'{sheet}: say which way round it lies with orientation="upright" (X points right in '
            "every picture) or with an earlier rig, or print a sheet with rings."
        )
    if name not in orientation.names:
        return f"{sheet}, and the earlier rig has no such camera that would tell."
    misses = [_miss_px(orientation[name], detection, pattern, index) for index in choices]
    order = np.argsort(misses)
    if not misses[order[0]] * tuning.detection.orientation_ratio < misses[order[1]]:
        return (
            f"{sheet}, and the earlier rig does not tell which: its camera misses the best two "
            f"by {misses[order[0]]:.0f} and {misses[order[1]]:.0f} px."
        )
    return choices[order[0]]


def _miss_px(
    camera: Camera, detection: Detection, pattern: Pattern, index: Int[np.ndarray, "m"]
) -> float:
    """Median distance of the circles from where the camera would see them."""
    predicted = _centres_px(camera, pattern.centres_mm[index], pattern.radius_mm[index])
    off = np.linalg.norm(np.asarray(predicted) - detection.centres_px, axis=1)
    return float(np.median(np.where(np.isfinite(off), off, np.inf)))


@kept_jit
def _centres_px(
    camera: Camera, centres_mm: Float[ArrayLike, "m 2"], radius_mm: Float[ArrayLike, "m"]
) -> Float[ArrayLike, "m 2"]:
    return jax.vmap(image_of_circle_centre, in_axes=(None, 0, 0))(camera, centres_mm, radius_mm)


def _with_labelling(
    detection: Detection, pattern: Pattern, index: Int[np.ndarray, "m"]
) -> Detection:
    """The detection with one labelling; after a quarter turn the crossed lines change places."""
    first, second = (
        pattern.centres_mm[each] - pattern.centres_mm[each].mean(axis=0)
        for each in (detection.circle_index, index)
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
