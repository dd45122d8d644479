"""Calibration of a single lens. The result is a rig of one camera, in its own frame."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from trinoc.calib.advice.next_shot import next_shot
from trinoc.calib.detection.detection import Detection
from trinoc.calib.folded_lens import fit_wider_model
from trinoc.calib.problem.robust_fit import RobustFit
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.rig_calibration import models_to_try
from trinoc.calib.rig_pixels import expect_method
from trinoc.calib.sentences import capitalise
from trinoc.calib.shot_notes import misfit_of_lens
from trinoc.calib.shots_assembly import result_of_shots
from trinoc.calib.shots_fit import LensFreedom, ShotObservations, ShotsFit, fit_shots
from trinoc.calib.starts.camera_start import FEWEST_POINTS
from trinoc.calib.starts.pictures import BoardDetections, find_boards
from trinoc.calib.targets.abstract_target import A_BOARD, AbstractTarget
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError, check_kind
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.registry import DEFAULT_LENS
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.numerics.precision import ArrayLike, in_float64

# Name of the only camera in the result.
CAMERA = "camera"


@in_float64
def calibrate_intrinsics(
    images_or_detections: Sequence[ArrayLike | Detection],
    pattern: AbstractTarget,
    *,
    image_size_px: tuple[int, int] | None = None,
    distortion: int | None = None,
    lens_model: str = DEFAULT_LENS,
    principal_point: str = "free",
    pixel_pitch_mm: tuple[float, float] | None = None,
    aspect: str = "free",
    method: Literal["points", "pixels"] = "points",
    systematics: Systematics | None = None,
    throw: bool = True,
    tuning: CalibTuning = TUNING,
) -> CalibrationResult:
    """Calibrate focal lengths, principal point and distortion of a lens from images of a board.

    Parameters
    ----------
    images_or_detections : images of one camera with one zoom and focus, with the board at another
        pose in each; or results of `detect_target`.
    pattern : a Pattern, Chessboard, Charuco or AprilGrid; or a BoardSet of several boards that are
        fixed to each other.
    image_size_px : (width, height) that all images must have.
    distortion : number of estimated distortion coefficients. For Brown-Conrady it is 0, 1, 2, 4 or
        5 of k1, k2, p1, p2, k3. Default: all that the images determine; a note reports how many the
        residuals need.
    lens_model : name of the lens model; see `calibrate_rig`.
    principal_point : "free" estimates it; "centre" fixes it at the middle of the image.
    pixel_pitch_mm : width and height of a pixel, mm. With it, the result also has a focal length in
        mm.
    aspect : "free" estimates both focal lengths; "pitch" fixes fx / fy at the ratio of
        `pixel_pitch_mm` (1 without it).
    method : "points" fits circles or corners. "pixels" then also fits the grey levels near every
        edge of the board; it needs images and a free aspect.
    systematics : errors of the board, `print_scale_sigma` and `flatness_mm`. Default:
        `Systematics.typical`. `Systematics()` assumes an exact board. The print size has no effect
        on a lens.
    throw : whether an undetermined lens raises an error. If False, the status of the result reports
        it.
    tuning : constants of calibration; a benchmark or a study changes them.

    Returns
    -------
    A rig of one camera named "camera", in its own frame. The lens is `result.lens`, and its sigmas
    are `result.sigma("fx_px")` and so on. `failures` names the images without a board.

    Raises
    ------
    InputError : there is no image, images have different sizes, one image is given twice, or an
        option is unknown.
    CalibrationError : no image shows the board, or no lens fits the detections. With `throw`, also
        a lens that is not determined or that folds the image. The error names the parameters and
        the next image to take.

    Notes
    -----
    Zhang's method (OpenCV) gives the initial values. Least squares then estimates the lens, the
    pose of the board in each image, and the print scales and the warp of the board. For circles,
    the exact centre of the elliptical image is predicted.
    """
    image_list = "a list of images, or of the results of detect_target for these images"
    check_kind(images_or_detections, (Sequence, np.ndarray), "list of pictures", image_list)
    check_kind(pattern, AbstractTarget, "pattern", A_BOARD)
    if principal_point not in ("free", "centre"):
        raise InputError(f'principal_point is {principal_point!r}; give "free" or "centre".')
    if aspect not in ("free", "pitch"):
        raise InputError(f'aspect is {aspect!r}; give "free" or "pitch".')
    models, splined = models_to_try(lens_model, distortion, {})
    is_splined = splined is not False or issubclass(models[0], AbstractSplinedLens)
    if aspect != "free" and (method == "pixels" or is_splined):
        option = 'method="pixels"' if method == "pixels" else "A splined lens"
        raise InputError(f"{option} estimates both focal lengths: omit aspect.")
    shots = [f"picture {k + 1}" for k in range(len(images_or_detections))]
    images = {CAMERA: dict(zip(shots, images_or_detections, strict=True))}
    expect_method(method, pattern, images)
    board_errors = Systematics.typical({}, tuning=tuning) if systematics is None else systematics
    board_errors.check()
    board_errors = board_errors._replace(print_size_sigma=0.0, aim_sigma_mm=0.0)
    boards = find_boards(images, pattern, tuning=tuning)
    _expect_usable(boards, image_size_px)
    fixed_aspect = None
    if aspect == "pitch":
        fixed_aspect = 1.0 if pixel_pitch_mm is None else pixel_pitch_mm[1] / pixel_pitch_mm[0]
    freedom = LensFreedom(distortion, centred=principal_point == "centre", aspect=fixed_aspect)
    observations = ShotObservations.of_boards(boards, {}, {}, freedom, board_errors, tuning)

    def expect_one_lens(fit: RobustFit) -> None:
        misfit = misfit_of_lens(fit, _point_kind(boards.target))
        if misfit is not None:
            raise CalibrationError(misfit)

    def fit_models(
        models: tuple[type[AbstractLens], ...], splined: bool | None = False
    ) -> ShotsFit:
        levels = images if method == "pixels" else None
        return fit_shots(
            observations, models, splined=splined, images=levels, check=expect_one_lens
        )

    shots_fit = fit_models(models, splined)
    if lens_model == DEFAULT_LENS and distortion is None:
        shots_fit = fit_wider_model(shots_fit, lambda model: fit_models((model,)), (CAMERA,))
    result = result_of_shots(
        shots_fit,
        boards,
        observations,
        {},
        world=CAMERA,
        method=method,
        pixel_pitch_mm=pixel_pitch_mm,
        is_lens=True,
    )
    if throw and not result.has_rig:
        advice = next_shot(result) if result.solved_problem is not None else None
        sentences = [result.notes[0], *boards.remarks, advice.sentence if advice else ""]
        raise CalibrationError(" ".join(dict.fromkeys(filter(None, sentences))), {}, result)
    return result


def _point_kind(board: AbstractTarget) -> str:
    return "circles" if isinstance(board, Pattern) else "corners"


def _expect_usable(boards: BoardDetections, image_size_px: tuple[int, int] | None) -> None:
    """Raise an error if the detections cannot be used, and drop those with too few points.

    Dropped detections are moved to `boards.failures`.

    Raises
    ------
    InputError : an image has another size than `image_size_px`, or one image is given twice.
    CalibrationError : no usable image is left.
    """
    detections, point_kind = boards.detections[CAMERA], _point_kind(boards.target)
    if not detections:
        reason = boards.causes.get(CAMERA) or f"First image: {next(iter(boards.failures.values()))}"
        raise CalibrationError(f"The board was found in no image. {reason}")
    earlier: dict[str, Detection] = {}
    for shot, detection in detections.items():
        if image_size_px is not None and tuple(detection.image_size_px) != tuple(image_size_px):
            actual, expected = (
                " x ".join(map(str, size)) for size in (detection.image_size_px, image_size_px)
            )
            raise InputError(
                f"{capitalise(shot)} has {actual} pixels, but the other images have {expected}: "
                "give images of one camera at one resolution."
            )
        for name, other in earlier.items():
            if np.array_equal(other.centres_px, detection.centres_px):
                raise InputError(
                    f"{capitalise(name)} and {shot} are the same image: give each image once."
                )
        earlier[shot] = detection
    for shot, detection in earlier.items():
        if len(detection) < FEWEST_POINTS:
            boards.failures[CAMERA, shot] = (
                f"only {len(detection)} {point_kind} were found: show more of the board."
            )
            del detections[shot]
    if not detections:
        raise CalibrationError(
            f"No image shows {FEWEST_POINTS} {point_kind} of the board: show more of it."
        )
