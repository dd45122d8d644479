"""The lens of one camera from several pictures of the sheet: the problem of a rig of one camera.

The lens is estimated, except for what is fixed of it, together with the pose of the board in each
image and what is not exact of the board, as `calibrate_rig` does with one camera.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.advice.next_shot import advise_next_image
from trinoc.calib.detection.detection import Detection, split_by_board
from trinoc.calib.folded_lens import (
    FoldFindings,
    assess_folds,
    fit_wider_model,
    hold_folding,
    observed_pixels,
)
from trinoc.calib.intrinsics_result import IntrinsicsResult
from trinoc.calib.problem.board_shape import with_board_shape
from trinoc.calib.problem.coefficients import fewest_coefficients, hold_undetermined
from trinoc.calib.problem.lens_correction import with_correction, with_own_correction_sigmas
from trinoc.calib.problem.outcome import FitOutcome, assess_fit
from trinoc.calib.problem.problem import Freedom, Problem, cam_from_board, lens_number
from trinoc.calib.problem.robust_fit import RobustFit, errors_px, fit_robustly
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.result.calibration import Status
from trinoc.calib.rig_calibration import expect_coefficients
from trinoc.calib.rig_pixels import expect_method, fit_pixels, grey_levels
from trinoc.calib.shot_messages import (
    coefficients_sentence,
    list_refusals,
    misfit_sentence,
    notes_of_fit,
    reach_sentence,
    silent_sentences,
)
from trinoc.calib.starts.camera_start import FEWEST_PLACES, start_camera
from trinoc.calib.starts.pictures import find_boards
from trinoc.calib.starts.placing import ShotBoard, of_one_moment, place_rig
from trinoc.calib.targets.abstract_target import A_BOARD, AbstractTarget
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.propagation import field_places_px, field_sigma_px
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError, check_kind
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses import registry
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.registry import DEFAULT_DISTORTION, DEFAULT_LENS, simplify_lens
from trinoc.geometry.lenses.splined import AbstractSplinedLens, SplinedBrownConrady
from trinoc.numerics.precision import ArrayLike, in_float64

# Names that stand for models.
_CALLED = {"splined": SplinedBrownConrady.model}
_CAMERA = "the camera"
_FX, _FY, *_PRINCIPAL_POINT = range(len(AFFINE_PARAMETERS))


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
) -> IntrinsicsResult:
    """Focal lengths, principal point and distortion of a lens, with their covariance.

    images_or_detections : pictures by one camera at one zoom and focus, the board held
        differently in each; or what `detect_target` found in them.
    pattern : the board: a Pattern, a Chessboard, a Charuco or an AprilGrid; or a BoardSet of
        several that are fixed to each other.
    image_size_px : (width, height) that all pictures must have.
    distortion : number of coefficients, for Brown-Conrady 0, 1, 2, 4 or 5 of k1, k2, p1, p2, k3.
        As many as the pictures determine unless given; a note says how many they ask for.
    lens_model : name of the lens model, of `lenses.registry.LENS_MODELS`. "default" is
        "brown_conrady", or "rational" or "kannala_brandt" where that would fold the picture, and a
        note says so. "splined_" before the name of a polynomial model corrects it by B-splines;
        "splined" is Brown-Conrady's so corrected. It frees both focal lengths.
    principal_point : "free", or "centre" to hold it in the middle of the picture.
    pixel_pitch_mm : size of a pixel along u and v, where it is known: the lens then has a
        focal length in millimetres, too.
    aspect : "free", or "pitch" to hold fx / fy at what `pixel_pitch_mm` says (1 without it).
    method : "points" fits the circles' centres or corners; "pixels" goes on from there to the grey
        levels near every edge, as `calibrate_rig` does with one camera. It needs pictures, not
        detections, and frees both focal lengths.
    systematics : what is known of the board: `print_scale_sigma` and `flatness_mm`, as
        `Systematics.typical` has them unless given; `Systematics()` for a board that is exact. Its
        size does not matter to a lens.
    throw : whether an undetermined lens raises; without it the result says so by its status.

    Pictures in which no board is found are left out and named in `failures`. Starts from
    Zhang's method in OpenCV, then least squares over the lens, six parameters of each picture's
    pose and the board's scales and warp, with the exact centres of the circles' images.

    Raises
    ------
    InputError : no picture, pictures of different sizes, one picture given twice, or an
        option that is not one of those above.
    CalibrationError : no board in any picture, no lens that explains what was found, or, with
        `throw`, parameters that the pictures do not determine or a lens that folds the picture.
        The sentence names them and the picture to take next; `result` of the error is the
        IntrinsicsResult.
    """
    many = "a list of pictures, or of what detect_target found in them"
    check_kind(images_or_detections, (Sequence, np.ndarray), "list of pictures", many)
    check_kind(pattern, AbstractTarget, "pattern", A_BOARD)
    names = [f"picture {k + 1}" for k in range(len(images_or_detections))]
    pictures = {_CAMERA: dict(zip(names, images_or_detections, strict=True))}
    model = DEFAULT_DISTORTION
    if lens_model != DEFAULT_LENS:
        model = registry.lens_model(_CALLED.get(lens_model, lens_model))
    is_splined = issubclass(model, AbstractSplinedLens) and distortion is None
    core = model.core_model if issubclass(model, AbstractSplinedLens) else model
    expect_method(method, pattern, pictures)
    expect_coefficients(core, distortion)
    if principal_point not in ("free", "centre"):
        raise InputError(f'principal_point is {principal_point!r}; give "free" or "centre".')
    if aspect not in ("free", "pitch"):
        raise InputError(f'aspect is {aspect!r}; give "free" or "pitch".')
    if aspect != "free" and (method == "pixels" or is_splined):
        what = 'method="pixels"' if method == "pixels" else "A splined lens"
        raise InputError(f"{what} frees both focal lengths: leave out aspect.")
    known_board = Systematics.typical({}) if systematics is None else systematics
    known_board.check()
    known_board = known_board._replace(print_size_sigma=0.0, aim_sigma_mm=0.0)
    found = find_boards(pictures, pattern)
    pattern = found.target
    failures = {names.index(shot): why for (_, shot), why in found.failures.items()}
    detections = _usable(
        {names.index(shot): each for shot, each in found.detections[_CAMERA].items()},
        failures,
        image_size_px,
        "circles" if isinstance(pattern, Pattern) else "corners",
        found.causes.get(_CAMERA),
    )
    size_px = next(iter(detections.values())).image_size_px
    ratio = None
    if aspect == "pitch":
        ratio = 1.0 if pixel_pitch_mm is None else pixel_pitch_mm[1] / pixel_pitch_mm[0]
    seen = {
        (names[k], board): own
        for k, each in detections.items()
        for board, own in split_by_board(each, pattern).items()
        if len(own) >= FEWEST_PLACES
    }

    def fit_model(model: type[AbstractLens]) -> _LensFit:
        free = np.ones(len(model.parameter_names), dtype=bool)
        free[_PRINCIPAL_POINT] = principal_point == "free"
        if distortion is not None:
            free[len(AFFINE_PARAMETERS) + distortion :] = False
        start = _lens_problem(seen, names, pattern, model, free, ratio, known_board)
        return _fit_start(start, pattern, may_hold=distortion is None)

    lens_fit, wider = fit_model(core), ()
    if lens_model == DEFAULT_LENS and distortion is None:
        lens_fit, wider = fit_wider_model(lens_fit, fit_model, (_CAMERA,))
    start, fit = lens_fit.start, lens_fit.fit
    silent, remarks = [], (*found.remarks, *wider, *lens_fit.remarks)
    is_determined, core_fit = assess_fit(fit).status is Status.CONVERGED, fit
    if is_determined and is_splined:
        fit = with_correction(fit, [size_px])
    if is_determined and method == "pixels":
        fit, silent = fit_pixels(fit, grey_levels(pictures, (_CAMERA,), start.shots))
        fit = with_own_correction_sigmas(with_board_shape(fit))
    advised = core_fit.problem if is_splined else fit.problem
    index = tuple(names.index(shot) for shot in start.shots)
    result = _result_from_fit(
        fit, advised, lens_fit.held, silent, index, failures, pixel_pitch_mm, known_board, remarks
    )
    if throw and result.status is not Status.CONVERGED:
        advice = [] if result.next_image is None else [result.next_image.sentence]
        sentences = [result.notes[0], *found.remarks, *advice]
        raise CalibrationError(" ".join(dict.fromkeys(sentences)), {}, result)
    return result


class _LensStart(NamedTuple):
    """problem : where the fit starts. shots : name of the picture of each shot of the problem."""

    problem: Problem
    shots: tuple[str, ...]


class _LensFit(NamedTuple):
    """The end of the fit of the places that were detected.

    Fields
    ------
    start : the problem and its shots.
    fit : its end.
    held : names of coefficients that the shots do not determine.
    remarks : sentences on coefficients that were fixed.
    """

    start: _LensStart
    fit: RobustFit
    held: tuple[str, ...]
    remarks: tuple[str, ...]


def _fit_start(start: _LensStart, pattern: AbstractTarget, *, may_hold: bool) -> _LensFit:
    """Fit the places that were detected. `may_hold` : coefficients may be fixed at 0."""
    fit = fit_robustly(start.problem)
    misfit = misfit_sentence(fit)
    if misfit is not None:
        raise CalibrationError(_name_corners(pattern, misfit))
    fit = with_board_shape(fit)
    if not may_hold:
        return _LensFit(start, fit, (), ())
    fit, held = hold_undetermined(fit)
    fit, remarks = hold_folding(fit, (_CAMERA,))
    return _LensFit(start, fit, held, remarks)


def _name_corners(board: AbstractTarget, sentence: str) -> str:
    """A sentence on circles, for a board of corners."""
    if isinstance(board, Pattern):
        return sentence
    return sentence.replace("circle", "corner").replace("this pattern", "this board")


def _usable(
    found: Mapping[int, Detection],
    failures: dict[int, str],
    image_size_px: tuple[int, int] | None,
    places: str,
    cause: str | None,
) -> dict[int, Detection]:
    """Detections that can take part, by picture; those that cannot join `failures`.

    places : "circles" or "corners". cause : why no picture shows the board, where it is known.
    """
    if not found:
        reason = cause or f"In the first: {failures[0]}"
        raise CalibrationError(f"The board was found in no picture. {reason}")
    for index, detection in found.items():
        if image_size_px is not None and tuple(detection.image_size_px) != tuple(image_size_px):
            own, wanted = (
                " x ".join(map(str, s)) for s in (detection.image_size_px, image_size_px)
            )
            raise InputError(
                f"Picture {index + 1} has {own} pixels, but {wanted} are expected: give pictures "
                "of one camera at one resolution."
            )
        for other, earlier in found.items():
            if other < index and np.array_equal(detection.centres_px, earlier.centres_px):
                raise InputError(
                    f"Pictures {other + 1} and {index + 1} are the same: give each picture once."
                )
    for index, detection in found.items():
        if len(detection) < FEWEST_PLACES:
            failures[index] = f"only {len(detection)} {places} were found: show more of the board."
    usable = {index: each for index, each in found.items() if len(each) >= FEWEST_PLACES}
    if not usable:
        raise CalibrationError(
            f"No picture shows {FEWEST_PLACES} {places} of the board: show more of it."
        )
    return usable


def _lens_problem(
    detections: Mapping[ShotBoard, Detection],
    names: Sequence[str],
    board: AbstractTarget,
    model: type[AbstractLens],
    free: Bool[np.ndarray, "q"],
    ratio: float | None,
    systematics: Systematics,
) -> _LensStart:
    """The rig of one camera. `names` : of all pictures, in order. `ratio` : at which fx / fy is
    held; both change by one step then."""
    every = list(detections.values())
    start = start_camera(every, board, model, aspect=ratio)
    placed = place_rig({_CAMERA: start}, {_CAMERA: detections}, names, board)
    if ratio is not None:
        free = free & (np.arange(len(free)) != _FY)
    problem = start_problem(
        placed.views,
        board,
        [start.lens],
        placed.cam_from_rig,
        placed.rig_from_board,
        [every[0].image_size_px],
        Freedom(np.zeros(1, dtype=int), free[None]),
        systematics,
        placed.set_from_board,
    )
    shots = tuple(of_one_moment(shot, _CAMERA) for shot in placed.shots)
    if ratio is None:
        return _LensStart(problem, shots)
    basis = np.array(problem.parametrization.lens_basis)
    basis[0, _FY, _FX] = basis[0, _FY, _FY]
    parametrization = dataclasses.replace(problem.parametrization, lens_basis=basis)
    return _LensStart(problem._replace(parametrization=parametrization), shots)


def _result_from_fit(
    fit: RobustFit,
    advised: Problem,
    held: Sequence[str],
    silent: Sequence[tuple[int, int, str]],
    index: tuple[int, ...],
    failures: dict[int, str],
    pixel_pitch_mm: tuple[float, float] | None,
    systematics: Systematics,
    remarks: tuple[str, ...],
) -> IntrinsicsResult:
    """Assemble the result of a lens, with its notes and the picture to take next.

    advised : the problem to which a picture is added: that of the core where splines correct it.
    """
    problem, outcome = fit.problem, assess_fit(fit)
    status, information, *_ = outcome
    lens, size_px = lens_number(problem, 0), problem.image_sizes_px[0]
    names = lens.parameter_names
    free = [k for k in information.free if k < problem.slices.lenses.stop]
    covariance, gauge = _lens_covariance(problem, outcome)
    values = np.array(lens.parameters)
    values[gauge] = np.nan
    gauge_names = tuple(names[k] for k in np.flatnonzero(gauge))

    intrinsics = Intrinsics.of_lens(simplify_lens(lens), size_px, pixel_pitch_mm)
    folds = FoldFindings(None, ())
    if status is Status.CONVERGED:
        folds = assess_folds({_CAMERA: intrinsics}, {_CAMERA: observed_pixels(problem.views, 0)})
        status = Status.CONVERGED if folds.failure is None else Status.SUSPECT

    def where(_: int, shot: int) -> str:
        return f"Picture {index[shot] + 1}"

    notes = [
        *filter(None, [folds.failure]),
        *notes_of_fit(fit, outcome, gauge_names, (_CAMERA,), held, (*remarks, *folds.notes)),
    ]
    free_names = tuple(names[k] for k in free)
    coefficients = [name for name in lens.coefficient_names if name in free_names]
    if coefficients and status is Status.CONVERGED and not isinstance(lens, AbstractSplinedLens):
        all_names = lens.coefficient_names
        count, gain = fewest_coefficients(lens, coefficients, covariance)
        extra = [name for name in coefficients if name not in all_names[:count]]
        notes += [coefficients_sentence(count, all_names, extra, gain)] if extra else []
    notes += [*list_refusals(fit, where), *silent_sentences(silent, where)]
    reach = reach_sentence(problem) if coefficients else None
    notes += [] if reach is None else [_name_corners(problem.target, reach)]
    detected = problem._replace(views=tuple(v._replace(shown=None) for v in problem.views))
    reduced = float(problem.sigma_factor[0] ** 2 * fit.chi_square / max(fit.freedom, 1))
    return IntrinsicsResult(
        lens=intrinsics if status is Status.CONVERGED else None,
        status=status,
        parameters=names,
        values=values if status is not Status.NOT_CONVERGED else np.full_like(values, np.nan),
        covariance=covariance,
        free=free_names,
        gauge=gauge_names,
        rank=sum(
            int(k < problem.slices.lenses.stop)
            for row, k in enumerate(information.free)
            if row not in information.observability.gauge
        ),
        reduced_chi_square=reduced if fit.freedom > 0 else float("nan"),
        field_sigma_px=np.asarray(
            field_sigma_px(lens.with_parameters(values), covariance, field_places_px(size_px))
        ),
        cam_from_world=np.stack(
            [cam_from_board(problem.state, view).cam_from_world for view in problem.views]
        ),
        detections=[view.detection for view in problem.views],
        residuals_px=errors_px(detected),
        used=[view.used for view in problem.views],
        image_index=tuple(index[view.shot] for view in problem.views),
        failures=failures,
        notes=tuple(notes),
        next_image=advise_next_image(
            advised,
            _lens_information(advised, problem, outcome),
            outcome.variance_factor,
            gauge_names,
        ),
        pattern=problem.target,
        systematics=systematics.words,
    )


def _lens_information(
    core: Problem, wide: Problem, outcome: FitOutcome
) -> Float[np.ndarray, "f f"]:
    """On the free steps of a lens, or of its core, whatever the splines are.

    wide : the problem that was fitted, with the splines if there are any.
    """
    information, free = outcome.information, np.flatnonzero(core.free)
    if len(free) < len(information.free):
        # The steps of the core's lens come first, those of its board behind those of all lenses.
        of_board = np.flatnonzero(information.free >= wide.slices.lenses.stop)
        of_lens = int((free < core.slices.lenses.stop).sum())
        rows = np.concatenate([np.arange(of_lens), of_board[: len(free) - of_lens]])
        return np.linalg.inv(outcome.covariance[np.ix_(rows, rows)])
    whole = information.of_shot.sum(axis=0)[np.ix_(free, free)] / outcome.variance_factor
    return whole + information.prior


def _lens_covariance(
    problem: Problem, outcome: FitOutcome
) -> tuple[Float[np.ndarray, "q q"], Bool[np.ndarray, "q"]]:
    """Of the lens's parameters, zero for those that are held, NaN for those that are open; and
    which these are."""
    information = outcome.information
    by_lens = np.asarray(problem.parametrization.lens_basis)[0]
    by_head = np.pad(by_lens, ((0, 0), (0, len(problem.free) - by_lens.shape[1])))
    by_free = by_head[:, information.free]
    covariance = by_free @ outcome.covariance @ by_free.T
    is_open = np.any(by_free[:, list(information.observability.gauge)] != 0, axis=1)
    covariance[is_open], covariance[:, is_open] = np.nan, np.nan
    return covariance, is_open
