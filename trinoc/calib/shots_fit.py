"""Fit of lenses, cameras and boards to many shots: detections -> Problem -> robust fit -> tests.

`calibrate_rig` and `calibrate_intrinsics` share these steps; the second is a rig of one camera.

fit_shots
  fit_best_lens            the lens model with the least held-out error
    _fit_corners           starts, one Problem, robust fit
  with_board_shape         displacements of the board's corners, if the shots show any
  fit_pixels               grey levels in place of corners, if asked for
  _fit_unsynchronised      cameras that are not synchronised
  _fix_coefficients        fix coefficients that are undetermined or fold the image
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection, split_by_board
from trinoc.calib.folded_lens import fix_folding
from trinoc.calib.lens_selection import (
    HeldOutErrors,
    LensChoice,
    choice_sentence,
    choose_lens,
    is_significant,
    measure_held_out_errors,
)
from trinoc.calib.problem.board_shape import with_board_shape
from trinoc.calib.problem.coefficients import fix_undetermined
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.lens_correction import (
    add_splines,
    with_correction,
    with_estimated_correction_sigmas,
)
from trinoc.calib.problem.moments import find_unsynchronised_images, split_into_own_shots
from trinoc.calib.problem.outcome import assess_fit, shot_scatter
from trinoc.calib.problem.problem import (
    FreeLensParameters,
    Problem,
    with_fixed_aspect,
    with_lens_prior,
)
from trinoc.calib.problem.rao_test import rational_lens_test, wider_lens_test
from trinoc.calib.problem.robust_fit import RobustFit, anneal, fit_annealed
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.problem.status import Status
from trinoc.calib.problem.unsynchronised import fit_images_apart, fit_with_motion
from trinoc.calib.rig_pixels import fit_pixels, grey_levels
from trinoc.calib.starts.camera_start import FEWEST_POINTS, CameraStart, start_camera
from trinoc.calib.starts.pictures import BoardDetections, Pictures
from trinoc.calib.starts.placing import InitialRig, ShotBoard, move_to_own_shots, place_rig
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.lenses.splined import AbstractSplinedLens

# numerical: rounds that move images of other moments to shots of their own. After a round with
# many, the next round detects the others more reliably.
_MOST_SPLITS = 4
_CX, _CY = (AFFINE_PARAMETERS.index(name) for name in ("cx_px", "cy_px"))


@dataclasses.dataclass(frozen=True)
class LensFreedom:
    """Selection of the lens parameters that a fit estimates.

    Attributes
    ----------
    distortion : number of estimated distortion coefficients; None for all that the shots determine.
    same_lens : whether all cameras have one common lens.
    centred : whether the principal point is fixed at the middle of the image.
    aspect : fixed ratio fx / fy; None to estimate both focal lengths.
    """

    distortion: int | None = None
    same_lens: bool = False
    centred: bool = False
    aspect: float | None = None


@dataclasses.dataclass(frozen=True)
class ShotObservations:
    """Input of a fit to many shots: detections of the board, given lenses and priors.

    Attributes
    ----------
    detections : detections of each camera; the key is (name of the shot, index of the board).
    shots : names of all shots.
    target : the board, or the set of boards.
    lenses : given intrinsics, by the name of the camera.
    lens_factors : factor L of the covariance L L^T of each given lens that is not exact.
    freedom : which parameters of the lenses that are not given are estimated.
    systematics : standard deviations of the errors of the board.
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
        boards: BoardDetections,
        lenses: Mapping[str, Intrinsics],
        lens_factors: Mapping[str, Float[np.ndarray, "_ _"]],
        freedom: LensFreedom,
        systematics: Systematics,
        tuning: CalibTuning = TUNING,
    ) -> "ShotObservations":
        """Build the input from detections. Those with too few corners or circles are dropped.

        A detection of several boards of a set is split into one for each board.
        """
        detections = {
            camera: {
                (shot, board): part
                for shot, detection in shot_detections.items()
                for board, part in split_by_board(detection, boards.target).items()
                if len(part) >= FEWEST_POINTS
            }
            for camera, shot_detections in boards.detections.items()
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
        return [
            next(iter(detections.values())).image_size_px for detections in self.detections.values()
        ]


@dataclasses.dataclass(frozen=True)
class ShotsFit:
    """Fit of a rig to many shots.

    Attributes
    ----------
    initial_rig : initial poses of cameras and boards.
    fit : the fit.
    images_without_grey_levels : (camera index, shot index, reason) of images whose grey levels
        could not be used.
    fixed_coefficients : names of undetermined distortion coefficients, which were fixed at 0.
    remarks : notes on the lenses.
    """

    initial_rig: InitialRig
    fit: RobustFit
    images_without_grey_levels: Sequence[tuple[int, int, str]] = ()
    fixed_coefficients: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def correct_lenses(self, sizes_px: Sequence[tuple[int, int]]) -> "ShotsFit":
        """Fit again with the lenses corrected by splines, if all estimated parameters are
        determined.

        sizes_px : (width, height) of each camera's images.
        """
        is_splined = isinstance(self.fit.problem.state.lenses, AbstractSplinedLens)
        if is_splined or assess_fit(self.fit).status is not Status.CONVERGED:
            return self
        return dataclasses.replace(self, fit=with_correction(self.fit, sizes_px))

    def with_remarks(self, *sentences: str) -> "ShotsFit":
        """Copy with additional notes on the lenses."""
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
    observations : detections, given lenses and priors.
    models : lens models. Of several, the one with the smallest residuals in held-out shots is used.
    splined : whether this model is corrected by splines; None if a test of the residuals decides.
    images : images whose grey levels are fitted after the corners. Default: only corners are
        fitted.
    check : function that is called with the fit to the corners and raises an error if it must not
        be used.

    Raises
    ------
    CalibrationError : no lens model gives initial poses of the cameras.
    """
    corners = fit_best_lens(observations, models, splined)
    if check is not None:
        check(corners.fit)
    fit, without_grey_levels = with_board_shape(corners.fit), corners.images_without_grey_levels
    if images is not None:
        read_grey = grey_levels(images, observations.cameras, corners.initial_rig.shots)
        fit, without_grey_levels = fit_pixels(fit, read_grey)
        fit = with_estimated_correction_sigmas(with_board_shape(fit))
    shots_fit = dataclasses.replace(
        corners, fit=fit, images_without_grey_levels=without_grey_levels
    )
    unsynchronised = _fit_unsynchronised(shots_fit, observations)
    return _fix_coefficients(shots_fit, observations) if unsynchronised is None else unsynchronised


def _fit_unsynchronised(shots_fit: ShotsFit, observations: ShotObservations) -> ShotsFit | None:
    """Fit with a separate board pose for each image, for cameras that are not synchronised.

    None if the cameras are synchronised, or if single images do not determine the lenses.
    """
    images_fit = fit_images_apart(shots_fit.fit)
    if images_fit is None:
        return None
    unsynchronised = dataclasses.replace(shots_fit, fit=with_board_shape(images_fit))
    unsynchronised = _fix_coefficients(unsynchronised, observations)
    if assess_fit(unsynchronised.fit).status is not Status.CONVERGED:
        return None
    with_motion = fit_with_motion(unsynchronised.fit, shots_fit.fit)
    return None if with_motion is None else dataclasses.replace(unsynchronised, fit=with_motion)


def _fix_coefficients(shots_fit: ShotsFit, observations: ShotObservations) -> ShotsFit:
    """Fix at 0 the distortion coefficients that the shots do not determine, or that fold an image.

    A lens folds an image where it maps two rays to one pixel. The fit is unchanged if the user gave
    the number of coefficients.
    """
    if observations.freedom.distortion is not None:
        return shots_fit
    fit, fixed = fix_undetermined(shots_fit.fit)
    fit, sentences = fix_folding(fit, observations.cameras)
    return dataclasses.replace(shots_fit, fit=fit, fixed_coefficients=fixed).with_remarks(
        *sentences
    )


def fit_best_lens(
    observations: ShotObservations, models: Sequence[type[AbstractLens]], splined: bool | None
) -> ShotsFit:
    """Fit each lens model, and return the fit with the smallest residuals in held-out shots.

    Raises `CalibrationError` if no model gives initial poses of the cameras.

    splined : whether the best of several models is corrected by splines; None if a test decides.
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

    def measure(candidate: ShotsFit) -> HeldOutErrors:
        return measure_held_out_errors(
            candidate.fit.problem, candidate.initial_rig.shots, observations.cameras
        )

    held_out = {name: measure(candidate) for name, candidate in fits.items()}
    tuning = observations.tuning.answer
    choice = choose_lens(held_out, tuning)
    best = fits[choice.model]
    problem, rational = best.fit.problem, None
    # The scatter between shots is not taken off for splines: a lens that the model does not
    # describe causes it. Held-out shots distinguish it from a board that bends.
    spline = wider_lens_test(problem, add_splines(problem, observations.sizes_px), 1.0)
    if choice.model == BrownConrady.model:
        factor = shot_scatter(compute_information(problem)).variance_factor
        rational = rational_lens_test(problem, observations.sizes_px, factor)
    if splined or (splined is None and is_significant(spline, tuning.chance_of_lens)):
        splined_fit = best.correct_lenses(observations.sizes_px)
        name = splined_fit.fit.problem.state.lenses.model
        final_choice = choose_lens(
            {choice.model: held_out[choice.model], name: measure(splined_fit)}, tuning
        )
        rms_px = {**choice.rms_px, **final_choice.rms_px}
        choice = LensChoice(name if splined else final_choice.model, rms_px)
        best = splined_fit if choice.model == name else best
    return best.with_remarks(choice_sentence(choice, rational, spline))


def _fit_corners(observations: ShotObservations, model: type[AbstractLens]) -> ShotsFit:
    """Robust fit of one lens model to corners or circles.

    Raises `CalibrationError` if no initial lens of a camera, or no initial rig, can be computed.
    """
    if issubclass(model, AbstractSplinedLens):
        core = _fit_corners(observations, model.core_model)
        is_fixed_number = observations.freedom.distortion is not None
        return core if is_fixed_number else core.correct_lenses(observations.sizes_px)
    starts = {}
    for camera, camera_detections in observations.detections.items():
        lens = observations.lenses.get(camera)
        _expect_size(camera, lens, next(iter(camera_detections.values())))
        try:
            starts[camera] = start_camera(
                list(camera_detections.values()),
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
    initial_rig = place_rig(
        starts,
        observations.detections,
        observations.shots,
        observations.target,
        observations.lenses,
        tuning=observations.tuning,
    )
    problem = anneal(_build_problem(observations, initial_rig, starts))
    for _ in range(_MOST_SPLITS):
        unsynchronised = find_unsynchronised_images(problem)
        if not unsynchronised:
            break
        initial_rig = move_to_own_shots(
            initial_rig, problem, [other.view for other in unsynchronised], tuple(starts)
        )
        problem = anneal(split_into_own_shots(problem, [other.view for other in unsynchronised]))
    return ShotsFit(initial_rig._replace(views=problem.views), fit_annealed(problem))


def _build_problem(
    observations: ShotObservations, initial_rig: InitialRig, starts: Mapping[str, CameraStart]
) -> Problem:
    """Calibration problem at its initial values.

    The problem estimates the poses of all cameras but the first, the board poses, and the uncertain
    print and warp parameters of the board. It also estimates the lenses that are not exact: one per
    camera, or one for all.

    initial_rig : initial poses. starts : initial lens of each camera.
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
            raise InputError(
                "same_lens needs images of one size, but the images of the cameras differ in size: "
                "omit same_lens."
            )
        middle = np.argsort([float(lens.focal_length_px[0]) for lens in lenses])[len(lenses) // 2]
        lenses, sizes, lens_of_camera = [lenses[middle]], sizes[:1], 0 * lens_of_camera
    free = np.ones((len(lenses), len(lenses[0].parameter_names)), dtype=bool)
    free[:, [_CX, _CY]] = not freedom.centred
    if freedom.distortion is not None:
        free[:, len(AFFINE_PARAMETERS) + freedom.distortion :] = False
    free[[camera in observations.lenses for camera in starts][: len(lenses)]] = False
    problem = start_problem(
        initial_rig.views,
        observations.target,
        lenses,
        initial_rig.cam_from_rig,
        initial_rig.rig_from_board,
        sizes,
        FreeLensParameters(lens_of_camera, free),
        observations.systematics,
        initial_rig.set_from_board,
        observations.tuning,
    )
    for lens_index, factor in enumerate(factors[: len(lenses)]):
        if factor is not None:
            problem = with_lens_prior(problem, lens_index, factor)
    return problem if freedom.aspect is None else with_fixed_aspect(problem)


def _expect_size(camera: str, lens: Intrinsics | None, detection: Detection) -> None:
    if lens is None or tuple(lens.image_size_px) == tuple(detection.image_size_px):
        return
    (width, height), (given_width, given_height) = detection.image_size_px, lens.image_size_px
    raise InputError(
        f'The lens of "{camera}" is for images of {given_width} x {given_height} px, but its '
        f"images have {width} x {height}: check that lenses and folders are not exchanged."
    )
