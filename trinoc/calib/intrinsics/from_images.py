"""The lens of one camera from the circles in several pictures of the sheet."""

from collections.abc import Sequence

import numpy as np

from trinoc.calib.detection import Detection, detect_pattern
from trinoc.calib.intrinsics.assessment import assess_lens
from trinoc.calib.intrinsics.lens_parameters import LensModel
from trinoc.calib.intrinsics.model_choice import fit_candidate, fit_determined
from trinoc.calib.intrinsics.result import IntrinsicsResult
from trinoc.calib.intrinsics.robust_lens import LensImages, fit_robustly, reached
from trinoc.calib.intrinsics.zhang import FEWEST_CIRCLES, zhang_start
from trinoc.calib.result import Status
from trinoc.calib.targets import Pattern
from trinoc.errors import CalibrationError, DetectionError, InputError
from trinoc.geometry import lens_model
from trinoc.numerics import ArrayLike


def lens_of_circles(
    images_or_detections: Sequence[ArrayLike | Detection],
    pattern: Pattern,
    *,
    image_size_px: tuple[int, int] | None,
    distortion: int | None,
    distortion_model: str,
    principal_point: str,
    pixel_pitch_mm: tuple[float, float] | None,
    aspect: str,
    throw: bool,
) -> IntrinsicsResult:
    """`calibrate_intrinsics` by the circles alone.

    Starts from Zhang's method in OpenCV, then least squares over the lens and six parameters of
    each picture's pose with the exact centres of the circles' images.
    """
    model = _largest_model(distortion, distortion_model, principal_point, aspect)
    ratio = None
    if not model.aspect:
        ratio = 1.0 if pixel_pitch_mm is None else pixel_pitch_mm[1] / pixel_pitch_mm[0]
    found, failures = _detections(images_or_detections, pattern)
    detections, index = _usable(found, failures, image_size_px)
    everything = [np.ones(len(detection), dtype=bool) for detection in detections]
    images = LensImages(detections, pattern, everything)
    start = zhang_start(detections, pattern, model.lens, ratio)
    # Which circles were located wrongly is asked of the richest lens, lest a distorted picture's
    # corners be taken for mistakes.
    fit, images = fit_robustly(start, model, images)
    start = reached(fit) if fit.converged else start
    fit_one = fit_determined if distortion is None else fit_candidate
    result = assess_lens(
        fit_one(start, model, images), model, images, pixel_pitch_mm, index, failures
    )
    if throw and result.status is not Status.CONVERGED:
        raise CalibrationError(_told(result), {}, result)
    return result


def _told(result: IntrinsicsResult) -> str:
    advice = "" if result.next_image is None else f" {result.next_image.sentence}"
    return f"{result.notes[0]}{advice}" if result.notes else result.status.value


def _largest_model(
    distortion: int | None, distortion_model: str, principal_point: str, aspect: str
) -> LensModel:
    lens = lens_model(distortion_model)
    counts, names = lens.coefficient_counts, lens.coefficient_names
    if distortion is not None and distortion not in counts:
        *most, last = [str(count) for count in counts]
        raise InputError(
            f"distortion is {distortion}, but must be {', '.join(most)} or {last} coefficients of "
            f"{', '.join(names)}, or None for as many as the pictures determine."
        )
    if principal_point not in ("free", "centre"):
        raise InputError(f'principal_point is {principal_point!r}; give "free" or "centre".')
    if aspect not in ("free", "pitch"):
        raise InputError(f'aspect is {aspect!r}; give "free" or "pitch".')
    return LensModel(lens, names[:distortion], principal_point == "free", aspect == "free")


def _detections(
    images_or_detections: Sequence[ArrayLike | Detection], pattern: Pattern
) -> tuple[dict[int, Detection], dict[int, str]]:
    """The sheet in each picture, and why it was not found in the others, by picture."""
    if len(images_or_detections) == 0:
        raise InputError("No picture was given: give several pictures of the sheet.")
    found, failures = {}, {}
    for index, item in enumerate(images_or_detections):
        if isinstance(item, Detection):
            found[index] = item
            continue
        try:
            found[index] = detect_pattern(np.asarray(item), pattern)
        except DetectionError as error:
            failures[index] = str(error)
    if not found:
        raise CalibrationError(f"The sheet was found in no picture. In the first: {failures[0]}")
    return found, failures


def _usable(
    found: dict[int, Detection], failures: dict[int, str], image_size_px: tuple[int, int] | None
) -> tuple[list[Detection], tuple[int, ...]]:
    """Detections that can take part, with their places; those that cannot join `failures`."""
    size = next(iter(found.values())).image_size_px if image_size_px is None else image_size_px
    for index, detection in found.items():
        if tuple(detection.image_size_px) != tuple(size):
            raise InputError(
                f"Picture {index + 1} has {_size(detection.image_size_px)} pixels, but "
                f"{_size(size)} are expected: give pictures of one camera at one resolution."
            )
    for index, detection in found.items():
        for other, earlier in found.items():
            if other < index and np.array_equal(detection.centres_px, earlier.centres_px):
                raise InputError(
                    f"Pictures {other + 1} and {index + 1} are the same: give each picture once."
                )
    usable = {k: each for k, each in found.items() if len(each) >= FEWEST_CIRCLES}
    for index in found.keys() - usable.keys():
        failures[index] = f"only {len(found[index])} circles were found: show more of the sheet."
    if not usable:
        raise CalibrationError(
            f"No picture shows {FEWEST_CIRCLES} circles of the sheet: show more of it."
        )
    return list(usable.values()), tuple(usable)


def _size(pair: tuple[int, int]) -> str:
    return " x ".join(str(side) for side in pair)
