"""Calibration of the lenses and cameras of a rig from many shots of a board that is
moved around.
"""

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from jaxtyping import Float

from trinoc.calib.folded_lens import fit_wider_model
from trinoc.calib.lens_selection import LENSES_TRIED
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.rig_pixels import expect_method
from trinoc.calib.shots_assembly import result_of_shots
from trinoc.calib.shots_fit import LensFreedom, ShotObservations, ShotsFit, fit_shots
from trinoc.calib.starts.pictures import BoardDetections, Pictures, find_boards
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError, check_kind, list_names
from trinoc.geometry.intrinsics import A_LENS, Intrinsics
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.registry import (
    DEFAULT_DISTORTION,
    DEFAULT_LENS,
    lens_model as lens_model_of,
)
from trinoc.geometry.rig import check_camera_names
from trinoc.numerics.precision import in_float64


@in_float64
def calibrate_rig(
    images: Mapping[str, Pictures],
    board: AbstractTarget,
    *,
    lens: Intrinsics | Mapping[str, Intrinsics] | None = None,
    lens_model: str = DEFAULT_LENS,
    distortion: int | None = None,
    same_lens: bool = False,
    world: str | None = None,
    method: Literal["points", "pixels"] = "points",
    systematics: Systematics | None = None,
    throw: bool = True,
    progress: Callable[[int, int], None] | None = None,
    tuning: CalibTuning = TUNING,
) -> CalibrationResult:
    """Calibrate lenses and cameras together from synchronous images of a board that is moved
    around.

    A shot is the set of images that all cameras take at one moment.

    Parameters
    ----------
    images : images of each camera, by the name of the camera. The images of one camera are a
        mapping from the name of the shot to the image, or a list in the order of the shots with
        None for a missing image. An image is an array, a result of `detect_target`, or a function
        without arguments that returns one of these. Not every camera must see the board in every
        shot, but the shots must connect all cameras. A single camera is allowed.
    board : a Pattern, Chessboard, Charuco or AprilGrid; or a BoardSet of several boards that are
        fixed to each other. The relative poses of a set are estimated together with the rig.
    lens : given lens of all cameras, or given lenses by the name of the camera; all others are
        estimated. A given lens is assumed exact, unless `systematics` contains its covariance. If
        the shots contradict a given lens, the status is SUSPECT and the first note names the lens.
    lens_model : model of the estimated lenses. "default": "brown_conrady", or "rational" or
        "kannala_brandt" if the first would fold an image (map two rays to one pixel); a note
        reports this. "auto": the model with the smallest residuals in shots that were not used in
        its fit; a note gives the reason. "splined": the best polynomial model, corrected by
        B-splines. "splined_" before the name of a model corrects this model. "auto" adds splines if
        a test of the residuals is significant.
    distortion : number of estimated distortion coefficients. Default: all that the shots determine.
    same_lens : whether all cameras have the same lens, for instance if all images come from one
        camera that was moved.
    world : name of the shot whose board defines the world's plane Z = 0, or of the camera whose
        frame is the world's. Default: the first of the shots that most cameras saw.
    method : "points" fits the detected circles or corners. "pixels" then also fits the grey levels
        near every edge of the board.
    systematics : errors of print and board (`print_size_sigma`, `print_scale_sigma`, `flatness_mm`;
        default `Systematics.typical`), and `lens_covariance` of given lenses, which are exact
        without it.
    throw : whether a rig that is not determined raises an error. If False, the status of the result
        reports it.
    progress : function that is called after each image with the number of searched images and the
        number of all images.
    tuning : constants of calibration; a benchmark or a study changes them.

    Returns
    -------
    The calibrated rig. `failures` names the images without a board. `refused` names images that
    were taken at another moment than the rest of their shot, and boards that moved during a shot.

    Raises
    ------
    InputError : there is no image, or a name does not exist. With "pixels": a detection is given
        instead of an image.
    CalibrationError : a camera never sees the board, the shots do not connect all cameras, or the
        shots of two cameras are shifted against each other. With `throw`: also parameters that the
        shots do not determine.
    """
    expect_method(method, board, images)
    check_camera_names(images)
    lenses = _given_lenses(lens, tuple(images))
    systematics = _board_systematics(systematics, tuning)
    factors = _lens_factors(systematics, lenses, tuple(images))
    models, splined = models_to_try(lens_model, distortion, lenses)
    boards = find_boards(images, board, progress, tuning=tuning)
    freedom = LensFreedom(distortion, same_lens)
    observations = ShotObservations.of_boards(boards, lenses, factors, freedom, systematics, tuning)
    _expect_boards(boards, observations)

    def fit_models(
        models: tuple[type[AbstractLens], ...], splined: bool | None = False
    ) -> ShotsFit:
        levels = images if method == "pixels" else None
        return fit_shots(observations, models, splined=splined, images=levels)

    shots_fit = fit_models(models, splined)
    if lens_model == DEFAULT_LENS and distortion is None and not lenses:
        shots_fit = fit_wider_model(
            shots_fit, lambda model: fit_models((model,)), observations.cameras
        )
    exact = {camera: known_lens for camera, known_lens in lenses.items() if camera not in factors}
    result = result_of_shots(shots_fit, boards, observations, exact, world=world, method=method)
    if throw and not result.has_rig:
        # A board that was read otherwise than stated may be why.
        raise CalibrationError(" ".join([result.notes[0], *boards.remarks]), {}, result)
    return result


