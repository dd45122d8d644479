"""Selection of the sentences for one camera over the sheet: its failure, or notes on fit and
priors.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib import sentences
from trinoc.calib.adjustment.adjustment import Adjustment
from trinoc.calib.adjustment.agreement import autocorrelation_of_circles
from trinoc.calib.adjustment.prior_pulls import PriorPull, list_kinds
from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.problem.sheet_problem import SheetCamera
from trinoc.calib.result.calibration import FixedParameterTest, Status
from trinoc.calib.tuning.every_group import TUNING, AnswerTuning
from trinoc.geometry.intrinsics import Intrinsics, describe_fold, describe_unusable_fold
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import PARAMETER_NAMES
from trinoc.numerics.information import Observability
from trinoc.numerics.tails import chi_square_tail, normal_limit

# numerical: rows of a lens.
_PRINCIPAL_POINT = slice(2, 4)


def failure_of_camera(
    fit: Adjustment | None,
    status: Status,
    observability: Observability,
    detection: Detection,
    lens: Intrinsics,
    lens_factor: Float[np.ndarray, "_k _r"] | None,
    model: PoseModel,
    tuning: AnswerTuning,
) -> str:
    """Return the reason why the fit of a camera to its circles cannot be used, with the remedy.

    The text is empty if the fit can be used.

    Parameters
    ----------
    fit : fit of the camera alone, with sheet and lens assumed exact; None if no initial pose
        exists.
    status, observability : status of this fit, and the pose parameters that it determines.
    detection : detected circles of the camera.
    lens : given lens.
    lens_factor : (k, r) factor L of the lens covariance L L^T; None for an exact lens.
    model : pose parameters that the adjustment of all cameras will estimate.
    tuning : limits of a usable fit.
    """
    if status is Status.RANK_DEFICIENT:
        gauge = [PARAMETER_NAMES[k] for k in observability.gauge]
        return sentences.circles_leave_free(len(detection), gauge)
    if fit is None or status is not Status.CONVERGED:
        return sentences.fit_did_not_converge(len(detection), _fold(detection, lens))
    used, residuals_px = fit.used[0], errors_px(fit.problem)[0]
    misfit_px = float(np.sqrt(np.mean(np.sum(residuals_px[used] ** 2, axis=1))))
    extent_px = float(np.max(np.ptp(detection.centres_px, axis=0)))
    largest_px = max(tuning.least_misfit_px, tuning.misfit_share * extent_px)
    if lens_factor is not None:
        # With the aim fixed, a principal point that is off by so much moves every circle.
        largest_px += tuning.strain_sigmas * float(np.linalg.norm(lens_factor[_PRINCIPAL_POINT]))
    if misfit_px > largest_px:
        aim_is_free = model is PoseModel.AIM_FREE
        return sentences.circles_misfit(misfit_px, _fold(detection, lens), aim_is_free)
    if 2 * int(used.sum()) < len(used):
        return sentences.few_circles_agree(int(used.sum()), len(used))
    return ""


def _fold(detection: Detection, lens: Intrinsics) -> str | None:
    """Description of the fold of a lens, if the fold may be the cause of a failed fit; else None.

    A lens folds the image where its distortion maps two rays to one pixel. A fold in the corners of
    the image is no cause if all circles are nearer to the middle.
    """
    fold = describe_fold(lens)
    radius_px = np.linalg.norm(detection.centres_px - np.asarray(lens.principal_point_px), axis=1)
    is_beyond = bool((radius_px > lens.valid_radius_px).any())
    is_cause = is_beyond or describe_unusable_fold(lens) is not None
    return fold if is_cause else None


def is_suspect(
    tests: Sequence[FixedParameterTest],
    reduced_chi_square: float,
    tuning: AnswerTuning = TUNING.answer,
) -> bool:
    """True if the observations contradict a parameter that the fit assumed exact.

    They do in two cases: the residuals exceed their sigmas and the first test is significant, or a
    significant test predicts a large change of the pose.

    tests : score tests of the fixed parameters, the most significant one first.
    """
    scatters = reduced_chi_square > tuning.large_chi_square
    is_explained = scatters and bool(tests) and tests[0].is_significant
    return is_explained or any(test.is_strained for test in tests)


def notes_of_misfit(circles: Adjustment, view: int) -> tuple[str, ...]:
    """Return the warning that neighbouring circles have similar residuals far above the image
    noise; empty if they do not.

    circles : adjustment that uses the circle centres of all cameras. view : index of the camera.
    """
    times = float(circles.sigma_factors[view])
    tuning = circles.problem.tuning.answer
    if times <= tuning.strain_sigmas:
        return ()
    if autocorrelation_of_circles(circles, view) <= normal_limit(tuning.chance_of_answers):
        return ()
    residuals_px = errors_px(circles.problem)[view][circles.used[view]]
    return (sentences.neighbours_err_alike(float(np.sqrt(np.mean(residuals_px**2))), times),)


def notes_of_aim(adjustment: Adjustment, view: int) -> tuple[str, ...]:
    """Return the note that the optical axis misses the origin, if the offset is large and
    significant.
    """
    if not adjustment.priors.aim_sigma_mm:
        return ()
    aim_mm = adjustment.parameters(view)[4:6]
    tuning = adjustment.problem.tuning.answer
    if np.abs(aim_mm).max() < tuning.least_aim_mm:
        return ()
    steps = adjustment.rows(view)[4:6]
    unit_mm = float(adjustment.problem.parametrization.unit_mm)
    covariance = adjustment.covariance[np.ix_(steps, steps)] * unit_mm**2
    squared = aim_mm @ np.linalg.solve(covariance, aim_mm)
    if not chi_square_tail(squared, len(aim_mm)) < tuning.chance:
        return ()
    return (sentences.axis_misses_origin(aim_mm, np.sqrt(np.diag(covariance))),)


def notes_of_camera(
    camera: SheetCamera,
    circles: Adjustment,
    view: int,
    tests: Sequence[FixedParameterTest],
    gauge: Sequence[str],
) -> tuple[str, ...]:
    """Return the notes on the observations of a camera whose fit can be used.

    Parameters
    ----------
    camera : the camera with its chosen observations.
    circles : adjustment that uses the circle centres of all cameras.
    view : index of the camera.
    tests : score tests of the parameters that the fit assumed exact.
    gauge : names of undetermined parameters.
    """
    tuning, detection = circles.problem.tuning.answer, camera.detection
    image_fit = camera.grey_level_fit
    by_circles = camera.method == "points"
    notes = []
    decisive = [test for test in tests[:1] if test.is_significant] or [
        t for t in tests if t.is_strained
    ]
    notes += [sentences.fixed_parameter_off(test) for test in decisive[:1]]
    if image_fit is not None and image_fit.note is not None:
        notes.append(sentences.grey_levels_have_no_fit(image_fit.note))
    elif image_fit is not None and by_circles and image_fit.is_processed:
        notes.append(sentences.SHARPENED_GREY_LEVELS_DISAGREE)
    elif image_fit is not None and by_circles:
        notes.append(sentences.GREY_LEVELS_DISAGREE)
    elif camera.agreement_p_value < tuning.chance_of_answers:
        notes.append(sentences.CIRCLES_DISAGREE)
    outliers = detection.circle_index[~circles.used[view]]
    if len(outliers):
        notes.append(sentences.circles_not_used(outliers.tolist()))
    if len(detection) < len(circles.problem.target):
        notes.append(sentences.circles_missing(len(detection), len(circles.problem.target)))
    if gauge:
        notes.append(sentences.not_determined_one_by_one(gauge))
    quality = image_fit.quality if image_fit is not None else None
    if quality is not None and quality.found:
        notes.append(sentences.effects_included(quality.found))
    if quality is not None and quality.pixels_cut > tuning.cut_share * quality.pixels:
        share = quality.pixels_cut / (quality.pixels + quality.pixels_cut)
        notes.append(sentences.pixels_not_used(share))
    if quality is not None and quality.reduced_chi_square > tuning.large_chi_square:
        notes.append(sentences.image_departs(quality.noise, quality.noise_floor))
    reduced_chi_square = float(circles.reduced_chi_square[view])
    if by_circles and reduced_chi_square > tuning.large_chi_square:
        notes.append(sentences.circles_scatter(float(np.sqrt(reduced_chi_square))))
    if camera.sigma_factor > 1.0:
        notes.append(sentences.parts_disagree(camera.sigma_factor))
    return tuple(notes)


def notes_of_priors(
    pulls: Sequence[PriorPull], adjustment: Adjustment, view: int
) -> tuple[str, ...]:
    """Return the warnings about contradicted priors of one camera's lens and aim, then of the
    sheet.

    pulls : contradicted priors. view : index of the camera.
    """
    camera_sentences = [sentence_of_pull(p, adjustment, view) for p in pulls if view in p.views]
    return (*dict.fromkeys(camera_sentences), *notes_of_sheet(pulls, adjustment))


def notes_of_sheet(pulls: Sequence[PriorPull], adjustment: Adjustment) -> tuple[str, ...]:
    """Return the warnings about priors of the sheet that the images contradict.

    pulls : contradicted priors.
    """
    pull_sentences = [sentence_of_pull(pull, adjustment, 0) for pull in pulls if not pull.views]
    return tuple(dict.fromkeys(map(sentences.capitalise, pull_sentences)))


def sentence_of_pull(pull: PriorPull, adjustment: Adjustment, view: int) -> str:
    """Return the warning that the images contradict a prior, with the remedy.

    Quantities that the images cannot distinguish are named in one sentence.

    pull : the contradicted prior.
    view : index of the camera whose aim is reported, if the prior is that of an aim.
    """
    kind, *others = kinds = list_kinds(pull)
    if others:
        return sentences.one_of_them_is_off(kinds, pull.sigmas)
    if kind == "bend":
        sheet = np.asarray(adjustment.problem.state.sheet)
        shape = dict(zip(BentPaper.names, sheet, strict=True))
        height_mm = max(abs(float(shape[term])) for term in BentPaper.height_terms)
        return sentences.sheet_bends(height_mm, adjustment.priors.systematics.flatness_mm)
    if kind == "print aspect":
        return sentences.print_is_longer(float(pull.offset[0]), pull.sigmas)
    if kind == "aim":
        aim_mm = adjustment.parameters(view)[4:6]
        return sentences.aim_is_off(aim_mm, adjustment.priors.aim_sigma_mm)
    if kind == "all":
        return sentences.statements_disagree(pull.sigmas)
    return sentences.statement_is_off(kind, pull.offset, pull.sigmas)
