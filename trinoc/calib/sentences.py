"""Sentences that calibrations report: numbers and names in, text out, and no decisions.

First those of `calibrate` (one sheet), then those of `calibrate_rig`, `calibrate_intrinsics` and
`calibrate_points`.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.misfit_causes import CauseKind, MisfitCause
from trinoc.errors import list_names
from trinoc.geometry.intrinsics import FOLD_REMEDY

_ONLY_CIRCLES = "Its circles alone were used."
SHARPENED_GREY_LEVELS_DISAGREE = (
    "software has sharpened the picture, and its grey levels disagree with the circles' centres or "
    f"among themselves. {_ONLY_CIRCLES}"
)
GREY_LEVELS_DISAGREE = (
    "the grey levels disagree with the circles' centres more than noise can explain: the picture "
    f"is processed, uneven or covered in a way that the model does not know. {_ONLY_CIRCLES}"
)
CIRCLES_DISAGREE = (
    "the circles' centres disagree with the grey levels, as shadows, uneven light and blur make "
    "them. The grey levels were used."
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


# Why a camera failed.


def cameras_failed(failures: dict[str, str], cameras: int) -> str:
    """How many cameras failed, and the sentence of each."""
    reasons = "; ".join(f'camera "{name}": {failure}' for name, failure in failures.items())
    return f"{len(failures)} of {cameras} cameras failed. {capitalise(reasons)}"


def circles_leave_free(circles: int, parameters: Sequence[str]) -> str:
    """The circles do not determine some parameters."""
    return (
        f"{circles} circles leave {', '.join(parameters)} free: show more of the sheet, or circles "
        "that do not lie on one line."
    )


def fit_did_not_converge(circles: int, fold: str | None) -> str:
    """The fit has no end. fold : what the lens does, where that may be the cause."""
    failure = f"the fit to its {circles} circles did not converge"
    remedy = "check that the pattern and the lens are those of this picture."
    return _with_fold(failure, fold, remedy)


def circles_misfit(misfit_px: float, fold: str | None, aim_is_free: bool) -> str:
    """The residuals are larger than any noise. fold : as of `fit_did_not_converge`."""
    free = "" if aim_is_free else ', or free the aim with pose_model="aim-free"'
    return _with_fold(
        f"the circles miss their predicted places by {misfit_px:.1f} px",
        fold,
        f"check the focal length and the pattern{free}.",
    )


def _with_fold(failure: str, fold: str | None, remedy: str) -> str:
    if fold is None:
        return f"{failure}: {remedy}"
    return f"{failure}, as the lens {fold}: {FOLD_REMEDY}"


def few_circles_agree(agreeing: int, circles: int) -> str:
    """Most circles were located wrongly."""
    return (
        f"only {agreeing} of {circles} circles agree on one camera: check the pattern and the "
        "picture."
    )


# What a user of a good fit should know.


def neighbours_err_alike(off_px: float, times_noise: float) -> str:
    """Residuals far above the noise, which neighbouring circles share."""
    return (
        f"neighbouring circles lie aside alike, by {off_px:.2g} px, {times_noise:.0f} times their "
        "noise: the lens is another than was said, the sheet bends otherwise, or something moved "
        "while the picture was read out."
    )


def axis_misses_origin(aim_mm: Float[np.ndarray, "2"], sigma_mm: Float[np.ndarray, "2"]) -> str:
    """An aim beside the origin, within its stated sigma."""
    return (
        f"the optical axis misses the origin of the sheet by ({aim_mm[0]:.2f}, {aim_mm[1]:.2f}) "
        f"+- ({sigma_mm[0]:.1g}, {sigma_mm[1]:.1g}) mm, which the parameters allow for."
    )


def grey_levels_have_no_fit(reason: str) -> str:
    """The fit to the grey levels failed."""
    return f"{reason} {_ONLY_CIRCLES}"


def circles_left_out(circles: Sequence[int]) -> str:
    """Circles that were located wrongly."""
    return (
        f"{len(circles)} circle{'s were' if len(circles) > 1 else ' was'} located wrongly and "
        f"left out: {', '.join(str(k) for k in circles)}."
    )


def circles_missing(detected: int, circles: int) -> str:
    """Circles of the sheet that were not detected."""
    return f"{detected} of {circles} circles were found."


def not_determined_one_by_one(parameters: Sequence[str]) -> str:
    """Parameters of which only a combination is determined."""
    return f"{' and '.join(parameters)} are not determined one by one."


def fitted_along(effects: Sequence[str]) -> str:
    """What the image shows of its camera and its light."""
    return f"the picture shows {', '.join(effects)}; this was fitted along."


def pixels_left_out(share: float) -> str:
    """Pixels near the edges that show something else."""
    return (
        f"{100 * share:.0f} % of the pixels near the sheet's edges show something else and "
        "were left out."
    )


def picture_departs(noise: float, noise_floor: float) -> str:
    """Residuals above the image's noise, in grey levels."""
    return (
        f"the picture departs from the model by {noise:.1f} grey levels, where its "
        f"own noise is {noise_floor:.1f}; its sigmas are those of the larger."
    )