def models_to_try(
    name: str, distortion: int | None, lenses: Mapping[str, Intrinsics]
) -> tuple[tuple[type[AbstractLens], ...], bool | None]:
    """Lens models to try, and whether the best one is then corrected by splines (None: a test
    decides).

    Raises `InputError` for an unknown name or an impossible number of coefficients.

    name : value of `lens_model`. distortion : number of coefficients, or None.
    lenses : given lenses.
    """
    if name in ("auto", "splined"):
        if distortion is not None or lenses:
            raise InputError(
                f'lens_model is "{name}", which estimates all coefficients of every lens: name a '
                "lens model, or omit distortion and lens."
            )
        return tuple(
            lens_model_of(model_name) for model_name in LENSES_TRIED
        ), name == "splined" or None
    model = DEFAULT_DISTORTION if name == DEFAULT_LENS else lens_model_of(name)
    counts, names = model.coefficient_counts, model.coefficient_names
    if distortion is not None and distortion not in counts:
        raise InputError(
            f"distortion is {distortion}, but must be {', '.join(map(str, counts))}, the number of "
            f"coefficients of {', '.join(names[:20]) or model.model}, or None to estimate as many "
            "as the images determine."
        )
    return (model,), False


def _given_lenses(
    lens: Intrinsics | Mapping[str, Intrinsics] | None, cameras: tuple[str, ...]
) -> Mapping[str, Intrinsics]:
    if lens is None:
        return {}
    if isinstance(lens, Intrinsics):
        return dict.fromkeys(cameras, lens)
    check_kind(lens, Mapping, "lens", f"{A_LENS}, or a dictionary of each camera's")
    for name, intrinsics in lens.items():
        check_kind(intrinsics, Intrinsics, f'lens of "{name}"', A_LENS)
        if name not in cameras:
            raise InputError(
                f'A lens is given for "{name}", but the cameras are {list_names(cameras)}.'
            )
    return lens


def _board_systematics(stated: Systematics | None, tuning: CalibTuning) -> Systematics:
    """Return the given errors of boards and lenses, or typical ones, without a prior of the aim.

    Raises `InputError` if they are not valid.
    """
    systematics = Systematics.typical({}, tuning=tuning) if stated is None else stated
    check_kind(systematics, Systematics, "knowledge of the board", "trinoc.Systematics")
    systematics.check()
    return systematics._replace(aim_sigma_mm=0.0)


def _lens_factors(
    systematics: Systematics, lenses: Mapping[str, Intrinsics], cameras: tuple[str, ...]
) -> dict[str, Float[np.ndarray, "_ _"]]:
    """Factor L of the covariance L L^T of each given lens that is not exact, by the name of the
    camera.

    Raises `InputError` for a covariance of a lens that is not given.
    """
    stated = systematics.lens_covariance
    without = [camera for camera in cameras if camera not in lenses]
    if isinstance(stated, Mapping):
        without = [camera for camera in without if camera in stated]
    if stated is not None and without:
        raise InputError(
            f'`lens_covariance` has the camera "{without[0]}", but `lens` has no lens for this '
            "camera: add the lens, or omit the covariance."
        )
    return systematics.lens_factors({camera: lenses.get(camera) for camera in cameras})


def _expect_boards(boards: BoardDetections, observations: ShotObservations) -> None:
    """Raise `CalibrationError` if a camera sees the board in no image."""
    for camera, detections in observations.detections.items():
        if detections:
            continue
        failures = [reason for (name, _), reason in boards.failures.items() if name == camera]
        reason = f" Reason for its first image: {failures[0]}" if failures else " It has no image."
        if camera in boards.causes:
            reason = f" {boards.causes[camera]}"
        raise CalibrationError(f'The board was found in no image of camera "{camera}".{reason}')
