"""Calibrate the lenses and cameras of a rig from many shots of a board that is moved about."""

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
from trinoc.calib.starts.pictures import FoundBoards, Pictures, find_boards
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
    """Calibrate lenses and cameras together from synchronous images of a board that moves.

    Parameters
    ----------
    images : for each camera by name its images: a mapping from the name of the shot, or a list in
        the order of the shots, with None where there is none. An image is an array, what
        `detect_target` found in one, or a function without arguments that returns one. Not every
        camera need see the board in every shot, but shots must connect all cameras. One camera
        alone is a rig, too.
    board : a Pattern, a Chessboard, a Charuco or an AprilGrid; or a BoardSet of several that are
        fixed to each other, whose poses are estimated with the rig.
    lens : lenses that are known, of all cameras or by name; others are estimated. They are assumed
        exact, or estimated under the covariance that `systematics` states of them. If the shots
        contradict one, the status is SUSPECT and the first note names it.
    lens_model : model of the lenses that are estimated. "default" is "brown_conrady", or "rational"
        or "kannala_brandt" if that would fold an image, and a note reports this. "auto" takes the
        model which, fitted to one half of the shots, has the smallest error in the other half, and
        a note gives the reason. "splined" corrects the best polynomial lens by B-splines, and
        "splined_" before the name of a model that one; "auto" does so if a test of the residuals
        calls for it.
    distortion : number of coefficients that are estimated; all that are determined by default.
    same_lens : whether all cameras have one lens, such as images of one camera moved about.
    world : the shot whose board is the world's plane Z = 0, or the camera whose frame is the
        world's; by default the first of the shots that most cameras saw.
    method : "points" fits the circles or corners that the detector found; "pixels" goes on from
        there to the grey levels near every edge of the board.
    systematics : what is known of print and board: `print_size_sigma`, `print_scale_sigma` and
        `flatness_mm`, by default those of `Systematics.typical`; and `lens_covariance` of given
        lenses, without which they are exact.
    throw : whether a rig that is not determined raises an error; otherwise its status reports it.
    progress : called with the numbers of images searched and of all images.
    tuning : constants of calibration; a benchmark or a study changes them. Those of the fit to grey
        levels, `tuning.photometric`, cannot be changed.

    Returns
    -------
    The result. Images without a board are named in `failures`. Images of another moment, and
    boards that moved during a shot, are named in `refused`.

    Raises
    ------
    InputError : no image, or names that do not exist; with "pixels" a detection where an image is
        needed.
    CalibrationError : a camera that never sees the board, cameras that no shot connects or whose
        shots are out of step, or, with `throw`, parameters that the shots do not determine.
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
    exact = {camera: each for camera, each in lenses.items() if camera not in factors}
    result = result_of_shots(shots_fit, boards, observations, exact, world=world, method=method)
    if throw and not result.has_rig:
        # A board that was read otherwise than stated may be why.
        raise CalibrationError(" ".join([result.notes[0], *boards.remarks]), {}, result)
    return result


def models_to_try(
    name: str, distortion: int | None, lenses: Mapping[str, Intrinsics]
) -> tuple[tuple[type[AbstractLens], ...], bool | None]:
    """Lens models to try, and whether the best is corrected by splines; None if a test decides.

    Raises InputError for a name or a number of coefficients that there is not.
    """
    if name in ("auto", "splined"):
        if distortion is not None or lenses:
            raise InputError(
                f'lens_model is "{name}", which finds every lens and all its coefficients: name a '
                "model, or leave out distortion and lens."
            )
        return tuple(lens_model_of(each) for each in LENSES_TRIED), name == "splined" or None
    model = DEFAULT_DISTORTION if name == DEFAULT_LENS else lens_model_of(name)
    counts, names = model.coefficient_counts, model.coefficient_names
    if distortion is not None and distortion not in counts:
        raise InputError(
            f"distortion is {distortion}, but must be one of {', '.join(map(str, counts))} "
            f"coefficients of {', '.join(names[:20]) or model.model}, or None for as many as the "
            "pictures determine."
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
    for name, each in lens.items():
        check_kind(each, Intrinsics, f'lens of "{name}"', A_LENS)
        if name not in cameras:
            raise InputError(
                f'A lens is given for "{name}", but the cameras are {list_names(cameras)}.'
            )
    return lens


def _board_systematics(stated: Systematics | None, tuning: CalibTuning) -> Systematics:
    """Errors of board and lenses, checked; aims are estimated here."""
    systematics = Systematics.typical({}, tuning=tuning) if stated is None else stated
    check_kind(systematics, Systematics, "knowledge of the board", "trinoc.Systematics")
    systematics.check()
    return systematics._replace(aim_sigma_mm=0.0)


def _lens_factors(
    systematics: Systematics, lenses: Mapping[str, Intrinsics], cameras: tuple[str, ...]
) -> dict[str, Float[np.ndarray, "_ _"]]:
    """For each given lens that is not exact, a factor of its covariance."""
    stated = systematics.lens_covariance
    without = [camera for camera in cameras if camera not in lenses]
    if isinstance(stated, Mapping):
        without = [camera for camera in without if camera in stated]
    if stated is not None and without:
        raise InputError(
            f'`lens_covariance` is that of a lens that is given, but "{without[0]}" has none in '
            "`lens`: add it, or leave its covariance out."
        )
    return systematics.lens_factors({camera: lenses.get(camera) for camera in cameras})


def _expect_boards(boards: FoundBoards, observations: ShotObservations) -> None:
    """Raise CalibrationError for a camera that sees the board in no image."""
    for camera, detections in observations.detections.items():
        if detections:
            continue
        why = [sentence for (name, _), sentence in boards.failures.items() if name == camera]
        reason = f" In its first picture: {why[0]}" if why else " It has no picture."
        if camera in boards.causes:
            reason = f" {boards.causes[camera]}"
        raise CalibrationError(f'Camera "{camera}" sees the board in no picture.{reason}')
