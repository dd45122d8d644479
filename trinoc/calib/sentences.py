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

_ONLY_CIRCLES = "Only its circles were used."
SHARPENED_GREY_LEVELS_DISAGREE = (
    "software has sharpened the image, and its grey levels disagree with the circles' centres or "
    f"among themselves. {_ONLY_CIRCLES}"
)
GREY_LEVELS_DISAGREE = (
    "the grey levels disagree with the circles' centres by more than noise: the image was "
    "processed, or its light or a cover on the sheet is not in the model. "
    f"{_ONLY_CIRCLES}"
)
CIRCLES_DISAGREE = (
    "the circles' centres disagree with the grey levels, probably because of shadows, uneven light "
    "or blur. The grey levels were used."
)
# The name of an unknown in a sentence, and how to state it better.
_NAME = {
    "print size": "the size of the print",
    "print aspect": "the print's scale along X against Y",
    "bend": "the bend of the sheet",
    "focal length": "the focal length",
    "aspect": "the ratio of the lens's focal lengths fx and fy",
    "principal point": "the principal point",
    "distortion": "the lens distortion",
    "aim": "the aim at the origin of the sheet",
}
_MEASURE_BARS = "measure the print's two bars (--print-scale)"
_CALIBRATE_LENS = "calibrate the lens (`trinoc intrinsics`) and pass it with --lens"
_REMEDY = {
    "print size": _MEASURE_BARS,
    "print aspect": _MEASURE_BARS,
    "bend": "lay the sheet flat, or state a larger --sigma flatness_mm=",
    "focal length": _CALIBRATE_LENS,
    "aspect": _CALIBRATE_LENS,
    "principal point": _CALIBRATE_LENS,
    "distortion": _CALIBRATE_LENS,
    "aim": "aim at the origin, or state a larger --sigma aim_mm=",
}


# Reasons why a camera failed.


def cameras_failed(failures: Mapping[str, str], cameras: int) -> str:
    """Number of failed cameras, and the reason of each."""
    reasons = "; ".join(f'camera "{name}": {failure}' for name, failure in failures.items())
    return f"{len(failures)} of {cameras} cameras failed. {capitalise(reasons)}"


def circles_leave_free(circles: int, parameters: Sequence[str]) -> str:
    """Parameters that the circles do not determine."""
    return (
        f"{circles} circles leave {', '.join(parameters)} undetermined: show more of the sheet, or "
        "circles that do not lie on one line."
    )


def fit_did_not_converge(circles: int, fold: str | None) -> str:
    """A fit without a minimum. fold : description of the lens's fold, if it may be the cause."""
    failure = f"the fit to its {circles} circles did not converge"
    remedy = "check that the pattern and the lens belong to this image."
    return _with_fold(failure, fold, remedy)


def circles_misfit(misfit_px: float, fold: str | None, aim_is_free: bool) -> str:
    """Residuals above any noise. fold : as in `fit_did_not_converge`."""
    free = "" if aim_is_free else ', or free the aim with pose_model="aim-free"'
    return _with_fold(
        f"the circles have an rms residual of {misfit_px:.1f} px",
        fold,
        f"check the focal length and the pattern{free}.",
    )


def _with_fold(failure: str, fold: str | None, remedy: str) -> str:
    if fold is None:
        return f"{failure}: {remedy}"
    return f"{failure}, because the lens {fold}: {FOLD_REMEDY}"


def few_circles_agree(agreeing: int, circles: int) -> str:
    """Most circles are outliers."""
    return (
        f"only {agreeing} of {circles} circles agree on one camera: check the pattern and the "
        "image."
    )


# Notes on a good fit.


def neighbours_err_alike(rms_px: float, times_noise: float) -> str:
    """Residuals far above the noise that neighbouring circles share."""
    return (
        f"neighbouring circles have similar residuals, {rms_px:.2g} px rms or {times_noise:.0f} "
        "times the noise: check the lens, lay the sheet flat, and hold camera and sheet still "
        "while the image is read out."
    )


def axis_misses_origin(aim_mm: Float[np.ndarray, "2"], sigma_mm: Float[np.ndarray, "2"]) -> str:
    """An aim beside the origin, within its stated sigma."""
    return (
        f"the optical axis misses the origin of the sheet by ({aim_mm[0]:.2f}, {aim_mm[1]:.2f}) "
        f"+- ({sigma_mm[0]:.1g}, {sigma_mm[1]:.1g}) mm; the other parameters account for this."
    )


