"""A rig and its lenses from many shots of a board."""

from collections.abc import Callable, Mapping
from typing import Literal

from trinoc.calib.detection import Detection, split_by_board
from trinoc.calib.intrinsics import FEWEST_CIRCLES
from trinoc.calib.shots.board_shape import with_board_shape
from trinoc.calib.shots.judged import judged
from trinoc.calib.shots.lens_choice import LENSES_TRIED
from trinoc.calib.shots.lens_correction import with_settled_correction
from trinoc.calib.shots.pixel_fit import expect_method, fit_pixels, grey_levels
from trinoc.calib.shots.placing import ShotBoard
from trinoc.calib.shots.point_fit import Asked, fit_of_lens
from trinoc.calib.shots.result import RigFromShots
from trinoc.calib.shots.sightings_of_shots import FoundShots, Pictures, found_shots
from trinoc.calib.targets import AbstractTarget
from trinoc.calib.uncertainty import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import DEFAULT_DISTORTION, AbstractLens, Intrinsics, lens_model
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
    target : the board: a Pattern, a Chessboard, a Charuco or an AprilGrid; or a BoardSet of several
        that are fixed to each other, whose places are found with the rig.
    lens : lenses that are known and held, of all cameras or by name; others are found.
    lens_model : model of the lenses that are found; "auto" takes that which, fitted to one half of
        the shots, tells best of the other half, and a note says why. "splined" corrects the best
        polynomial lens by B-splines, and "splined_" before the name of a model that one; "auto"
        does so where the shots ask for it.
    distortion : how many of its coefficients are fitted; as many as the shots determine unless
        given.
    same_lens : whether all cameras have one lens, such as pictures of one camera moved about.
    world : the shot whose board is the world's plane Z = 0, or the camera whose frame is the
        world's; by default the first of the shots that most cameras saw.
    method : "points" fits the places that the detector found, circles or corners; "pixels" goes on
        from there to the grey levels near every edge of the board.
    systematics : what is known of print and board: `print_size_sigma`, `print_scale_sigma` and
        `flatness_mm`, as `Systematics.typical` has them unless given.
    throw : whether a rig that is not determined raises; without it the result says so.
    progress : called with how many pictures of how many were looked at.

    Pictures without a board are named in `failures`; pictures of another moment, and boards that
    moved while the cameras looked, are named in `refused`.

    Raises
    ------
    InputError : no picture, pictures of several sizes, or names that are not there; with
        "pixels" a detection where a picture is needed.
    CalibrationError : a camera that never sees the board, cameras that no shot connects or whose
        shots are out of step, or, with `throw`, parameters that the shots do not determine.
    """
    expect_method(method, target, pictures)
    known = _known_lenses(lens, tuple(pictures))
    models, correction = _models(lens_model, distortion, known)
    found = found_shots(pictures, target, progress)
    usable = {
        camera: {
            (shot, board): each
            for shot, every in own.items()
            for board, each in split_by_board(every, target).items()
            if len(each) >= FEWEST_CIRCLES
        }
        for camera, own in found.detections.items()
    }
    _expect_seen(found, usable)
    known_board = _board_systematics(systematics)
    asked = Asked(usable, found.shots, target, known, distortion, same_lens, known_board)
    points, remark = fit_of_lens(asked, models, correction)
    starts, placed, fit = points
    fit, silent = with_board_shape(fit), ()
    if method == "pixels":
        fit, silent = fit_pixels(fit, grey_levels(pictures, tuple(starts), placed.shots))
        fit = with_settled_correction(with_board_shape(fit))
    return judged(
        fit,
        placed,
        found,
        tuple(starts),
        world,
        known,
        known_board,
        silent=silent,
        remarks=() if remark is None else (remark,),
        may_give_up=distortion is None,
        throw=throw,
    )


def _models(
    name: str, distortion: int | None, known: Mapping[str, Intrinsics]
) -> tuple[tuple[type[AbstractLens], ...], bool | None]:
    """The models to be tried, and whether the best is corrected by splines; None where asked."""
    if name in ("auto", "splined"):
        if distortion is not None or known:
            raise InputError(
                f'lens_model is "{name}", which finds every lens and all its coefficients: name a '
                "model, or leave out distortion and lens."
            )
        return tuple(lens_model(each) for each in LENSES_TRIED), name == "splined" or None
    model = lens_model(name)
    counts = model.coefficient_counts
    if distortion is not None and distortion not in counts:
        raise InputError(
            f"distortion is {distortion}, but must be one of {', '.join(map(str, counts))} "
            f"coefficients of {', '.join(model.coefficient_names[:20]) or name}, or None."
        )
    return (model,), False


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


def _expect_seen(found: FoundShots, usable: Mapping[str, Mapping[ShotBoard, Detection]]) -> None:
    for camera, own in usable.items():
        if own:
            continue
        why = [words for (name, _), words in found.failures.items() if name == camera]
        said = f" In its first picture: {why[0]}" if why else " It has no picture."
        raise CalibrationError(f'Camera "{camera}" sees the board in no picture.{said}')
