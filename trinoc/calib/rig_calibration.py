"""A rig and its lenses from many shots of a board: which variables there are, and what is free."""

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection, split_by_board
from trinoc.calib.folded_lens import fit_wider_model, hold_folding
from trinoc.calib.lens_selection import (
    LENSES_TRIED,
    HeldOut,
    LensChoice,
    choice_sentence,
    choose_lens,
    is_significant,
    measure_held_out_errors,
)
from trinoc.calib.problem.board_shape import with_board_shape
from trinoc.calib.problem.coefficients import hold_undetermined
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.lens_correction import (
    add_splines,
    with_correction,
    with_own_correction_sigmas,
)
from trinoc.calib.problem.moments import find_other_moments, with_shots_of_their_own
from trinoc.calib.problem.outcome import assess_fit, shot_scatter
from trinoc.calib.problem.problem import Freedom, Problem, with_lens_prior
from trinoc.calib.problem.rao_test import rational_lens_test, wider_lens_test
from trinoc.calib.problem.robust_fit import RobustFit, anneal, fit_robustly
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.problem.unsynchronised import with_images_apart, with_motion_between_images
from trinoc.calib.result.calibration import Status
from trinoc.calib.rig_from_shots import result_from_fit
from trinoc.calib.rig_pixels import expect_method, fit_pixels, grey_levels
from trinoc.calib.shots_result import RigFromShots
from trinoc.calib.starts.camera_start import FEWEST_PLACES, CameraStart, start_camera
from trinoc.calib.starts.pictures import FoundBoards, Pictures, find_boards
from trinoc.calib.starts.placing import PlacedRig, ShotBoard, place_rig, take_out
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError, check_kind, list_names
from trinoc.geometry.intrinsics import A_LENS, Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.lenses.registry import (
    DEFAULT_DISTORTION,
    DEFAULT_LENS,
    lens_model as lens_model_of,
    promote_lens,
)
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.geometry.rig import check_camera_names
from trinoc.numerics.precision import in_float64

# numerical: rounds in which images of other moments are taken out of their shots: a round that
# finds many shows the others better.
_MOST_SPLITS = 4


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
) -> RigFromShots:
    """The lenses and cameras of a rig together, from synchronous pictures of a board that moves.

    images : for each camera by name its pictures: a mapping from the name of the shot, or a list
        in the order of the shots, with None where there is none. A picture is an array, what
        `detect_target` found in one, or a function without arguments that returns one. Not every
        camera need see the board in every shot, but shots must connect all cameras. One camera
        alone is a rig, too.
    board : what is moved about: a Pattern, a Chessboard, a Charuco or an AprilGrid; or a BoardSet
        of several that are fixed to each other, whose places are found with the rig.
    lens : lenses that are known, of all cameras or by name; others are found. They are held as
        exact, or fitted under the covariance that `systematics` states of them. Where the shots
        refute one, the status is SUSPECT and the first note names it.
    lens_model : model of the lenses that are found. "default" is "brown_conrady", or "rational" or
        "kannala_brandt" where that would fold an image, and a note says so. "auto" takes that
        which, fitted to one half of the shots, tells best of the other half, and a note says why.
        "splined" corrects the best polynomial lens by B-splines, and "splined_" before the name of
        a model that one; "auto" does so where the shots ask for it.
    distortion : how many of its coefficients are fitted; as many as the shots determine unless
        given.
    same_lens : whether all cameras have one lens, such as pictures of one camera moved about.
    world : the shot whose board is the world's plane Z = 0, or the camera whose frame is the
        world's; by default the first of the shots that most cameras saw.
    method : "points" fits the places that the detector found, circles or corners; "pixels" goes on
        from there to the grey levels near every edge of the board.
    systematics : what is known of print and board: `print_size_sigma`, `print_scale_sigma` and
        `flatness_mm`, as `Systematics.typical` has them unless given; and `lens_covariance` of
        given lenses, without which they are exact.
    throw : whether a rig that is not determined raises; without it the result says so.
    progress : called with how many pictures of how many were looked at.

    Pictures without a board are named in `failures`; pictures of another moment, and boards that
    moved while the cameras looked, are named in `refused`.

    Raises
    ------
    InputError : no picture, or names that are not there; with
        "pixels" a detection where a picture is needed.
    CalibrationError : a camera that never sees the board, cameras that no shot connects or whose
        shots are out of step, or, with `throw`, parameters that the shots do not determine.
    """
    expect_method(method, board, images)
    check_camera_names(images)
    known = _given_lenses(lens, tuple(images))
    systematics = _known_of_rig(systematics)
    factors = _lens_factors(systematics, known, tuple(images))
    models, corrected = _models_to_try(lens_model, distortion, known)
    found = find_boards(images, board, progress)
    board = found.target
    detections = {
        camera: {
            (shot, index): each
            for shot, every in own.items()
            for index, each in split_by_board(every, board).items()
            if len(each) >= FEWEST_PLACES
        }
        for camera, own in found.detections.items()
    }
    _expect_boards(found, detections)
    observations = _Observations(
        detections, found.shots, board, known, factors, distortion, same_lens, systematics
    )
    cameras = tuple(detections)

    def fit_models(models: Sequence[type[AbstractLens]], corrected: bool | None = False) -> _RigFit:
        point_fit = _fit_best_lens(observations, models, corrected)
        return _finish_fit(point_fit, cameras, images if method == "pixels" else None, distortion)

    rig_fit, wider = fit_models(models, corrected), ()
    if lens_model == DEFAULT_LENS and distortion is None and not known:
        rig_fit, wider = fit_wider_model(rig_fit, lambda model: fit_models((model,)), cameras)
    placed = rig_fit.placed
    result = result_from_fit(
        rig_fit.fit,
        placed.shots,
        cameras,
        {camera: own for camera, own in known.items() if camera not in factors},
        world=world,
        held=rig_fit.held,
        remarks=(*found.remarks, *wider, *rig_fit.remarks),
        silent=rig_fit.silent,
        refused=(*placed.refused, *_remarks_on_places(found)),
        failures={f"{camera}, {shot}": why for (camera, shot), why in found.failures.items()},
        systematics=systematics.words,
    )
    if throw and result.rig is None:
        # A board that was read otherwise than stated may be why.
        raise CalibrationError(" ".join([result.notes[0], *found.remarks]), {}, result)
    return result