def grey_levels_have_no_fit(reason: str) -> str:
    """Failure of the fit to the grey levels. reason : a sentence."""
    return f"{reason} {_ONLY_CIRCLES}"


def circles_not_used(circles: Sequence[int]) -> str:
    """Circles that are outliers."""
    return (
        f"{len(circles)} circle{'s were' if len(circles) > 1 else ' was'} located wrongly and not "
        f"used: {', '.join(str(k) for k in circles)}."
    )


def circles_missing(detected: int, circles: int) -> str:
    """Circles of the sheet that were not detected."""
    return f"{detected} of {circles} circles were found."


def not_determined_one_by_one(parameters: Sequence[str]) -> str:
    """Parameters of which only a combination is determined."""
    return f"{' and '.join(parameters)} are not determined separately."


def effects_included(effects: Sequence[str]) -> str:
    """Effects of camera and light that the grey levels show and the fit includes."""
    return f"the image shows {', '.join(effects)}; the fit includes this."


def pixels_not_used(share: float) -> str:
    """Pixels near the edges that show something else."""
    return (
        f"{100 * share:.0f} % of the pixels near the sheet's edges show something else and were "
        "not used."
    )


def image_departs(noise: float, noise_floor: float) -> str:
    """Residuals above the noise of the image, in grey levels."""
    return (
        f"the image differs from the model by {noise:.1f} grey levels, above its noise of "
        f"{noise_floor:.1f}; the sigmas use the larger number."
    )


def circles_scatter(factor: float) -> str:
    """Circles that scatter more than their sigmas."""
    return (
        f"the circles scatter {factor:.1f} times as much as their sigmas; the parameters' sigmas "
        "were multiplied by this factor."
    )


def parts_disagree(factor: float) -> str:
    """Blocks of circles that scatter more than their sigmas."""
    return (
        f"parts of the sheet disagree by {factor:.1f} times the sigmas of their circles; the "
        "parameters' sigmas were multiplied by this factor."
    )


def fixed_parameter_off(test: FixedParameterTest) -> str:
    """A fixed parameter that the residuals would change significantly, with the remedy."""
    estimate, sigma = test.estimate, test.sigma
    if test.name == "aim":
        return (
            f"the optical axis misses the origin of the sheet by ({estimate[0]:.2f}, "
            f"{estimate[1]:.2f}) +- ({sigma[0]:.1g}, {sigma[1]:.1g}) mm: "
            'use pose_model="aim-free".'
        )
    if test.name == "focal length":
        return (
            f"the residuals indicate a change of the focal length by {100 * estimate[0]:+.3f} +- "
            f"{100 * sigma[0]:.1g} %: check the lens and its focus."
        )
    if test.name == "aspect":
        return (
            f"the residuals indicate a change of fy against fx by {100 * estimate[0]:+.3f} +- "
            f"{100 * sigma[0]:.1g} %: check the pixel pitch."
        )
    if test.name == "principal point":
        return (
            f"the residuals indicate a shift of the principal point by ({estimate[0]:+.2g}, "
            f"{estimate[1]:+.2g}) +- ({sigma[0]:.1g}, {sigma[1]:.1g}) px: check that the image is "
            "not cropped, and that the lens belongs to this camera."
        )
    return (
        f"the residuals indicate radial distortion k1 = {estimate[0]:+.3f} +- {sigma[0]:.3f}, "
        "which the lens does not contain: calibrate its intrinsics."
    )


# Priors on sheet, lens and aim that the images contradict.


def one_of_them_is_off(kinds: Sequence[str], sigmas: float) -> str:
    """Unknowns of which one is wrong, where the images cannot show which."""
    remedies = dict.fromkeys(_REMEDY[kind] for kind in kinds)
    return (
        f"{_join([_NAME[kind] for kind in kinds], 'or')}: one of them is {sigmas:.1f} "
        f"sigma from the stated value, and these images cannot show which. "
        f"{capitalise(_join(list(remedies), 'or'))}."
    )


def sheet_bends(height_mm: float, flatness_mm: float) -> str:
    """A bend far beyond the stated flatness."""
    return (
        f"the sheet bends by {height_mm:.1f} mm, where {flatness_mm:.2g} mm was "
        f"expected: {_REMEDY['bend']}."
    )


