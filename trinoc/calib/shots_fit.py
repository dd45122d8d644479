"""Fit of lenses, cameras and boards to many shots: detections -> Problem -> robust fit -> tests.

`calibrate_rig` and `calibrate_intrinsics` share this path; the second is a rig of one camera.

    fit_shots
      fit_best_lens            of several lens models the one with the least held-out error
        _fit_corners           starts, one Problem, robust fit
      with_board_shape         the board's corners off their drawing, where the shots show it
      fit_pixels               grey levels in place of corners, if asked for
      _fit_images_apart        cameras that do not look at one moment
      _fix_coefficients        coefficients that are not determined, or that fold the image
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection, split_by_board
from trinoc.calib.folded_lens import hold_folding
from trinoc.calib.lens_selection import (
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
from trinoc.calib.problem.problem import (
    Freedom,
    Problem,
    with_fixed_aspect,
    with_lens_prior,
)
from trinoc.calib.problem.rao_test import rational_lens_test, wider_lens_test
from trinoc.calib.problem.robust_fit import RobustFit, anneal, fit_annealed
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.problem.status import Status
from trinoc.calib.problem.unsynchronised import with_images_apart, with_motion_between_images
from trinoc.calib.rig_pixels import fit_pixels, grey_levels
from trinoc.calib.starts.camera_start import FEWEST_PLACES, CameraStart, start_camera
from trinoc.calib.starts.pictures import FoundBoards, Pictures
from trinoc.calib.starts.placing import PlacedRig, ShotBoard, place_rig, take_out
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.lenses.splined import AbstractSplinedLens

# numerical: rounds in which images of other moments are taken out of their shots: a round that
# finds many shows the others better.
_MOST_SPLITS = 4
_CX, _CY = (AFFINE_PARAMETERS.index(name) for name in ("cx_px", "cy_px"))


@dataclasses.dataclass(frozen=True)
class LensFreedom:
    """What is fixed of the lenses that are fitted.

    Fields
    ------
    distortion : number of coefficients; None for as many as the shots determine.
    same_lens : whether all cameras share one lens.
    centred : whether the principal point is fixed at the middle of the image.
    aspect : fx / fy where it is fixed.
    """

    distortion: int | None = None
    same_lens: bool = False
    centred: bool = False
    aspect: float | None = None


@dataclasses.dataclass(frozen=True)
class ShotObservations:
    """Detections of a board in many shots, and what is known beforehand.

    Fields
    ------
    detections : for each camera, by shot and number of the board.
    shots : names of all shots.
    target : the board.
    lenses : intrinsics that were given, by camera.
    lens_factors : for given lenses that are not exact, a factor of their covariance.
    freedom : what is fixed of the other lenses.
    systematics : errors of the board.
    tuning : constants of the method.
    """

    detections: Mapping[str, Mapping[ShotBoard, Detection]]
    shots: Sequence[str]
    target: AbstractTarget
    lenses: Mapping[str, Intrinsics]
    lens_factors: Mapping[str, Float[np.ndarray, "_ _"]]
    freedom: LensFreedom
    systematics: Systematics
    tuning: CalibTuning = TUNING

    @classmethod
    def of_boards(
        cls,
        boards: FoundBoards,
        lenses: Mapping[str, Intrinsics],
        lens_factors: Mapping[str, Float[np.ndarray, "_ _"]],
        freedom: LensFreedom,
        systematics: Systematics,
        tuning: CalibTuning = TUNING,
    ) -> "ShotObservations":
        """Detections with enough corners or circles, each board of a set apart."""
        detections = {
            camera: {
                (shot, board): part
                for shot, detection in of_camera.items()
                for board, part in split_by_board(detection, boards.target).items()
                if len(part) >= FEWEST_PLACES
            }
            for camera, of_camera in boards.detections.items()
        }
        return cls(
            detections,
            boards.shots,
            boards.target,
            lenses,
            lens_factors,
            freedom,
            systematics,
            tuning,
        )

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of all cameras."""
        return tuple(self.detections)

    @property
    def sizes_px(self) -> list[tuple[int, int]]:
        """(width, height) of each camera's images."""
        return [next(iter(each.values())).image_size_px for each in self.detections.values()]


