"""The lens of one camera from several pictures of the sheet: from circles, then grey levels."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from trinoc.calib.detection import Detection
from trinoc.calib.intrinsics import IntrinsicsResult, lens_of_circles
from trinoc.calib.shots import lens_of_rig
from trinoc.calib.targets import Pattern
from trinoc.errors import InputError
from trinoc.geometry import DEFAULT_DISTORTION, AbstractSplined, SplinedBrownConrady, lens_model
from trinoc.numerics import ArrayLike, in_float64

# Names that stand for models.
_CALLED = {"splined": SplinedBrownConrady.model}


@in_float64
def calibrate_intrinsics(
    images_or_detections: Sequence[ArrayLike | Detection],
    pattern: Pattern,
    *,
    image_size_px: tuple[int, int] | None = None,
    distortion: int | None = None,
    distortion_model: str = DEFAULT_DISTORTION.model,
    principal_point: str = "free",
    pixel_pitch_mm: tuple[float, float] | None = None,
    aspect: str = "free",
    method: Literal["points", "pixels"] = "points",
    throw: bool = True,
) -> IntrinsicsResult:
    """Focal lengths, principal point and distortion of a lens, with their covariance.

    images_or_detections : pictures by one camera at one zoom and focus, the sheet held
        differently in each; or what `detect_pattern` found in them.
    image_size_px : (width, height) that all pictures must have; that of the first by default.
    distortion : number of coefficients, for Brown-Conrady 0, 1, 2, 4 or 5 of k1, k2, p1, p2, k3.
        As many as the pictures determine unless given; a note says how many they ask for.
    distortion_model : name of the lens model, of `lenses.registry.LENS_MODELS`. "splined_" before
        the name of a polynomial model corrects it by B-splines; "splined" is Brown-Conrady's so
        corrected. It frees both focal lengths.
    principal_point : "free", or "centre" to hold it in the middle of the picture.
    pixel_pitch_mm : size of a pixel along u and v, where it is known: the lens then has a
        focal length in millimetres, too.
    aspect : "free", or "pitch" to hold fx / fy at what `pixel_pitch_mm` says (1 without it).
    method : "points" fits the circles' centres; "pixels" goes on from there to the grey levels near
        every edge, as `calibrate_rig` does with one camera. It needs pictures, not detections, and
        frees both focal lengths.
    throw : whether an undetermined lens raises; without it the result says so by its status.

    Pictures in which no sheet is found are left out and named in `failures`. Starts from
    Zhang's method in OpenCV, then least squares over the lens and six parameters of each
    picture's pose with the exact centres of the circles' images.

    Raises
    ------
    InputError : no picture, pictures of different sizes, one picture given twice, or an
        option that is not one of those above.
    CalibrationError : no sheet in any picture, no lens that explains the circles, or, with
        `throw`, parameters that the pictures do not determine. The sentence names them and
        the picture to take next; `result` of the error is the IntrinsicsResult.
    """
    if method not in ("points", "pixels"):
        raise InputError(f'method is {method!r}, but must be "points" or "pixels".')
    if not isinstance(pattern, Pattern):
        raise InputError(
            f"The board {pattern.name!r} is no sheet of circles: give the pictures to "
            "calibrate_rig, for which one camera alone is a rig, too."
        )
    if method == "pixels" and aspect != "free":
        raise InputError('method="pixels" frees both focal lengths: leave out aspect.')
    pictures = [each for each in images_or_detections if not isinstance(each, Detection)]
    if method == "pixels" and len(pictures) < len(images_or_detections):
        raise InputError(
            "Detections are given, in which no grey levels are left: give the pictures, or "
            'method="points".'
        )
    distortion_model = _CALLED.get(distortion_model, distortion_model)
    model = lens_model(distortion_model)
    is_splined = issubclass(model, AbstractSplined) and distortion is None
    if is_splined and aspect != "free":
        raise InputError("A splined lens frees both focal lengths: leave out aspect.")
    core = model.core_model.model if issubclass(model, AbstractSplined) else distortion_model
    result = lens_of_circles(
        images_or_detections,
        pattern,
        image_size_px=image_size_px,
        distortion=distortion,
        distortion_model=core,
        principal_point=principal_point,
        pixel_pitch_mm=pixel_pitch_mm,
        aspect=aspect,
        throw=throw,
    )
    if result.lens is None or (method == "points" and not is_splined):
        return result
    images = [np.asarray(each) for each in pictures] if method == "pixels" else None
    return lens_of_rig(result, distortion_model if is_splined else core, images)