def print_is_longer(share: float, sigmas: float) -> str:
    """A print whose scale along X exceeds that along Y by this share."""
    return (
        f"the print is {abs(100 * share):.2f} % longer along {'X' if share > 0 else 'Y'} than "
        f"along the other axis, {sigmas:.1f} sigma from the stated value: "
        f"{_REMEDY['print aspect']}."
    )


def aim_is_off(aim_mm: Float[np.ndarray, "2"], expected_mm: float) -> str:
    """An aim far beyond its stated sigma."""
    return (
        f"the optical axis misses the origin of the sheet by ({aim_mm[0]:.1f}, "
        f"{aim_mm[1]:.1f}) mm, where {expected_mm:.2g} mm was expected: aim at it, or "
        "state a larger sigma."
    )


def statements_disagree(sigmas: float) -> str:
    """All priors together are contradicted, and none alone."""
    return (
        "the stated values of sheet, lens and aim together disagree with the images by "
        f"{sigmas:.1f} sigma, though none of them does alone: check the pattern and the lens, and "
        "state larger sigmas for values that were not measured."
    )


def statement_is_off(kind: str, offset: Float[np.ndarray, "k"], sigmas: float) -> str:
    """One contradicted unknown."""
    name, amount = _NAME[kind].removeprefix("the "), f"{sigmas:.1f} sigma"
    if kind in ("focal length", "aspect", "print size"):
        amount = f"{100 * float(offset[0]):+.2f} %, {amount}"
    elif kind == "principal point":
        amount = f"({offset[0]:+.1f}, {offset[1]:+.1f}) px, {amount}"
    return (
        f"the images contradict the stated {name}: the fit differs by {amount}. "
        f"{capitalise(_REMEDY[kind])}."
    )


# Advice on measurements.