class _Observations(NamedTuple):
    """The detections of each camera by shot and board, the names of all shots, and what
    `calibrate_rig` was given of board and lenses."""

    detections: Mapping[str, Mapping[ShotBoard, Detection]]
    shots: Sequence[str]
    target: AbstractTarget
    known: Mapping[str, Intrinsics]
    lens_factors: Mapping[str, Float[np.ndarray, "_ _"]]
    distortion: int | None
    same_lens: bool
    systematics: Systematics

    @property
    def sizes_px(self) -> list[tuple[int, int]]:
        """(width, height) of each camera's pictures."""
        return [next(iter(own.values())).image_size_px for own in self.detections.values()]


class _PointFit(NamedTuple):
    """The rig where the fit of the places began, where it ended, and sentences on its lens."""

    placed: PlacedRig
    fit: RobustFit
    remarks: tuple[str, ...] = ()

    def correct_lenses(self, sizes_px: Sequence[tuple[int, int]]) -> "_PointFit":
        """The fit with its lenses corrected by splines, if they are not."""
        if isinstance(self.fit.problem.state.lenses, AbstractSplinedLens):
            return self
        return self._replace(fit=with_correction(self.fit, sizes_px))


class _RigFit(NamedTuple):
    """The rig and what is said of it.

    Fields
    ------
    placed : where the fit of the places began.
    fit : its end.
    silent : images whose grey levels do not take part.
    held : names of coefficients that the shots do not determine.
    remarks : sentences on the lenses.
    """

    placed: PlacedRig
    fit: RobustFit
    silent: Sequence[tuple[int, int, str]]
    held: tuple[str, ...]
    remarks: tuple[str, ...]


def _finish_fit(
    point_fit: "_PointFit",
    cameras: Sequence[str],
    images: Mapping[str, Pictures] | None,
    distortion: int | None,
) -> _RigFit:
    """The fit with the board's shape, grey levels, motion within shots, and coefficients fixed.

    images : whose grey levels take part; None for none.
    """
    fit, silent = with_board_shape(point_fit.fit), []
    if images is not None:
        fit, silent = fit_pixels(fit, grey_levels(images, tuple(cameras), point_fit.placed.shots))
        fit = with_own_correction_sigmas(with_board_shape(fit))
    end = _fit_images_apart(fit, cameras, distortion)
    if end is None:
        end = _fix_coefficients(fit, cameras, distortion)
    remarks = (*point_fit.remarks, *end.remarks)
    return _RigFit(point_fit.placed, end.fit, silent, end.held, remarks)


