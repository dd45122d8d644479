"""Calibrate a rig from one picture of the sheet per camera."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from trinoc.calib.detection.orientation import Orientation
from trinoc.calib.detection.registry import detect_pattern
from trinoc.calib.from_detections import Search, calibration_of_search, lens_of_each
from trinoc.calib.photometric.encoding import Encoding, Response, neutral_mosaic
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.rig_fit import Knowledge
from trinoc.calib.targets.pattern import A_PATTERN, Pattern
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import DetectionError, InputError, check_kind
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import PoseModel, pose_model_over_sheet
from trinoc.geometry.rig import check_camera_names
from trinoc.image.grey import grey_image
from trinoc.numerics.precision import ArrayLike, in_float64


@in_float64
def calibrate(
    images: Mapping[str, ArrayLike],
    pattern: Pattern,
    lens: Intrinsics | Mapping[str, Intrinsics],
    *,
    pose_model: PoseModel | str = PoseModel.AIMED,
    method: Literal["pixels", "points"] = "pixels",
    throw: bool = True,
    systematics: Systematics | None = None,
    orientation: Orientation = None,
    bayer: str | None = None,
    response: Response = "fit",
) -> CalibrationResult:
    """The cameras of a rig, from one picture of the sheet each.

    images : a grey or colour picture for each camera, by name.
    lens : the intrinsics of all cameras, or of each by name.
    pose_model : "aimed" (pan, tilt, swing, distance; the optical axis meets the origin of the
        sheet), the default, or "aim-free" (the point it meets is free), or a PoseModel.
    method : "pixels" goes on from the circles to a fit of the grey levels near every edge of
        the sheet, which reaches the Cramer-Rao bound, and uses it for each camera whose circles
        agree with it; "points" stops at their centres. `fits[name].method` says what was used.
    throw : whether a camera that fails raises; without it the failed cameras are left out of
        the rig and `failures` says why.
    systematics : what is known of the errors of the sheet, the lens and the aim: by default what
        printers, paper, hands and data sheets leave open (`Systematics.typical`).
        `Systematics()` takes all of it as exact.
    orientation : for a sheet that looks the same turned, such as a plain grid of discs:
        "upright" where X points to the right in every picture, as nearly as it can, or an
        earlier rig whose cameras have hardly moved since. Without it such a sheet fails.
    bayer : for raw mosaics of colours, those of the first two pixels of the first two rows, such as
        "RGGB": each pixel is fitted as it is, without interpolation.
    response : of the cameras, "linear" or "srgb" where it is known; with "fit" a picture is taken
        as linear until the profiles of its edges refute that, and the response is then fitted.

    Raises
    ------
    InputError : a lens is missing, a picture has another size than its lens, one picture was
        given for two cameras, or a pose model that is none of these.
    CalibrationError : some camera failed; the error holds the sentence of each, and the
        result of the others. Raised without `throw`, too, where no camera is left.
    """
    if method not in ("pixels", "points"):
        raise InputError(f'method is {method!r}, but must be "pixels" or "points".')
    expect_pictures(images, pattern)
    model = pose_model_over_sheet(pose_model)
    lenses = lens_of_each(lens, images)
    _check_images(images, lenses)
    encoding = Encoding(bayer, response)
    encoding.check()
    known = Knowledge(pattern, model, systematics or Systematics.typical(lenses), encoding)
    check_kind(known.systematics, Systematics, "knowledge of the sheet", "trinoc.Systematics")
    known.systematics.check()
    detections, failures = {}, {}
    for name, image in images.items():
        try:
            looked_at = np.asarray(image) if bayer is None else neutral_mosaic(np.asarray(image))
            detections[name] = detect_pattern(looked_at, pattern)
        except DetectionError as error:
            failures[name] = str(error)
        except InputError as error:
            raise InputError(f'Camera "{name}": {error}') from error
    images = {name: grey_image(np.asarray(images[name])).grey for name in detections}
    search = Search(tuple(lenses), detections, images if method == "pixels" else {}, failures)
    return calibration_of_search(search, lenses, known, orientation, throw=throw)


def expect_pictures(images: Any, pattern: object) -> None:
    """Raises InputError for the slips of a first call, such as a file that was not read."""
    check_kind(pattern, Pattern, "pattern", A_PATTERN)
    each = 'a dictionary of each camera\'s name and picture, such as {"left": image}'
    check_kind(images, Mapping, "set of pictures", each)
    check_camera_names(images)
    for name, image in images.items():
        if image is None or np.ndim(image) not in (2, 3):
            given = "None" if image is None else f"a {type(image).__name__}"
            raise InputError(
                f'The picture of camera "{name}" is {given} and no array of height and width: was '
                "the file found and read?"
            )


def _check_images(images: Mapping[str, ArrayLike], lenses: Mapping[str, Intrinsics]) -> None:
    names = list(images)
    for name in names:
        shape, size = np.shape(images[name]), lenses[name].image_size_px
        if shape[1::-1] != size:
            raise InputError(
                f'The picture of camera "{name}" is {_size(shape[1::-1])} pixels, but its lens '
                f"says {_size(size)}: give the intrinsics of this camera at this resolution."
            )
    for k, first in enumerate(names):
        for second in names[k + 1 :]:
            if np.array_equal(images[first], images[second]):
                raise InputError(
                    f'The same picture was given for cameras "{first}" and "{second}": give '
                    "each camera its own."
                )


def _size(pair: Sequence[int]) -> str:
    return " x ".join(str(side) for side in pair)