# How to measure lens and print. The bend of the paper is not among them: the images show it.
_HOW = {
    "lens": "calibrate the lens (`trinoc intrinsics`, ten images of the sheet)",
    "print": "measure the sheet's two bars (--print-scale)",
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
    """The measurement that reduces the sigmas most, and by how much."""
    gains = " and ".join(
        f"{quantity} within {after:.2g} {unit} (now {before:.2g})"
        for quantity, before, after, unit in advice.gains
    )
    sentence = (
        f"Most of the cameras' sigmas come from the assumed {advice.subject}: "
        f"{_HOW[advice.subject]}. If it were known {advice.tuning.better_known:.0f} times as well, "
        f"one sigma would be {gains}."
    )
    if advice.subject != "lens":
        return sentence
    return (
        f"{sentence} Errors of lens and pose cancel over the sheet: there, points have much "
        "smaller errors."
    )


def undetectable_errors(
    lens_tests: Sequence[FixedParameterTest], aim_test: FixedParameterTest | None
) -> str:
    """Errors of a lens or aim that is assumed exact, which the images cannot show."""
    sentences = []
    if lens_tests:
        errors = " or of ".join(f"{_error_of_lens(test)} ({_motion(test)})" for test in lens_tests)
        sentences.append(
            "The sigmas assume an exact lens. One image of a plane cannot show an error "
            f"of {errors}: calibrate the lens with several images (`trinoc intrinsics`) and pass "
            "it with --lens."
        )
    if aim_test is not None:
        sentences.append(
            "The sigmas assume that the optical axis meets the origin of the sheet exactly. The "
            f"image cannot show an error of up to {np.linalg.norm(aim_test.undetectable):.2g} mm "
            f"({_motion(aim_test)}): state the sigma of the aim (--sigma aim_mm=)."
        )
    return " ".join(sentences)


def _error_of_lens(test: FixedParameterTest) -> str:
    size = float(np.linalg.norm(test.undetectable))
    return _LENS_ERRORS[test.name].format(100 * size if test.name in _PERCENT else size)


def _motion(test: FixedParameterTest) -> str:
    """Resulting change of the camera's distance, and of the angle that changes most."""
    angles = np.abs(test.undetectable_motion[:3])
    name = PARAMETER_NAMES[int(np.argmax(angles))].removesuffix("_deg")
    return (
        f"it would change {name} by {angles.max():.2g} deg and distance by "
        f"{abs(float(test.undetectable_motion[3])):.2g} mm"
    )


# Lenses and rigs from many shots of a board: undetermined parameters.

ONE_SHOT = (
    ": there is one shot, and one image of a plane determines only two parameters of a lens. Take "
    "more shots with the board tilted in another direction in each, or give the lenses"
)
SQUARE_TO_THE_CAMERA = (
    ": all images show the board square to the camera, where a longer focal length and a larger "
    "distance look the same. Tilt the board by 30 to 50 degrees, in another direction each time"
)
PARALLEL_BOARDS = (
    ": the board is parallel in all shots. Tilt it by 30 to 50 degrees, in another direction each "
    "time"
)
ONE_AXIS = ": the board is tilted about one axis only. Tilt it about the other axis, too"
MORE_SHOTS = ": take more shots, with the board tilted in another direction in each"


def shots_do_not_determine(parameters: Sequence[str], reason: str) -> str:
    """Parameters that the shots do not determine. reason : one of the phrases above."""
    return f"The shots do not determine {list_names(parameters, 8)}{reason}."


def coefficients_fixed(names: Sequence[str]) -> str:
    """Coefficients that are not determined and were fixed at 0."""
    return f"The shots do not determine {', '.join(names)}; fixed at 0."


def coefficients_not_called_for(
    count: int, names: Sequence[str], extra: Sequence[str], gain: float
) -> str:
    """The first `count` coefficients of a lens suffice; gain : chi-square of the `extra` ones."""
    is_one = len(extra) == 1
    return (
        f"The images need {', '.join(names[:count]) or 'no distortion'}; {', '.join(extra)} "
        f"lower{'s' if is_one else ''} chi-square by {gain:.1f}, no more than noise does: "
        f"distortion={count} would omit {'it' if is_one else 'them'}."
    )


def distortion_extrapolated(point: str, share: float) -> str:
    """Few observations near the corners of the image, where the distortion is extrapolated.

    point : "circle" or "corner", the kind of board point. share : of the way from the principal
    point to the corners of the image that the observations reach.
    """
    return (
        f"No {point} lies beyond {100 * share:.0f} % of the distance from the principal point to "
        "the corners: the distortion beyond is extrapolated. Show the board near the corners."
    )


def lens_corrected(correction: LensCorrection, camera: str) -> str:
    """Size of the spline correction of a lens."""
    return (
        f"Splines correct the {correction.model} lens of {camera} by {correction.rms_px:.2g} px "
        f"(root mean square of the control points, at most {correction.largest_px:.2g}); where "
        f"nothing was observed, the correction has a sigma of {correction.sigma_px:.2g} px."
    )


# The lens model.


def lens_choice(
    model: str, rms_px: Mapping[str, float], tests: Mapping[str, tuple[float, bool]], doubt: bool
) -> str:
    """The chosen lens model and the reason.

    rms_px : held-out error of each model. tests : for each tested extension of the best model
        without splines, its p-value and whether it is significant. doubt : whether the residuals
        need a correction by splines.
    """
    others = ", ".join(f"{name} {rms:.3g}" for name, rms in rms_px.items() if name != model)
    comparison = f" ({others})" if others else ""
    sentence = (
        f"Of the lens models, {model} was chosen: fitted to one half of the shots, it has a "
        f"residual of {rms_px[model]:.3g} px in the other half{comparison}"
    )
    verdicts = [
        f"{'need' if significant else 'do not need'} {extension} (p-value {p_value:.2g})"
        for extension, (p_value, significant) in tests.items()
    ]
    if not verdicts:
        return f"{sentence}."
    sentence = f"{sentence}; by score tests the shots {' and '.join(verdicts)}"
    if not doubt:
        return f"{sentence}."
    return f"{sentence}: the polynomial does not describe the lens, or the board is not as drawn."


def lens_folds(camera: str, fold: str) -> str:
    """A lens that must not be used. fold : description of its fold."""
    return (
        f'The fitted distortion of "{camera}" {fold}: show the board nearer to the corners of the '
        "image, fit fewer coefficients (distortion=1 or distortion=2), or name another lens model "
        "(rational, kannala_brandt)."
    )


def lens_folds_outside(camera: str, fold: str) -> str:
    """A lens that folds where nothing was observed. fold : description of its fold."""
    return (
        f'The distortion of "{camera}" {fold}. Show the board nearer to the corners of the image '
        "to use them."
    )


def lens_model_widened(
    model: str, camera: str, fold: str, wider_model: str, rms_px: float, folding_rms_px: float
) -> str:
    """Another lens model was used, because the first one folds the image of a camera."""
    return (
        f'The {model} distortion of "{camera}" {fold}, so the lens model is {wider_model}: the rms '
        f"residual is now {rms_px:.3f} px; it was {folding_rms_px:.3f} px."
    )


def folding_coefficients_fixed(
    camera: str, names: Sequence[str], fold: str, rms_px: float, folding_rms_px: float
) -> str:
    """Coefficients that were fixed at 0, because the lens folds the image with them."""
    coefficients, verb = ", ".join(names), "is" if len(names) == 1 else "are"
    return (
        f'The distortion of "{camera}" fitted with {coefficients} {fold}, so {coefficients} {verb} '
        f"fixed at 0. The rms residual is now {rms_px:.3f} px; it was {folding_rms_px:.3f} px. "
        "Show the board nearer to the corners of the image."
    )


# Images and observations that were not used.


def board_elsewhere(where: str, error_px: float) -> str:
    """An image with the board at another pose than in the rig."""
    return (
        f"{where} shows the board {error_px:.1f} px from its pose in the rig, so the board moved "
        "or the image is of another moment; it was not used."
    )


def points_located_wrongly(where: str, wrong: int, count: int) -> str:
    """Corners or circles of an image that are outliers."""
    verb = "was" if wrong == 1 else "were"
    return f"{where}: {wrong} of {count} points {verb} located wrongly and not used."


def grey_levels_not_used(where: str, reason: str) -> str:
    """An image whose detected points were used instead of its grey levels. reason : a sentence."""
    return f"{where}: {reason} Its detected points were used instead."


def detection_remark(where: str, remark: str) -> str:
    """Corners of an image that the detector found and rejected. remark : the reason."""
    return f"{where}: {remark}; not used."


# Reasons why a lens must not be used.


def few_points_agree(points: str, used: int, total: int) -> str:
    """Most circles or corners do not agree on one lens. points : "circles" or "corners"."""
    return f"Only {used} of {total} {points} agree on one lens: {_one_camera(points)}"


def points_misfit(points: str, misfit_px: float) -> str:
    """Residuals that are too large for the board. points : "circles" or "corners"."""
    return f"The {points} have an rms residual of {misfit_px:.1f} px: {_one_camera(points)}"


def _one_camera(points: str) -> str:
    board = "this pattern" if points == "circles" else "this board"
    return f"check that all images show {board} and were taken by one camera at one zoom and focus."


# Scatter and its causes.


def not_converged(status: str) -> str:
    """A fit that did not converge. status : its sentence."""
    return f"{status} Check that all images show this board."


def circles_of_camera_scatter(camera: str, factor: float) -> str:
    """Residuals of circles that exceed their sigmas."""
    return (
        f"The circles of {camera} scatter {factor:.1f} times as much as their sigmas; all sigmas "
        "were multiplied by this factor. Check that the board is flat and still, and that focus "
        "and zoom do not change."
    )


def residuals_exceed_sigmas(camera: str, factor: float, has_causes: bool) -> str:
    """Residuals of a camera that are so large that the rig is SUSPECT."""
    return f'The residuals of "{camera}" are {factor:.1f} times their sigmas: ' + (
        "see the causes below." if has_causes else "no single cause stands out in them."
    )


def shots_differ(factor: float, has_causes: bool) -> str:
    """All sigmas were multiplied by the scatter of the shots."""
    return (
        f"All sigmas were multiplied by {factor:.1f}, because the shots differ from each other by "
        "this much more than their residuals."
        + ("" if has_causes else " No single cause stands out in the residuals.")
    )


def cause_of_misfit(cause: MisfitCause, cameras: Sequence[str], shots: Sequence[str]) -> str:
    """The pattern of a cause in the residuals, and the remedy."""
    camera = f'"{cameras[cause.camera]}"'
    size = f"{cause.amplitude_px:.2g} px (its residuals are {cause.noise_px:.2g} px rms)"
    if cause.kind is CauseKind.LENS_MODEL:
        return (
            f"The lens model of {camera} leaves a pattern of {size} that all images share: choose "
            "--lens-model auto or splined."
        )
    if cause.kind is CauseKind.BOARD_CHANGES:
        return (
            f"In {camera} the board has another shape in each image, by {size}: it bends, or "
            "moves during the exposure. Fix it to something stiff, and keep it still."
        )
    if cause.kind is CauseKind.CAMERA_MOVED:
        return (
            f'{camera} moved before the shot "{shots[cause.shot]}": from there on it shows the '
            f"board shifted by {cause.amplitude_px:.2g} px. Calibrate the shots before and "
            "after separately."
        )
    return (
        f"{camera} shows the board {size} from where the other cameras of the shot show it, in the "
        "median of all shots: the cameras are not synchronised. Keep the board still in each "
        "shot, or trigger the cameras together."
    )


# The board.

SEEN_FROM_BEHIND = (
    "Most images show the board from behind: the board, its layout or the images are mirrored, "
    "unless it is of glass. Mirrored images give a mirrored rig."
)


def board_shape(in_plane_mm: float, off_plane_mm: float) -> str:
    """Corners of the board that lie off their drawing."""
    return (
        f"The board's points lie {in_plane_mm:.2g} mm from the drawing within the plane and "
        f"{off_plane_mm:.2g} mm off it (root mean square); this shape was estimated with the rig."
    )


def board_deviates(board: str, parameter: str, value: float, sigmas: float) -> str:
    """A parameter of the board that is far from the stated one. board : its name, or ""."""
    of_board = f" {board}" if board else ""
    amount = f"{value:.2f} mm" if parameter.endswith("_mm") else f"{100 * value:.2f} %"
    return (
        f"The board{of_board}'s {parameter.removesuffix('_mm')} is {amount}, {sigmas:.0f} sigma "
        "from the stated value: check the layout and the size of its squares."
    )


# Fixed or stated lenses and aims that the observations contradict.


def lens_strained(strain: float) -> str:
    """A lens with a stated covariance that is off. strain : in its sigmas."""
    return (
        f"the observations contradict the given lens by {strain:.1f} of its sigmas: check focal "
        "length, pixel pitch and focus, that the image was not resized or turned, or calibrate the "
        "intrinsics."
    )


def lens_of_cameras_strained(cameras: Sequence[str], strain: float) -> str:
    """The same for the lens of one or several cameras of a rig."""
    return f"Lens of {_quoted(cameras)}: {lens_strained(strain)}"


def aim_misses_origin(offset_mm: Float[np.ndarray, "2"], sigma_mm: Float[np.ndarray, "2"]) -> str:
    """An optical axis that was fixed at the origin and does not meet it."""
    return (
        f"The optical axis misses the origin by ({offset_mm[0]:.3g}, {offset_mm[1]:.3g}) +- "
        f'({sigma_mm[0]:.1g}, {sigma_mm[1]:.1g}) mm: use pose_model="aim-free".'
    )


def points_refute_lens(
    names: Sequence[str], offsets: Float[np.ndarray, "k"], sigmas: Float[np.ndarray, "k"]
) -> str:
    """Parameters of a fixed lens that the points contradict."""
    return (
        "The points contradict the given lens, above all in "
        f"{_amounts(names, offsets, sigmas)}: free {', '.join(names)}, or check that points and "
        "pixels belong to one camera."
    )


def shots_refute_lens(
    cameras: Sequence[str],
    names: Sequence[str],
    offsets: Float[np.ndarray, "k"],
    sigmas: Float[np.ndarray, "k"],
) -> str:
    """Parameters of a given lens that the shots of a board contradict."""
    return (
        f"The shots contradict the given lens of {_quoted(cameras)}, above all in "
        f"{_amounts(names, offsets, sigmas)}: omit it from `lens`, so that the shots determine it, "
        "or check that its images have the zoom, focus and size of that lens."
    )


def lens_error_undetectable(
    cameras: Sequence[str],
    names: Sequence[str],
    offsets: Float[np.ndarray, "k"],
    moved_camera: str,
    strain: float,
) -> str:
    """An error of a given lens that the shots may not show and that would move a camera far."""
    amounts = ", ".join(f"{n} off by {o:+.2g}" for n, o in zip(names, offsets, strict=True))
    return (
        f"The lens of {_quoted(cameras)} is assumed exact. The shots cannot reliably show "
        f'{amounts}, which moves "{moved_camera}" by up to {strain:.0f} of its sigmas: omit the '
        "lens from `lens`, so that the shots determine it."
    )


def skew_of_points(skew_px: float, sigma_px: float) -> str:
    """A camera fitted to points with a skew."""
    return (
        f"The camera has a skew of {skew_px:.3g} +- {sigma_px:.1g} px, which no sensor has: it is "
        "tilted against its lens, or the axes of the points' frame are not perpendicular."
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