class _FixedFit(NamedTuple):
    """A fit, the names of coefficients that are not determined, and sentences on folded lenses."""

    fit: RobustFit
    held: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def _fit_images_apart(
    fit: RobustFit, cameras: Sequence[str], distortion: int | None
) -> _FixedFit | None:
    """The fit of cameras that do not look at one moment; None where they do, or where the images
    apart do not determine the lenses: then what the cameras share is kept."""
    apart_fit = with_images_apart(fit)
    if apart_fit is None:
        return None
    end = _fix_coefficients(with_board_shape(apart_fit), cameras, distortion)
    if assess_fit(end.fit).status is not Status.CONVERGED:
        return None
    with_motion = with_motion_between_images(end.fit, fit)
    return None if with_motion is None else end._replace(fit=with_motion)


def _fix_coefficients(fit: RobustFit, cameras: Sequence[str], distortion: int | None) -> _FixedFit:
    """The fit without coefficients that the shots do not determine, or that fold an image; as it
    is where their number was asked for."""
    if distortion is not None:
        return _FixedFit(fit)
    fit, held = hold_undetermined(fit)
    fit, remarks = hold_folding(fit, cameras)
    return _FixedFit(fit, held, remarks)


def _fit_best_lens(
    observations: _Observations, models: Sequence[type[AbstractLens]], corrected: bool | None
) -> _PointFit:
    """The fit by the one model, or by that of several which the shots call for, and why.

    corrected : whether the best of several is corrected by splines; None where the shots say.

    Raises CalibrationError where no model places the cameras.
    """
    if len(models) == 1:
        return _fit_points(observations, models[0])
    fits: dict[str, _PointFit] = {}
    errors, cameras = [], tuple(observations.detections)
    for model in models:
        try:
            fits[model.model] = _fit_points(observations, model)
        except CalibrationError as error:
            errors.append(error)
    if not fits:
        raise errors[0]

    def measure(each: _PointFit) -> HeldOut:
        return measure_held_out_errors(each.fit.problem, each.placed.shots, cameras)

    tried = {name: measure(each) for name, each in fits.items()}
    choice = choose_lens(tried)
    best = fits[choice.model]
    problem, rational = best.fit.problem, None
    # That the shots disagree is not taken off for splines, since a lens that is not described makes
    # them: shots held out tell it from a board that bends.
    spline = wider_lens_test(problem, add_splines(problem, observations.sizes_px), 1.0)
    if choice.model == BrownConrady.model:
        factor = shot_scatter(compute_information(problem)).variance_factor
        rational = rational_lens_test(problem, observations.sizes_px, factor)
    if corrected or (corrected is None and is_significant(spline)):
        wider = best.correct_lenses(observations.sizes_px)
        name = wider.fit.problem.state.lenses.model
        among = choose_lens({choice.model: tried[choice.model], name: measure(wider)})
        rms_px = {**choice.rms_px, **among.rms_px}
        choice = LensChoice(name if corrected else among.model, rms_px)
        best = wider if choice.model == name else best
    return best._replace(remarks=(choice_sentence(choice, rational, spline),))


def _fit_points(observations: _Observations, model: type[AbstractLens]) -> _PointFit:
    """The fit of the places that were detected."""
    if issubclass(model, AbstractSplinedLens):
        core = _fit_points(observations, model.core_model)
        return (
            core
            if observations.distortion is not None
            else core.correct_lenses(observations.sizes_px)
        )
    starts = {}
    for camera, own in observations.detections.items():
        given = observations.known.get(camera)
        _expect_size(camera, given, next(iter(own.values())))
        try:
            starts[camera] = start_camera(
                list(own.values()),
                observations.target,
                model,
                lens=None if given is None else given.lens,
            )
        except CalibrationError as error:
            raise CalibrationError(f'Camera "{camera}": {error}') from error
    placed = place_rig(
        starts, observations.detections, observations.shots, observations.target, observations.known
    )
    problem = anneal(_rig_problem(observations, placed, starts))
    for _ in range(_MOST_SPLITS):
        others = find_other_moments(problem)
        if not others:
            break
        placed = take_out(placed, problem, [other.view for other in others], tuple(starts))
        problem = anneal(with_shots_of_their_own(problem, [other.view for other in others]))
    return _PointFit(placed._replace(views=problem.views), fit_robustly(problem))