def circles_scatter(factor: float) -> str:
    """Circles that scatter more than their sigmas."""
    return (
        f"the circles scatter {factor:.1f} times as much as their "
        "own sigmas say; the parameters' sigmas are enlarged by that factor."
    )


def parts_disagree(factor: float) -> str:
    """Blocks of circles that scatter more than their sigmas."""
    return (
        f"parts of the sheet disagree {factor:.1f} times as much as their circles' "
        "sigmas say; the parameters' sigmas are enlarged by that factor."
    )


# What the images contradict of sheet, lens and aim.


def one_of_them_is_off(kinds: Sequence[str], sigmas: float) -> str:
    """Unknowns of which one is off, where the images cannot show which."""
    remedies = dict.fromkeys(_REMEDY[kind] for kind in kinds)
    return (
        f"{_join([_NAME[kind] for kind in kinds], 'or')}: one of them is {sigmas:.1f} "
        f"sigma from what was stated, and these images cannot show which. "
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
        f"along the other axis, {sigmas:.1f} sigma from what was stated: "
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
        "what was stated of sheet, lens and aim disagrees with the images as a whole, by "
        f"{sigmas:.1f} sigma, though no part of it does alone: check the pattern and the "
        "lens, and state larger sigmas of what was not measured."
    )


def statement_is_off(kind: str, offset: Float[np.ndarray, "k"], sigmas: float) -> str:
    """One unknown is contradicted."""
    name, amount = _NAME[kind].removeprefix("the "), f"{sigmas:.1f} sigma"
    if kind in ("focal length", "aspect", "print size"):
        amount = f"{100 * float(offset[0]):+.2f} %, {amount}"
    elif kind == "principal point":
        amount = f"({offset[0]:+.1f}, {offset[1]:+.1f}) px, {amount}"
    return (
        f"the images contradict the stated {name}: the fit differs by {amount}. "
        f"{capitalise(_REMEDY[kind])}."
    )


# Lenses and rigs from many shots of a board: what is not determined.

ONE_SHOT = (
    ": there is one shot, and a plane tells two numbers of a lens and no more. Take more, the "
    "board tilted another way in each, or give the lenses"
)
SQUARE_TO_THE_CAMERA = (
    ": all pictures show the board square to the camera, where a longer focal length and a larger "
    "distance look the same. Tilt the board by 30 to 50 degrees, another way each time"
)
PARALLEL_BOARDS = (
    ": the board is parallel in all shots. Tilt it by 30 to 50 degrees, another way each time"
)
ONE_AXIS = ": the board is tilted about one axis only"
MORE_SHOTS = ": take more shots, the board tilted another way in each"


def shots_do_not_determine(parameters: Sequence[str], reason: str) -> str:
    """The shots leave some parameters free. reason : one of the phrases above."""
    return f"The shots do not determine {list_names(parameters, 8)}{reason}."


def coefficients_held(names: Sequence[str]) -> str:
    """Coefficients that are not determined were fixed at 0."""
    return f"The shots cannot determine {', '.join(names)}, held at 0."


def coefficients_not_called_for(
    count: int, names: Sequence[str], extra: Sequence[str], gain: float
) -> str:
    """The first `count` coefficients of a lens suffice; what the `extra` ones gain."""
    is_one = len(extra) == 1
    return (
        f"The pictures ask for {', '.join(names[:count]) or 'no distortion'}; {', '.join(extra)} "
        f"lower{'s' if is_one else ''} chi-square by {gain:.1f}, no more than noise does: "
        f"distortion={count} would leave {'it' if is_one else 'them'} out."
    )


