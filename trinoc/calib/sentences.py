"""Sentences that calibrations report: numbers and names in, text out, and no decisions.

First those of `calibrate` (one sheet), then those of `calibrate_rig`, `calibrate_intrinsics` and
`calibrate_points`. A sentence states the cause with its number and unit, then the remedy.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.measurement_advice import MeasurementAdvice
from trinoc.calib.problem.lens_correction import LensCorrection
from trinoc.calib.problem.misfit_causes import CauseKind, MisfitCause
from trinoc.calib.result.calibration import FixedParameterTest
from trinoc.errors import list_names
from trinoc.geometry.intrinsics import FOLD_REMEDY
from trinoc.geometry.rig import PARAMETER_NAMES

_ONLY_CIRCLES = "Only the circle centres of this image were used."
SHARPENED_GREY_LEVELS_DISAGREE = (
    "software has sharpened the image, and its grey levels contradict the circle centres or each "
    f"other. {_ONLY_CIRCLES}"
)
GREY_LEVELS_DISAGREE = (
    "the grey levels contradict the circle centres by more than noise: the image was processed, "
    "the light is uneven, or something covers the sheet. "
    f"{_ONLY_CIRCLES}"
)
CIRCLES_DISAGREE = (
    "the circle centres contradict the grey levels, probably because of shadows, uneven light or "
    "blur. The grey levels were used."
)
# The name of an unknown in a sentence, and how to state it better.
_NAME = {
    "print size": "the size of the print",
    "print aspect": "the ratio of the print's scales along X and Y",
    "bend": "the bend of the sheet",
    "focal length": "the focal length",
    "aspect": "the ratio of the lens's focal lengths fx and fy",
    "principal point": "the principal point",
    "distortion": "the lens distortion",
    "aim": "the aim at the origin of the sheet",
}
_MEASURE_BARS = "measure the two bars of the print (--print-scale)"
_CALIBRATE_LENS = "calibrate the lens (`trinoc intrinsics`) and pass it with --lens"
_REMEDY = {
    "print size": _MEASURE_BARS,
    "print aspect": _MEASURE_BARS,
    "bend": "lay the sheet flat, or state a larger sigma (--sigma flatness_mm=)",
    "focal length": _CALIBRATE_LENS,
    "aspect": _CALIBRATE_LENS,
    "principal point": _CALIBRATE_LENS,
    "distortion": _CALIBRATE_LENS,
    "aim": "aim the camera at the origin, or state a larger sigma (--sigma aim_mm=)",
}


# Reasons why a camera failed.


def cameras_failed(failures: Mapping[str, str], cameras: int) -> str:
    """Message about the number of cameras that could not be calibrated, and the reason for each."""
    reasons = " ".join(f'Camera "{name}": {failure}' for name, failure in failures.items())
    return f"{len(failures)} of {cameras} cameras failed. {reasons}"


def circles_leave_free(circles: int, parameters: Sequence[str]) -> str:
    """Message about parameters that the circles do not determine."""
    return (
        f"the {circles} detected circles do not determine {', '.join(parameters)}. Show more of "
        "the sheet, so that the detected circles do not lie on one line."
    )


def fit_did_not_converge(circles: int, folds_at_radius: str | None) -> str:
    """Message about a fit of circle centres that did not converge.

    folds_at_radius : description of the fold of the lens (a radius where the distortion maps two
        rays to one pixel); None unless the fold may be the cause.
    """
    cause = "" if folds_at_radius is None else f", because the lens {folds_at_radius}"
    check = "Check that the pattern file and the lens belong to this image."
    remedy = check if folds_at_radius is None else capitalise(FOLD_REMEDY)
    return f"the fit to its {circles} circles did not converge{cause}. {remedy}"


def circles_misfit(misfit_px: float, folds_at_radius: str | None, aim_is_free: bool) -> str:
    """Message about residuals of the circles that are much larger than noise.

    folds_at_radius : as in `fit_did_not_converge`.
    aim_is_free : whether the pose model includes the aim.
    """
    free = "" if aim_is_free else ', or estimate the aim with pose_model="aim-free"'
    cause = "" if folds_at_radius is None else f", because the lens {folds_at_radius}"
    check = f"Check the focal length and the pattern file{free}."
    remedy = check if folds_at_radius is None else capitalise(FOLD_REMEDY)
    return f"the circles have an rms residual of {misfit_px:.1f} px{cause}. {remedy}"


def few_circles_agree(agreeing: int, circles: int) -> str:
    """Message that most circles are outliers with respect to one camera pose."""
    return (
        f"only {agreeing} of {circles} circles agree with one pose of the camera. Check the "
        "pattern file and the image."
    )


# Notes on a good fit.


def neighbours_err_alike(rms_px: float, times_noise: float) -> str:
    """Message that neighbouring circles have similar residuals, far above the image noise.

    times_noise : the residuals divided by the image noise.
    """
    return (
        f"the residuals are {rms_px:.2g} px rms, {times_noise:.0f} times the image noise, and "
        "neighbouring circles have similar residuals. Check the lens, lay the sheet flat, and keep "
        "camera and sheet still during the exposure."
    )


def axis_misses_origin(aim_mm: Float[np.ndarray, "2"], sigma_mm: Float[np.ndarray, "2"]) -> str:
    """Message that the optical axis misses the origin of the sheet by a significant offset, which
    was estimated.

    aim_mm : estimated intersection of the axis and the sheet. sigma_mm : its sigmas.
    """
    return (
        f"the optical axis misses the origin of the sheet by ({aim_mm[0]:.2f}, {aim_mm[1]:.2f}) "
        f"+- ({sigma_mm[0]:.1g}, {sigma_mm[1]:.1g}) mm. The fit estimated this offset, so the "
        "other parameters are not affected."
    )


def grey_levels_have_no_fit(reason: str) -> str:
    """Message about the failure of the fit to the grey levels. reason : a sentence."""
    return f"{reason} {_ONLY_CIRCLES}"


def circles_not_used(circles: Sequence[int]) -> str:
    """Message about circles that are outliers."""
    circles_were = "circle was" if len(circles) == 1 else "circles were"
    return (
        f"{len(circles)} {circles_were} located wrongly and not used. Index in the pattern: "
        f"{', '.join(str(k) for k in circles)}."
    )


def circles_missing(detected: int, circles: int) -> str:
    """Message about circles of the sheet that were not detected."""
    return f"only {detected} of {circles} circles of the sheet were detected."


def not_determined_one_by_one(parameters: Sequence[str]) -> str:
    """Message about parameters of which only a combination is determined."""
    return (
        f"the image determines only a combination of {' and '.join(parameters)}, not each of these "
        "parameters."
    )


def effects_included(effects: Sequence[str]) -> str:
    """Message about effects of camera and light that the image shows and the fit models."""
    these = "this effect" if len(effects) == 1 else "these effects"
    return f"the image shows {', '.join(effects)}. The fit to the grey levels models {these}."


def pixels_not_used(share: float) -> str:
    """Message about pixels near the outlines of circles and lines that do not show the sheet.

    share : fraction of the pixels near the outlines that was excluded.
    """
    return (
        f"{100 * share:.0f} % of the pixels near the outlines of circles and lines were not used, "
        "because they show something other than the sheet."
    )


def image_departs(noise: float, noise_floor: float) -> str:
    """Message about residuals of the grey levels above the noise of the image.

    noise, noise_floor : root mean square residual, and image noise, in grey levels.
    """
    return (
        f"the residuals of the grey levels are {noise:.1f} grey levels rms, but the image noise is "
        f"only {noise_floor:.1f}. The sigmas are computed from the larger number."
    )


def circles_scatter(factor: float) -> str:
    """Message about residuals of circles that exceed their sigmas. factor : their ratio."""
    return (
        f"the residuals of the circles are {factor:.1f} times their sigmas. All sigmas of this "
        "camera were multiplied by this factor."
    )


def parts_disagree(factor: float) -> str:
    """Message that the mean residuals of blocks of neighbouring circles exceed their sigmas.

    factor : ratio of the mean residuals to their sigmas.
    """
    return (
        f"the mean residuals over parts of the sheet are {factor:.1f} times their sigmas, because "
        "neighbouring circles have similar errors. All sigmas of this camera were multiplied by "
        "this factor."
    )


def fixed_parameter_off(test: FixedParameterTest) -> str:
    """Message about a fixed parameter whose value the residuals contradict."""
    estimate, sigma = test.estimate, test.sigma
    if test.name == "aim":
        return (
            f"the optical axis misses the origin of the sheet by ({estimate[0]:.2f}, "
            f"{estimate[1]:.2f}) +- ({sigma[0]:.1g}, {sigma[1]:.1g}) mm. "
            'Use pose_model="aim-free", which estimates this offset.'
        )
    if test.name == "focal length":
        return (
            "the residuals indicate that the given focal length is wrong: the estimated change is "
            f"{100 * estimate[0]:+.3f} +- {100 * sigma[0]:.1g} %. Check the lens and its focus."
        )
    if test.name == "aspect":
        return (
            "the residuals indicate that the given ratio of fy to fx is wrong: the estimated "
            f"change is {100 * estimate[0]:+.3f} +- {100 * sigma[0]:.1g} %. Check the pixel pitch."
        )
    if test.name == "principal point":
        return (
            "the residuals indicate that the given principal point is wrong: the estimated shift "
            f"is ({estimate[0]:+.2g}, {estimate[1]:+.2g}) +- ({sigma[0]:.1g}, {sigma[1]:.1g}) px. "
            "Check that the image is not cropped, and that the lens belongs to this camera."
        )
    return (
        "the residuals indicate a radial distortion that the given lens does not contain: k1 = "
        f"{estimate[0]:+.3f} +- {sigma[0]:.3f}. Calibrate the lens."
    )


# Priors on sheet, lens and aim that the images contradict.


def one_of_them_is_off(kinds: Sequence[str], sigmas: float) -> str:
    """Message about several stated values of which one is wrong, if the images cannot show which.

    kinds : kinds of these values, such as "focal length". sigmas : size of the contradiction.
    """
    remedies = dict.fromkeys(_REMEDY[kind] for kind in kinds)
    return (
        f"the images contradict one of these stated values by {sigmas:.1f} sigma, but cannot show "
        f"which value is wrong: {_join([_NAME[kind] for kind in kinds], 'or')}. "
        f"{capitalise(_join(list(remedies), 'or'))}."
    )


def sheet_bends(height_mm: float, flatness_mm: float) -> str:
    """Message about a sheet whose bend is far larger than the stated sigma of its flatness."""
    return (
        f"the sheet bends by {height_mm:.1f} mm, but the stated sigma of its flatness is "
        f"{flatness_mm:.2g} mm. {capitalise(_REMEDY['bend'])}."
    )


def print_is_longer(share: float, sigmas: float) -> str:
    """Message about a print whose scale along one axis exceeds that along the other axis.

    share : relative excess; negative if the scale along Y is larger.
    """
    longer, other = ("X", "Y") if share > 0 else ("Y", "X")
    return (
        f"the print is {abs(100 * share):.2f} % longer along {longer} than along {other}, which is "
        f"{sigmas:.1f} sigma from the stated value. {capitalise(_REMEDY['print aspect'])}."
    )


def aim_is_off(aim_mm: Float[np.ndarray, "2"], expected_mm: float) -> str:
    """Message about an optical axis that misses the origin by far more than the stated sigma.

    aim_mm : intersection of the axis and the sheet. expected_mm : stated sigma.
    """
    return (
        f"the optical axis misses the origin of the sheet by ({aim_mm[0]:.1f}, "
        f"{aim_mm[1]:.1f}) mm, but the stated sigma of the aim is {expected_mm:.2g} mm. "
        f"{capitalise(_REMEDY['aim'])}."
    )


def statements_disagree(sigmas: float) -> str:
    """Message that the images contradict the combination of all priors, but no single prior."""
    return (
        f"the images contradict the stated values of sheet, lens and aim by {sigmas:.1f} sigma in "
        "total, although they contradict no single value. Check the pattern file and the lens, and "
        "state larger sigmas for values that were not measured."
    )


def statement_is_off(kind: str, offset: Float[np.ndarray, "k"], sigmas: float) -> str:
    """Message about one stated value that the images contradict.

    kind : kind of the value, such as "focal length". offset : estimated minus stated value.
    sigmas : size of the contradiction in sigmas.
    """
    name, difference = _NAME[kind].removeprefix("the "), f"{sigmas:.1f} sigma"
    if kind in ("focal length", "aspect", "print size"):
        difference = f"{100 * float(offset[0]):+.2f} %, {difference}"
    elif kind == "principal point":
        difference = f"({offset[0]:+.1f}, {offset[1]:+.1f}) px, {difference}"
    return (
        f"the images contradict the stated {name}: the estimate differs from the stated value by "
        f"{difference}. {capitalise(_REMEDY[kind])}."
    )


# Advice on measurements.

# How to measure lens and print. The bend of the paper is not among them: the images show it.
_HOW = {
    "lens": "calibrate the lens (`trinoc intrinsics`, ten images of the sheet)",
    "print": "measure the two bars of the sheet (--print-scale)",
}
# Size of an error of a parameter that is assumed exact, by the name of its test.
_LENS_ERRORS = {
    "focal length": "up to {:.2g} % of the focal length",
    "aspect": "up to {:.2g} % of the ratio of its focal lengths",
    "principal point": "up to {:.2g} px of the principal point",
    "radial distortion": "up to {:.2g} of the radial distortion k1",
}
_PERCENT = ("focal length", "aspect")


def measurement_advice(advice: MeasurementAdvice) -> str:
    """Message about the measurement that would reduce the sigmas most, and by how much."""
    gains = " and ".join(
        f"the largest sigma of the {quantity} would be {after:.2g} {unit} (now {before:.2g} {unit})"
        for quantity, before, after, unit in advice.gains
    )
    sentence = (
        f"The uncertainty of the {advice.subject} causes most of the cameras' sigmas: "
        f"{_HOW[advice.subject]}. With a {advice.subject} known "
        f"{advice.tuning.better_known:.0f} times as well, {gains}."
    )
    if advice.subject != "lens":
        return sentence
    return (
        f"{sentence} Points near the sheet have much smaller errors, because errors of lens and "
        "pose cancel there."
    )


def undetectable_errors(
    lens_tests: Sequence[FixedParameterTest], aim_test: FixedParameterTest | None
) -> str:
    """Message about errors of a lens or aim that is assumed exact, which the images cannot show."""
    sentences = []
    if lens_tests:
        errors = " or of ".join(f"{_error_of_lens(test)} ({_motion(test)})" for test in lens_tests)
        sentences.append(
            "The sigmas assume that the lens is exact, but one image of a plane cannot show an "
            f"error of {errors}. Calibrate the lens with several images (`trinoc intrinsics`), and "
            "pass it with --lens."
        )
    if aim_test is not None:
        sentences.append(
            "The sigmas assume that the optical axis meets the origin of the sheet exactly, but "
            "the image cannot show an error of up to "
            f"{np.linalg.norm(aim_test.undetectable):.2g} mm ({_motion(aim_test)}). State the "
            "sigma of the aim (--sigma aim_mm=)."
        )
    return " ".join(sentences)


def _error_of_lens(test: FixedParameterTest) -> str:
    size = float(np.linalg.norm(test.undetectable))
    return _LENS_ERRORS[test.name].format(100 * size if test.name in _PERCENT else size)


def _motion(test: FixedParameterTest) -> str:
    """Text of the camera motion that an undetectable error causes.

    It contains the change of the distance, and that of pan, tilt or swing, whichever is largest.
    """
    angles = np.abs(test.undetectable_motion[:3])
    name = PARAMETER_NAMES[int(np.argmax(angles))].removesuffix("_deg")
    return (
        f"this error changes {name} by {angles.max():.2g} deg and distance by "
        f"{abs(float(test.undetectable_motion[3])):.2g} mm"
    )


# Lenses and rigs from many shots of a board: undetermined parameters.

ONE_SHOT = (
    ", because one image of a plane determines only two parameters of a lens. Take more shots, and "
    "tilt the board in a different direction in each shot, or give the lenses"
)
SQUARE_TO_THE_CAMERA = (
    ", because the board is parallel to the image plane in all images, so that a longer focal "
    "length has the same effect as a larger distance. Tilt the board by 30 to 50 degrees, in a "
    "different direction in each shot"
)
PARALLEL_BOARDS = (
    ", because the board is parallel in all shots. Tilt the board by 30 to 50 degrees, in a "
    "different direction in each shot"
)
ONE_AXIS = (
    ", because the board is tilted about one axis only. Tilt the board about a second axis, too"
)
MORE_SHOTS = ". Take more shots, and tilt the board in a different direction in each shot"


def shots_do_not_determine(parameters: Sequence[str], reason: str) -> str:
    """Message about parameters that the shots do not determine.

    reason : end of the sentence, one of the constants above such as `ONE_SHOT`.
    """
    return f"The shots do not determine {list_names(parameters, 8)}{reason}."


def coefficients_fixed(names: Sequence[str]) -> str:
    """Message about distortion coefficients that are not determined and were fixed at 0."""
    fixed = "This coefficient was" if len(names) == 1 else "These coefficients were"
    return f"The shots do not determine {', '.join(names)}. {fixed} fixed at 0."


def coefficients_not_called_for(
    count: int, names: Sequence[str], extra: Sequence[str], gain: float
) -> str:
    """Message that the first `count` distortion coefficients of a lens suffice.

    names : names of all coefficients. extra : names of the unnecessary ones.
    gain : reduction of chi-square by the `extra` coefficients.
    """
    needed = "no distortion coefficient" if count == 0 else f"only {', '.join(names[:count])}"
    unneeded = ", ".join(extra)
    verb = "reduces" if len(extra) == 1 else "reduce"
    return (
        f"The images need {needed}, because {unneeded} {verb} chi-square by {gain:.1f}, no more "
        f"than noise does. To omit {unneeded}, use distortion={count}."
    )


def distortion_extrapolated(point: str, share: float) -> str:
    """Message that few observations are near the corners of the image, where the distortion is
    extrapolated.

    point : "circle" or "corner", the kind of board point. share : radius of the farthest
    observation from the principal point over the radius of the farthest image corner.
    """
    return (
        f"Every observed {point} of the board lies within {100 * share:.0f} % of the distance from "
        "the principal point to the image corners, so the distortion is extrapolated beyond. Show "
        "the board near the image corners."
    )


def lens_corrected(correction: LensCorrection, camera: str) -> str:
    """Message about the size of the spline correction of a lens."""
    return (
        f'The lens of "{camera}" has a spline correction of {correction.rms_px:.2g} px rms and at '
        f"most {correction.largest_px:.2g} px, in addition to the {correction.model} model. Where "
        f"no board point was observed, the correction has a sigma of {correction.sigma_px:.2g} px."
    )


# The lens model.


def lens_choice(
    model: str, rms_px: Mapping[str, float], tests: Mapping[str, tuple[float, bool]], doubt: bool
) -> str:
    """Message about the chosen lens model and the reason.

    rms_px : held-out error of each model. tests : for each tested extension of the best model
        without splines, its p-value and whether it is significant. doubt : whether the residuals
        need a correction by splines.
    """
    others = ", ".join(f"{name} {rms:.3g} px" for name, rms in rms_px.items() if name != model)
    comparison = f"; other models have {others}" if others else ""
    sentence = (
        f"The lens model {model} was chosen: fitted to one half of the shots, it has an rms "
        f"residual of {rms_px[model]:.3g} px in the other half{comparison}."
    )
    verdicts = [
        f"{'need' if significant else 'do not need'} {extension} (p-value {p_value:.2g})"
        for extension, (p_value, significant) in tests.items()
    ]
    if not verdicts:
        return sentence
    verdict = f"Score tests show that the images {' and '.join(verdicts)}."
    if not doubt:
        return f"{sentence} {verdict}"
    return (
        f"{sentence} {verdict} Either the polynomial does not describe the lens, or the board is "
        "not as drawn."
    )


def lens_folds(camera: str, folds_at_radius: str) -> str:
    """Message about a lens that must not be used, because it folds the image.

    folds_at_radius : description of the fold of the lens (a radius where the distortion maps two
        rays to one pixel).
    """
    return (
        f'The fitted distortion of "{camera}" {folds_at_radius}. Show the board nearer to the '
        "image corners, fit fewer coefficients (distortion=1 or distortion=2), or choose the lens "
        "model rational or kannala_brandt."
    )


def lens_folds_outside(camera: str, folds_at_radius: str) -> str:
    """Message about a lens that folds the image only where nothing was observed.

    folds_at_radius : description of the fold of the lens (a radius where the distortion maps two
        rays to one pixel).
    """
    return (
        f'The distortion of "{camera}" {folds_at_radius}. To use this part of the image, show the '
        "board nearer to the image corners."
    )


def lens_model_widened(
    model: str,
    camera: str,
    folds_at_radius: str,
    wider_model: str,
    rms_px: float,
    folding_rms_px: float,
) -> str:
    """Message that another lens model was used, because the first one folds the image.

    folds_at_radius : description of the fold of the lens (a radius where the distortion maps two
        rays to one pixel).
    """
    return (
        f'The {model} distortion of "{camera}" {folds_at_radius}. The lens model {wider_model} was '
        f"used therefore. Its rms residual is {rms_px:.3f} px, and that of {model} is "
        f"{folding_rms_px:.3f} px."
    )


def folding_coefficients_fixed(
    camera: str, names: Sequence[str], folds_at_radius: str, rms_px: float, folding_rms_px: float
) -> str:
    """Message about coefficients that were fixed at 0, because the lens would fold the image.

    folds_at_radius : description of the fold of the lens (a radius where the distortion maps two
        rays to one pixel).
    """
    coefficients, verb = ", ".join(names), "was" if len(names) == 1 else "were"
    return (
        f'The distortion of "{camera}" fitted with {coefficients} {folds_at_radius}. Therefore '
        f"{coefficients} {verb} fixed at 0, which changes the rms residual from "
        f"{folding_rms_px:.3f} to {rms_px:.3f} px. Show the board nearer to the image corners."
    )


# Images and observations that were not used.


def board_elsewhere(where: str, error_px: float) -> str:
    """Message about an image in which the board is not at the estimated pose of its shot.

    where : name of the image. error_px : distance of the board from this pose in the image.
    """
    return (
        f"{where} shows the board {error_px:.1f} px from its estimated pose in this shot, so the "
        "board moved, or the image was taken at another moment. The image was not used."
    )


def points_located_wrongly(where: str, wrong: int, count: int) -> str:
    """Message about corners or circles of an image that are outliers.

    where : name of the image. wrong : number of outliers. count : number of detected points.
    """
    verb = "was" if wrong == 1 else "were"
    return f"{where}: {wrong} of {count} board points {verb} located wrongly and not used."


def grey_levels_not_used(where: str, reason: str) -> str:
    """Message about an image whose detected points were used instead of its grey levels.

    where : name of the image. reason : a sentence.
    """
    return f"{where}: {reason} The detected points of this image were used, not its grey levels."


def detection_remark(where: str, remark: str) -> str:
    """Message about corners or circles of an image that the detector rejected.

    where : name of the image. remark : number of these points, and the reason.
    """
    return f"{where}: {remark}. These points were not used."


# Reasons why a lens must not be used.


def few_points_agree(points: str, used: int, total: int) -> str:
    """Message that most circles or corners do not agree on one lens. points : "circles" or
    "corners".
    """
    return f"Only {used} of {total} {points} agree with one lens. {_one_camera(points)}"


def points_misfit(points: str, misfit_px: float) -> str:
    """Message about residuals that are too large for images of the given board. points : "circles"
    or "corners".
    """
    return f"The {points} have an rms residual of {misfit_px:.1f} px. {_one_camera(points)}"


def _one_camera(points: str) -> str:
    board = "this pattern" if points == "circles" else "this board"
    return f"Check that all images show {board} and were taken by one camera at one zoom and focus."


# Scatter and its causes.


def not_converged(status: str) -> str:
    """Message about a fit that did not converge. status : sentence of its status."""
    return f"{status} Check that all images show this board."


def circles_of_camera_scatter(camera: str, factor: float) -> str:
    """Message about residuals of circles that exceed their sigmas."""
    return (
        f'The residuals of the circles of "{camera}" are {factor:.1f} times their sigmas, and all '
        "sigmas were multiplied by this factor. Check that the board is flat and still, and that "
        "focus and zoom do not change."
    )


def residuals_exceed_sigmas(camera: str, factor: float, has_causes: bool) -> str:
    """Message about residuals of a camera that are so large that the rig is SUSPECT.

    factor : the residuals divided by their sigmas. has_causes : whether other notes name the
        causes.
    """
    remedy = (
        "The following notes name the causes."
        if has_causes
        else "The residuals do not show a single cause: check the images with the largest ones."
    )
    return f'The residuals of "{camera}" are {factor:.1f} times their sigmas. {remedy}'


def shots_differ(factor: float, has_causes: bool) -> str:
    """Message that all sigmas were multiplied, because the errors within a shot are correlated.

    factor : factor of the sigmas. has_causes : whether other notes name the causes.
    """
    sentence = (
        f"All sigmas were multiplied by {factor:.1f}, because the residuals of one shot have "
        "common errors, which differ from shot to shot."
    )
    if has_causes:
        return sentence
    return (
        f"{sentence} The residuals do not show a single cause: check the shots with the largest "
        "residuals."
    )


def cause_of_misfit(cause: MisfitCause, cameras: Sequence[str], shots: Sequence[str]) -> str:
    """Message about a pattern in the residuals that shows their cause, and the remedy."""
    camera = f'"{cameras[cause.camera]}"'
    amplitude = f"{cause.amplitude_px:.2g} px"
    residuals = f"all residuals of this camera: {cause.noise_px:.2g} px rms"
    if cause.kind is CauseKind.LENS_MODEL:
        return (
            f"The residuals of {camera} have a pattern of {amplitude} rms that is equal in all "
            f"images ({residuals}), so the lens model is not sufficient. Choose --lens-model auto "
            "or --lens-model splined."
        )
    if cause.kind is CauseKind.BOARD_CHANGES:
        return (
            f"The shape of the board differs between the images of {camera} by {amplitude} rms "
            f"({residuals}), so the board bends, or moves during the exposure. Fix the board to a "
            "stiff plate, and keep it still."
        )
    if cause.kind is CauseKind.CAMERA_MOVED:
        return (
            f'{camera} moved before the shot "{shots[cause.shot]}": from this shot on, the board '
            f"is shifted by {amplitude} in its images. Calibrate the earlier and the later shots "
            "separately."
        )
    return (
        f"{camera} shows the board {amplitude} from the position that the other cameras of the "
        f"shot give, in the median of all shots ({residuals}), so the cameras are not "
        "synchronised. Keep the board still in each shot, or trigger the cameras together."
    )


# The board.

SEEN_FROM_BEHIND = (
    "Most images show the board from behind, which is possible only if the board is transparent. "
    "Otherwise the board, its layout or the images are mirrored, and mirrored images give a "
    "mirrored rig."
)


def board_shape(in_plane_mm: float, off_plane_mm: float) -> str:
    """Message about board points that deviate from the drawing."""
    return (
        f"The board points deviate from the drawing by {in_plane_mm:.2g} mm within the plane of "
        f"the board and by {off_plane_mm:.2g} mm perpendicular to it (root mean square). This "
        "shape was estimated with the rig."
    )


def board_deviates(board: str, parameter: str, value: float, sigmas: float) -> str:
    """Message about a parameter of the board that is far from its stated value.

    board : name of the board in a set; "" for a single board.
    """
    of_board = f' "{board}"' if board else ""
    amount = f"{value:.2f} mm" if parameter.endswith("_mm") else f"{100 * value:.2f} %"
    return (
        f"The estimated {parameter.removesuffix('_mm')} of the board{of_board} is {amount}, "
        f"{sigmas:.0f} sigma from the stated value. Check the layout file and the size of the "
        "squares."
    )


# Fixed or stated lenses and aims that the observations contradict.


def lens_strained(strain: float) -> str:
    """Message about a given lens that the images contradict more than its stated sigmas allow.

    strain : largest difference between fitted and given lens, in stated sigmas.
    """
    return (
        f"the images contradict the given lens by {strain:.1f} sigma. Check focal length, pixel "
        "pitch and focus, check that the image was not resized or rotated, or calibrate the lens."
    )


def lens_of_cameras_strained(cameras: Sequence[str], strain: float) -> str:
    """Message about a given lens of one or several cameras of a rig that the images contradict.

    strain : largest difference between fitted and given lens, in stated sigmas.
    """
    return f"Lens of {_quoted(cameras)}: {lens_strained(strain)}"


def aim_misses_origin(offset_mm: Float[np.ndarray, "2"], sigma_mm: Float[np.ndarray, "2"]) -> str:
    """Message about an optical axis that was assumed to meet the origin and misses it."""
    return (
        f"The optical axis misses the origin by ({offset_mm[0]:.3g}, {offset_mm[1]:.3g}) +- "
        f'({sigma_mm[0]:.1g}, {sigma_mm[1]:.1g}) mm. Use pose_model="aim-free", which estimates '
        "this offset."
    )


def points_refute_lens(
    names: Sequence[str], offsets: Float[np.ndarray, "k"], sigmas: Float[np.ndarray, "k"]
) -> str:
    """Message about parameters of a fixed lens that the points contradict."""
    return (
        "The points contradict the given lens. The largest estimated corrections are "
        f"{_amounts(names, offsets, sigmas)}. Add {', '.join(names)} to `free`, or check that "
        "points and pixels belong to one camera."
    )


def shots_refute_lens(
    cameras: Sequence[str],
    names: Sequence[str],
    offsets: Float[np.ndarray, "k"],
    sigmas: Float[np.ndarray, "k"],
) -> str:
    """Message about parameters of a given lens that the shots of a board contradict."""
    return (
        f"The shots contradict the given lens of {_quoted(cameras)}. The largest estimated "
        f"corrections are {_amounts(names, offsets, sigmas)}. Omit this lens from `lens`, so that "
        "it is estimated, or check that the images have the zoom, focus and size of the given lens."
    )


def lens_error_undetectable(
    cameras: Sequence[str],
    names: Sequence[str],
    offsets: Float[np.ndarray, "k"],
    moved_camera: str,
    strain: float,
) -> str:
    """Message about an error of a given lens that the shots cannot show and that would move a
    camera far.

    names, offsets : lens parameters with this error, and its size.
    moved_camera, strain : camera that the error would move most, and its motion in sigmas.
    """
    errors = " and ".join(f"{n} by {o:+.2g}" for n, o in zip(names, offsets, strict=True))
    return (
        f"The lens of {_quoted(cameras)} is assumed exact, but the shots cannot show an error of "
        f'{errors}. This error would move camera "{moved_camera}" by {strain:.0f} of its sigmas. '
        "Omit this lens from `lens`, so that it is estimated."
    )


def skew_of_points(skew_px: float, sigma_px: float) -> str:
    """Message about a camera, fitted to given points, whose estimated skew differs from 0."""
    return (
        f"The estimated skew is {skew_px:.3g} +- {sigma_px:.1g} px, but sensors have no skew. "
        "Check that the axes of the points' frame are perpendicular, and that the lens is not "
        "tilted."
    )


def _amounts(
    names: Sequence[str], offsets: Float[np.ndarray, "k"], sigmas: Float[np.ndarray, "k"]
) -> str:
    rows = zip(names, offsets, sigmas, strict=True)
    return ", ".join(f"{name} by {offset:+.3g} +- {sigma:.1g}" for name, offset, sigma in rows)


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def capitalise(sentence: str) -> str:
    """Sentence with a capital first letter."""
    return sentence[:1].upper() + sentence[1:]


def _join(parts: Sequence[str], word: str) -> str:
    *first, last = parts
    return f"{', '.join(first)} {word} {last}" if first else last