def _rig_problem(
    observations: _Observations, placed: PlacedRig, starts: Mapping[str, CameraStart]
) -> Problem:
    """Free are all cameras but the first, all boards, what is not exact of the board, and lenses
    that are not exact, each camera's own or one of all."""
    lenses, sizes = [start.lens for start in starts.values()], observations.sizes_px
    factors = [observations.lens_factors.get(camera) for camera in starts]
    lenses = [
        lens if factor is None else promote_lens(lens) for lens, factor in zip(lenses, factors)
    ]
    lens_of_camera = np.arange(len(starts))
    models = {type(lens) for lens in lenses if lens.has_distortion}
    if len(models) == 1:
        (only,) = models
        lenses = [promote_lens(lens, only) for lens in lenses]
    if observations.same_lens:
        if len(set(sizes)) > 1:
            raise InputError("same_lens is asked for, but the cameras' pictures differ in size.")
        middle = np.argsort([float(lens.focal_length_px[0]) for lens in lenses])[len(lenses) // 2]
        lenses, sizes, lens_of_camera = [lenses[middle]], sizes[:1], 0 * lens_of_camera
    count = len(lenses[0].parameter_names)
    free = np.ones((len(lenses), count), dtype=bool)
    if observations.distortion is not None:
        free[:, len(AFFINE_PARAMETERS) + observations.distortion :] = False
    free[[camera in observations.known for camera in starts][: len(lenses)]] = False
    problem = start_problem(
        placed.views,
        observations.target,
        lenses,
        placed.cam_from_rig,
        placed.rig_from_board,
        sizes,
        Freedom(lens_of_camera, free),
        observations.systematics,
        placed.set_from_board,
    )
    for number, factor in enumerate(factors[: len(lenses)]):
        if factor is not None:
            problem = with_lens_prior(problem, number, factor)
    return problem


def _models_to_try(
    name: str, distortion: int | None, known: Mapping[str, Intrinsics]
) -> tuple[tuple[type[AbstractLens], ...], bool | None]:
    """The models to be tried, and whether the best is corrected by splines; None where the shots
    say."""
    if name in ("auto", "splined"):
        if distortion is not None or known:
            raise InputError(
                f'lens_model is "{name}", which finds every lens and all its coefficients: name a '
                "model, or leave out distortion and lens."
            )
        return tuple(lens_model_of(each) for each in LENSES_TRIED), name == "splined" or None
    model = DEFAULT_DISTORTION if name == DEFAULT_LENS else lens_model_of(name)
    expect_coefficients(model, distortion)
    return (model,), False


def expect_coefficients(model: type[AbstractLens], distortion: int | None) -> None:
    """Raises InputError for a number of coefficients that nobody fits."""
    counts, names = model.coefficient_counts, model.coefficient_names
    if distortion is not None and distortion not in counts:
        raise InputError(
            f"distortion is {distortion}, but must be one of {', '.join(map(str, counts))} "
            f"coefficients of {', '.join(names[:20]) or model.model}, or None for as many as the "
            "pictures determine."
        )


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


def _known_of_rig(given: Systematics | None) -> Systematics:
    """What is known of board and lenses: aims are what is found here."""
    known = Systematics.typical({}) if given is None else given
    check_kind(known, Systematics, "knowledge of the board", "trinoc.Systematics")
    known.check()
    return known._replace(aim_sigma_mm=0.0)


def _lens_factors(
    systematics: Systematics, known: Mapping[str, Intrinsics], cameras: tuple[str, ...]
) -> dict[str, Float[np.ndarray, "_ _"]]:
    """Of each given lens that is not exact the factor of its covariance."""
    stated = systematics.lens_covariance
    without = [camera for camera in cameras if camera not in known]
    if isinstance(stated, Mapping):
        without = [camera for camera in without if camera in stated]
    if stated is not None and without:
        raise InputError(
            f'`lens_covariance` is that of a lens that is given, but "{without[0]}" has none in '
            "`lens`: add it, or leave its covariance out."
        )
    return systematics.lens_factors({camera: known.get(camera) for camera in cameras})


def _remarks_on_places(found: FoundBoards) -> list[str]:
    """A sentence on each image of which some places were left out at the detection."""
    return [
        f'{shot}: "{camera}": {remark}; left out.'
        for camera, own in found.detections.items()
        for shot, detection in own.items()
        for remark in detection.remarks
    ]


def _expect_boards(
    found: FoundBoards, detections: Mapping[str, Mapping[ShotBoard, Detection]]
) -> None:
    for camera, own in detections.items():
        if own:
            continue
        why = [words for (name, _), words in found.failures.items() if name == camera]
        reason = f" In its first picture: {why[0]}" if why else " It has no picture."
        if camera in found.causes:
            reason = f" {found.causes[camera]}"
        raise CalibrationError(f'Camera "{camera}" sees the board in no picture.{reason}')


def _expect_size(camera: str, lens: Intrinsics | None, detection: Detection) -> None:
    if lens is None or tuple(lens.image_size_px) == tuple(detection.image_size_px):
        return
    (width, height), (given_width, given_height) = detection.image_size_px, lens.image_size_px
    raise InputError(
        f'The lens of "{camera}" is for pictures of {given_width} x {given_height} px, but its '
        f"pictures have {width} x {height}: see that neither lenses nor folders are exchanged."
    )