def distortion_extrapolated(place: str, share: float) -> str:
    """No observation lies near the corners of the image. place : "circle" or "corner"."""
    return (
        f"No {place} lies further than {100 * share:.0f} % of the way from the principal point to "
        "the corners: the distortion beyond is extrapolated."
    )


# Images and observations that were left out.


def board_elsewhere(where: str, miss_px: float) -> str:
    """An image shows the board in another place than the rig has it."""
    return (
        f"{where} shows the board {miss_px:.1f} px from where the rig has it, so the board moved "
        "or the picture is of another moment; it was left out."
    )


def places_located_wrongly(where: str, wrong: int, count: int) -> str:
    """Some corners or circles of an image were located wrongly."""
    verb = "was" if wrong == 1 else "were"
    return f"{where}: {wrong} of {count} places {verb} located wrongly and left out."


def grey_levels_not_used(where: str, why: str) -> str:
    """The corners of an image stand for its grey levels. why : a sentence."""
    return f"{where}: {why} Its places count as they were detected."


def detection_remark(where: str, remark: str) -> str:
    """The detector left out some corners of an image."""
    return f"{where}: {remark}; left out."


# Why a lens must not be used.


def few_places_agree(places: str, kept: int, total: int) -> str:
    """Most circles or corners do not agree on one lens. places : "circles" or "corners"."""
    return f"Only {kept} of {total} {places} agree on one lens: {_one_camera(places)}"


def places_misfit(places: str, misfit_px: float) -> str:
    """The residuals are too large for the board. places : "circles" or "corners"."""
    return f"The {places} miss their predicted places by {misfit_px:.1f} px: {_one_camera(places)}"


def _one_camera(places: str) -> str:
    board = "this pattern" if places == "circles" else "this board"
    return (
        f"check that all pictures show {board} and were taken by one camera at one zoom and focus."
    )


# Scatter, and its causes.


def not_converged(status: str) -> str:
    """The fit did not converge. status : its sentence."""
    return f"{status} See that all pictures show this board."


def circles_of_camera_scatter(camera: str, factor: float) -> str:
    """The residuals of circles exceed their sigmas."""
    return (
        f"The circles of {camera} scatter {factor:.1f} times as much as their own sigmas say; all "
        "sigmas are enlarged by that. See that the board is flat and does not move, and that focus "
        "and zoom stay."
    )


def residuals_exceed_sigmas(camera: str, factor: float, has_causes: bool) -> str:
    """The residuals of a camera are so large that the rig is SUSPECT."""
    return f'The residuals of "{camera}" are {factor:.1f} times their sigmas: ' + (
        "see the causes below." if has_causes else "no single cause stands out in them."
    )


def shots_differ(factor: float, has_causes: bool) -> str:
    """All sigmas were enlarged by the scatter of the shots."""
    return (
        f"All sigmas are enlarged {factor:.1f} times, because shots differ from each other by so "
        "much more than their residuals."
        + ("" if has_causes else " No single cause stands out in the residuals.")
    )


def cause_of_misfit(cause: MisfitCause, cameras: Sequence[str], shots: Sequence[str]) -> str:
    """The pattern that a cause leaves in the residuals, and what to do."""
    camera = f'"{cameras[cause.camera]}"'
    size = f"{cause.amplitude_px:.2g} px (its residuals are {cause.noise_px:.2g} px rms)"
    if cause.kind is CauseKind.LENS_MODEL:
        return (
            f"The lens model of {camera} leaves a pattern of {size} that all images share: choose "
            "--lens-model auto or splined."
        )
    if cause.kind is CauseKind.BOARD_CHANGES:
        return (
            f"In {camera} the board is deformed differently in each image, by {size}: it bends, or "
            "moves during the exposure. Fix it to something stiff, and hold it still."
        )
    if cause.kind is CauseKind.CAMERA_MOVED:
        return (
            f'{camera} moved before the shot "{shots[cause.shot]}": from there on it shows the '
            f"board {cause.amplitude_px:.2g} px aside. Calibrate the shots before and after apart."
        )
    return (
        f"{camera} shows the board {size} from where the other cameras of the shot show it, in the "
        "median of all shots: the cameras do not look at one moment. Hold the board still in each "
        "shot, or trigger the cameras together."
    )


# The board.

SEEN_FROM_BEHIND = (
    "Most pictures show the board from behind: the board, its layout or the pictures are mirrored, "
    "unless it is of glass. Mirrored pictures make a mirrored rig."
)