@dataclasses.dataclass(frozen=True)
class ShotsFit:
    """The fit of a rig to many shots.

    Fields
    ------
    placed : cameras and boards where the fit started.
    fit : its end.
    silent : (camera, shot, reason) of images whose grey levels do not take part.
    held : names of coefficients that the shots do not determine, fixed at 0.
    remarks : sentences on the lenses.
    """

    placed: PlacedRig
    fit: RobustFit
    silent: Sequence[tuple[int, int, str]] = ()
    held: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def correct_lenses(self, sizes_px: Sequence[tuple[int, int]]) -> "ShotsFit":
        """The fit with lenses corrected by splines, where all that is free is determined."""
        is_splined = isinstance(self.fit.problem.state.lenses, AbstractSplinedLens)
        if is_splined or assess_fit(self.fit).status is not Status.CONVERGED:
            return self
        return dataclasses.replace(self, fit=with_correction(self.fit, sizes_px))

    def with_remarks(self, *sentences: str) -> "ShotsFit":
        """The same with more sentences on the lenses."""
        return dataclasses.replace(self, remarks=(*self.remarks, *sentences))


def fit_shots(
    observations: ShotObservations,
    models: Sequence[type[AbstractLens]],
    *,
    splined: bool | None = False,
    images: Mapping[str, Pictures] | None = None,
    check: Callable[[RobustFit], None] | None = None,
) -> ShotsFit:
    """Fit lenses, cameras and boards to many shots.

    Parameters
    ----------
    models : lens models; of several the one with the least held-out error is chosen.
    splined : whether that is corrected by splines; None where a test of the residuals decides.
    images : whose grey levels are fitted after the corners; None for none.
    check : called with the fit of the corners; it raises an error for one that must not be used.

    Raises
    ------
    CalibrationError : no model places the cameras.
    """
    corners = fit_best_lens(observations, models, splined)
    if check is not None:
        check(corners.fit)
    fit, silent = with_board_shape(corners.fit), corners.silent
    if images is not None:
        read_grey = grey_levels(images, observations.cameras, corners.placed.shots)
        fit, silent = fit_pixels(fit, read_grey)
        fit = with_own_correction_sigmas(with_board_shape(fit))
    whole = dataclasses.replace(corners, fit=fit, silent=silent)
    apart = _fit_images_apart(whole, observations)
    return _fix_coefficients(whole, observations) if apart is None else apart


def _fit_images_apart(whole: ShotsFit, observations: ShotObservations) -> ShotsFit | None:
    """The fit of cameras that do not look at one moment.

    None where they do, or where their images apart do not determine the lenses: then what the
    cameras share is kept.
    """
    apart_fit = with_images_apart(whole.fit)
    if apart_fit is None:
        return None
    apart = dataclasses.replace(whole, fit=with_board_shape(apart_fit))
    apart = _fix_coefficients(apart, observations)
    if assess_fit(apart.fit).status is not Status.CONVERGED:
        return None
    with_motion = with_motion_between_images(apart.fit, whole.fit)
    return None if with_motion is None else dataclasses.replace(apart, fit=with_motion)


def _fix_coefficients(whole: ShotsFit, observations: ShotObservations) -> ShotsFit:
    """The fit without coefficients that the shots do not determine, or that fold an image.

    Where their number was given, the fit as it is.
    """
    if observations.freedom.distortion is not None:
        return whole
    fit, held = hold_undetermined(whole.fit)
    fit, sentences = hold_folding(fit, observations.cameras)
    return dataclasses.replace(whole, fit=fit, held=held).with_remarks(*sentences)


def fit_best_lens(
    observations: ShotObservations, models: Sequence[type[AbstractLens]], splined: bool | None
) -> ShotsFit:
    """The fit by the only model, or by that of several which errs least on held-out shots.

    splined : whether the best of several is corrected by splines; None where a test decides.

    Raises CalibrationError where no model places the cameras.
    """
    if len(models) == 1:
        return _fit_corners(observations, models[0])
    fits: dict[str, ShotsFit] = {}
    errors = []
    for model in models:
        try:
            fits[model.model] = _fit_corners(observations, model)
        except CalibrationError as error:
            errors.append(error)
    if not fits:
        raise errors[0]

    def measure(each: ShotsFit) -> HeldOut:
        return measure_held_out_errors(each.fit.problem, each.placed.shots, observations.cameras)

    tried = {name: measure(each) for name, each in fits.items()}
    tuning = observations.tuning.answer
    choice = choose_lens(tried, tuning)
    best = fits[choice.model]
    problem, rational = best.fit.problem, None
    # The scatter between shots is not taken off for splines: a lens that the model does not
    # describe causes it. Held-out shots distinguish it from a board that bends.
    spline = wider_lens_test(problem, add_splines(problem, observations.sizes_px), 1.0)
    if choice.model == BrownConrady.model:
        factor = shot_scatter(compute_information(problem)).variance_factor
        rational = rational_lens_test(problem, observations.sizes_px, factor)
    if splined or (splined is None and is_significant(spline, tuning.chance_of_lens)):
        wider = best.correct_lenses(observations.sizes_px)
        name = wider.fit.problem.state.lenses.model
        among = choose_lens({choice.model: tried[choice.model], name: measure(wider)}, tuning)
        rms_px = {**choice.rms_px, **among.rms_px}
        choice = LensChoice(name if splined else among.model, rms_px)
        best = wider if choice.model == name else best
    return best.with_remarks(choice_sentence(choice, rational, spline))


