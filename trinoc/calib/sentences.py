"""Sentences that a calibration over one sheet reports: numbers and names in, text out."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

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


def lens_strain_sentence(strain: float) -> str:
    """A lens that was stated with a covariance is off by `strain` of its sigmas."""
    return (
        f"the lens is another than was said, by {strain:.1f} of its sigmas: check focal length, "
        "pixel pitch and focus, that nobody resized or turned the picture, or calibrate its "
        "intrinsics."
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


def capitalise(sentence: str) -> str:
    """The sentence with a capital first letter."""
    return sentence[:1].upper() + sentence[1:]


def _join(parts: Sequence[str], word: str) -> str:
    *first, last = parts
    return f"{', '.join(first)} {word} {last}" if first else last
