"""A rig and its lenses from many shots of a board."""

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from trinoc.calib.detection import Detection
from trinoc.calib.intrinsics import FEWEST_CIRCLES
from trinoc.calib.shots.board_shape import with_board_shape
from trinoc.calib.shots.judged import judged
from trinoc.calib.shots.lens_start import CameraStart, camera_start
from trinoc.calib.shots.pixel_fit import expect_method, fit_pixels, grey_levels
from trinoc.calib.shots.placing import PlacedRig, placed_rig
from trinoc.calib.shots.problem import Freedom, Problem, problem_of
from trinoc.calib.shots.result import RigFromShots
from trinoc.calib.shots.robust_fit import fit_robustly
from trinoc.calib.shots.sightings_of_shots import FoundShots, Pictures, found_shots
from trinoc.calib.targets import AbstractTarget
from trinoc.calib.uncertainty import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import (
    AFFINE_PARAMETERS,
    DEFAULT_DISTORTION,
    AbstractLens,
    Intrinsics,
    lens_model,
    promoted,
)
from trinoc.numerics import in_float64


@in_float64
def calibrate_rig(
    pictures: Mapping[str, Pictures],
    target: AbstractTarget,
    *,
    lens: Intrinsics | Mapping[str, Intrinsics] | None = None,
    lens_model: str = DEFAULT_DISTORTION.model,
    distortion: int | None = None,
    same_lens: bool = False,
    world: str | None = None,
    method: Literal["points", "pixels"] = "points",
    systematics: Systematics | None = None,
    throw: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> RigFromShots:
    """The lenses and cameras of a rig together, from synchronous pictures of a board that moves.

    pictures : for each camera by name its pictures: a mapping from the name of the shot, or a list
        in the order of the shots, with None where there is none. A picture is an array, what
        `detect_target` found in one, or a function without arguments that returns one. Not every
        camera need see the board in every shot, but shots must connect all cameras. One camera
        alone is a rig, too.
    target : the board: a Pattern, a Chessboard or a Charuco.
    lens : lenses that are known and held, of all cameras or by name; others are found.
    lens_model : model of the lenses that are found.
    distortion : how many of its coefficients are fitted; as many as the shots determine unless
        given.
    same_lens : whether all cameras have one lens, such as pictures of one camera moved about.
    world : the shot whose board is the world's plane Z = 0, or the camera whose frame is the
        world's; by default the first of the shots that most cameras saw.
    method : "points" fits the places that the detector found, circles or corners; "pixels" goes on
        from there to the grey levels near every edge of a sheet of circles or a chessboard.
    systematics : what is known of print and board: `print_size_sigma`, `print_scale_sigma` and
        `flatness_mm`, as `Systematics.typical` has them unless given.
    throw : whether a rig that is not determined raises; without it the result says so.
    progress : called with how many pictures of how many were looked at.

    Pictures without a board are named in `failures`; pictures of another moment, and boards that
    moved while the cameras looked, are named in `refused`.

    Raises
    ------
    InputError : no picture, pictures of several sizes, or names that are not there; with
        "pixels" a detection where a picture is needed, or a board with markers.
    CalibrationError : a camera that never sees the board, cameras that no shot connects or whose
        shots are out of step, or, with `throw`, parameters that the shots do not determine.
    """
    expect_method(method, target, pictures)
    model = _model(lens_model, distortion)
    known = _known_lenses(lens, tuple(pictures))
    found = found_shots(pictures, target, progress)
    _expect_seen(found)
    usable = {
        camera: {shot: each for shot, each in own.items() if len(each) >= FEWEST_CIRCLES}
        for camera, own in found.detections.items()
    }
    starts = {}
    for camera, own in usable.items():
        given = known.get(camera)
        _expect_size(camera, given, next(iter(own.values())))
        try:
            starts[camera] = camera_start(
                list(own.values()), target, model, None if given is None else given.lens
            )
        except CalibrationError as error:
            raise CalibrationError(f'Camera "{camera}": {error}') from error
    placed = placed_rig(starts, usable, found.shots, target, known)
    known_board = _board_systematics(systematics)
    problem = _problem(placed, starts, usable, target, known, distortion, same_lens, known_board)
    fit, silent = with_board_shape(fit_robustly(problem)), ()
    if method == "pixels":
        fit, silent = fit_pixels(fit, grey_levels(pictures, tuple(starts), placed.shots))
        fit = with_board_shape(fit)
    return judged(
        fit,
        placed,
        found,
        tuple(starts),
        world,
        known,
        known_board,
        silent=silent,
        may_give_up=distortion is None,
        throw=throw,
    )


def _model(name: str, distortion: int | None) -> type[AbstractLens]:
    model = lens_model(name)
    counts = model.coefficient_counts
    if distortion is not None and distortion not in counts:
        raise InputError(
            f"distortion is {distortion}, but must be one of {', '.join(map(str, counts))} "
            f"coefficients of {', '.join(model.coefficient_names) or name}, or None."
        )
    return model


def _known_lenses(
    lens: Intrinsics | Mapping[str, Intrinsics] | None, cameras: tuple[str, ...]
) -> Mapping[str, Intrinsics]:
    if lens is None:
        return {}
    if isinstance(lens, Intrinsics):
        return dict.fromkeys(cameras, lens)
    for name in lens:
        if name not in cameras:
            raise InputError(
                f'A lens is given for "{name}", but the cameras are {", ".join(cameras)}.'
            )
    return lens


def _board_systematics(given: Systematics | None) -> Systematics:
    """What is known of the board alone: lenses and aims are what is found here."""
    known = Systematics.typical({}) if given is None else given
    known.check()
    return known._replace(lens_covariance=None, aim_sigma_mm=0.0)


def _expect_seen(found: FoundShots) -> None:
    for camera, own in found.detections.items():
        if any(len(each) >= FEWEST_CIRCLES for each in own.values()):
            continue
        why = [words for (name, _), words in found.failures.items() if name == camera]
        said = f" In its first picture: {why[0]}" if why else " It has no picture."
        raise CalibrationError(f'Camera "{camera}" sees the board in no picture.{said}')


def _expect_size(camera: str, lens: Intrinsics | None, detection: Detection) -> None:
    if lens is None or tuple(lens.image_size_px) == tuple(detection.image_size_px):
        return
    (width, height), (given_width, given_height) = detection.image_size_px, lens.image_size_px
    raise InputError(
        f'The lens of "{camera}" is for pictures of {given_width} x {given_height} px, but its '
        f"pictures have {width} x {height}: see that neither lenses nor folders are exchanged."
    )


def _problem(
    placed: PlacedRig,
    starts: Mapping[str, CameraStart],
    detections: Mapping[str, Mapping[str, Detection]],
    target: AbstractTarget,
    known: Mapping[str, Intrinsics],
    distortion: int | None,
    same_lens: bool,
    systematics: Systematics,
) -> Problem:
    lenses = [start.lens for start in starts.values()]
    sizes = [next(iter(detections[camera].values())).image_size_px for camera in starts]
    models = {type(lens) for lens in lenses if lens.has_distortion}
    if len(models) == 1:
        (only,) = models
        lenses = [promoted(lens, only) for lens in lenses]
    if same_lens:
        if len(set(sizes)) > 1:
            raise InputError("same_lens is asked for, but the cameras' pictures differ in size.")
        middle = np.argsort([float(lens.focal_length_px[0]) for lens in lenses])[len(lenses) // 2]
        lenses, sizes = [lenses[middle]], sizes[:1]
    lens_of_camera = np.zeros(len(starts), dtype=int) if same_lens else np.arange(len(starts))
    names = lenses[0].parameter_names
    fitted = np.arange(len(names)) < len(AFFINE_PARAMETERS) + (
        len(names) if distortion is None else distortion
    )
    held = [camera in known for camera in starts][: len(lenses)]
    free = np.stack([np.zeros(len(names), dtype=bool) if is_held else fitted for is_held in held])
    return problem_of(
        placed.views,
        target,
        lenses,
        placed.cam_from_rig,
        placed.rig_from_board,
        sizes,
        Freedom(lens_of_camera, free),
        systematics,
    )