def _fit_corners(observations: ShotObservations, model: type[AbstractLens]) -> ShotsFit:
    """The robust fit of corners or circles by one lens model.

    Raises CalibrationError where a camera, or the rig, finds no start.
    """
    if issubclass(model, AbstractSplinedLens):
        core = _fit_corners(observations, model.core_model)
        given = observations.freedom.distortion is not None
        return core if given else core.correct_lenses(observations.sizes_px)
    starts = {}
    for camera, of_camera in observations.detections.items():
        lens = observations.lenses.get(camera)
        _expect_size(camera, lens, next(iter(of_camera.values())))
        try:
            starts[camera] = start_camera(
                list(of_camera.values()),
                observations.target,
                model,
                lens=None if lens is None else lens.lens,
                aspect=observations.freedom.aspect,
                tuning=observations.tuning,
            )
        except CalibrationError as error:
            if len(observations.cameras) == 1:
                raise
            raise CalibrationError(f'Camera "{camera}": {error}') from error
    placed = place_rig(
        starts,
        observations.detections,
        observations.shots,
        observations.target,
        observations.lenses,
        tuning=observations.tuning,
    )
    problem = anneal(_build_problem(observations, placed, starts))
    for _ in range(_MOST_SPLITS):
        others = find_other_moments(problem)
        if not others:
            break
        placed = take_out(placed, problem, [other.view for other in others], tuple(starts))
        problem = anneal(with_shots_of_their_own(problem, [other.view for other in others]))
    return ShotsFit(placed._replace(views=problem.views), fit_annealed(problem))


def _build_problem(
    observations: ShotObservations, placed: PlacedRig, starts: Mapping[str, CameraStart]
) -> Problem:
    """The problem at its start.

    Free are all cameras but the first, all boards, what is not exact of the board, and lenses that
    are not exact, each camera's own or one of all.
    """
    freedom, lenses = observations.freedom, [start.lens for start in starts.values()]
    sizes = observations.sizes_px
    factors = [observations.lens_factors.get(camera) for camera in starts]
    lenses = [
        lens if factor is None else promote_lens(lens) for lens, factor in zip(lenses, factors)
    ]
    lens_of_camera = np.arange(len(starts))
    models = {type(lens) for lens in lenses if lens.has_distortion}
    if len(models) == 1:
        (only,) = models
        lenses = [promote_lens(lens, only) for lens in lenses]
    if freedom.same_lens:
        if len(set(sizes)) > 1:
            raise InputError("same_lens is asked for, but the cameras' pictures differ in size.")
        middle = np.argsort([float(lens.focal_length_px[0]) for lens in lenses])[len(lenses) // 2]
        lenses, sizes, lens_of_camera = [lenses[middle]], sizes[:1], 0 * lens_of_camera
    free = np.ones((len(lenses), len(lenses[0].parameter_names)), dtype=bool)
    free[:, [_CX, _CY]] = not freedom.centred
    if freedom.distortion is not None:
        free[:, len(AFFINE_PARAMETERS) + freedom.distortion :] = False
    free[[camera in observations.lenses for camera in starts][: len(lenses)]] = False
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
        observations.tuning,
    )
    for number, factor in enumerate(factors[: len(lenses)]):
        if factor is not None:
            problem = with_lens_prior(problem, number, factor)
    return problem if freedom.aspect is None else with_fixed_aspect(problem)


def _expect_size(camera: str, lens: Intrinsics | None, detection: Detection) -> None:
    if lens is None or tuple(lens.image_size_px) == tuple(detection.image_size_px):
        return
    (width, height), (given_width, given_height) = detection.image_size_px, lens.image_size_px
    raise InputError(
        f'The lens of "{camera}" is for pictures of {given_width} x {given_height} px, but its '
        f"pictures have {width} x {height}: see that neither lenses nor folders are exchanged."
    )