def board_shape(aside_mm: float, off_plane_mm: float) -> str:
    """The board's corners lie off their drawing."""
    return (
        f"The board's places lie {aside_mm:.2g} mm aside of the drawing and {off_plane_mm:.2g} mm "
        "off its plane (root mean square); this was found with the rig, and is taken into account."
    )


def board_deviates(board: str, parameter: str, value: float, sigmas: float) -> str:
    """A parameter of the board is far from what was stated. board : its name, or ""."""
    of_board = f" {board}" if board else ""
    amount = f"{value:.2f} mm" if parameter.endswith("_mm") else f"{100 * value:.2f} %"
    return (
        f"The board{of_board}'s {parameter.removesuffix('_mm')} is {amount}, more than was thought "
        f"possible ({sigmas:.0f} sigmas): check the layout and the size of its squares."
    )


# Lenses and aims that were held or stated, and that the observations contradict.


def lens_strained(strain: float) -> str:
    """A lens that was stated with a covariance is off. strain : by so many of its sigmas."""
    return (
        f"the lens is another than was said, by {strain:.1f} of its sigmas: check focal length, "
        "pixel pitch and focus, that nobody resized or turned the picture, or calibrate its "
        "intrinsics."
    )


def lens_of_cameras_strained(cameras: Sequence[str], strain: float) -> str:
    """The same of a lens that one or several cameras of a rig have."""
    return f"Of {_quoted(cameras)}: {lens_strained(strain)}"


def aim_misses_origin(offset_mm: Float[np.ndarray, "2"], sigma_mm: Float[np.ndarray, "2"]) -> str:
    """An optical axis that was held at the origin does not meet it."""
    return (
        f"The optical axis misses the origin by ({offset_mm[0]:.3g}, {offset_mm[1]:.3g}) +- "
        f'({sigma_mm[0]:.1g}, {sigma_mm[1]:.1g}) mm: use pose_model="aim-free".'
    )


def points_refute_lens(
    names: Sequence[str], offsets: Float[np.ndarray, "k"], sigmas: Float[np.ndarray, "k"]
) -> str:
    """Parameters of a lens that was held are off, by points."""
    return (
        "The points ask for another lens than was held, above all in "
        f"{_amounts(names, offsets, sigmas)}: free {', '.join(names)}, or see that places and "
        "pixels are those of one camera."
    )


def shots_refute_lens(
    cameras: Sequence[str],
    names: Sequence[str],
    offsets: Float[np.ndarray, "k"],
    sigmas: Float[np.ndarray, "k"],
) -> str:
    """Parameters of a lens that was given are off, by shots of a board."""
    return (
        f"The shots ask for another lens of {_quoted(cameras)} than was given, above all in "
        f"{_amounts(names, offsets, sigmas)}: leave it out of `lens`, so that the shots find it, "
        "or see that its pictures have the zoom, focus and size that it is for."
    )


def lens_error_unseen(
    cameras: Sequence[str],
    names: Sequence[str],
    offsets: Float[np.ndarray, "k"],
    moved_camera: str,
    strain: float,
) -> str:
    """An error of a given lens that the shots need not show would move a camera far."""
    amounts = ", ".join(f"{n} off by {o:+.2g}" for n, o in zip(names, offsets, strict=True))
    return (
        f"The lens of {_quoted(cameras)} is taken to be exact. The shots may well not show "
        f'{amounts}, which moves "{moved_camera}" by up to {strain:.0f} of its sigmas: leave it '
        "out of `lens`, so that the shots find it."
    )


def skew_of_points(skew_px: float, sigma_px: float) -> str:
    """A camera fitted to points has a skew."""
    return (
        f"The camera has a skew of {skew_px:.3g} +- {sigma_px:.1g} px, which no sensor has: it is "
        "tilted against its lens, or the axes of the places are not perpendicular."
    )


def _amounts(
    names: Sequence[str], offsets: Float[np.ndarray, "k"], sigmas: Float[np.ndarray, "k"]
) -> str:
    rows = zip(names, offsets, sigmas, strict=True)
    return ", ".join(f"{name} by {offset:+.3g} +- {sigma:.1g}" for name, offset, sigma in rows)


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def capitalise(sentence: str) -> str:
    """The sentence with a capital first letter."""
    return sentence[:1].upper() + sentence[1:]


def _join(parts: Sequence[str], word: str) -> str:
    *first, last = parts
    return f"{', '.join(first)} {word} {last}" if first else last
