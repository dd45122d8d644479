"""Sentences on what the images contradict of what was stated of sheet, lens and aim."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trinoc.calib.adjustment.estimate import Adjustment
from trinoc.calib.adjustment.prior_pulls import PriorPull, list_kinds, refuted_priors
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.rig_fit import Knowledge

# What an unknown is called in a sentence, and how to state it better.
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


class RefutedPriors(NamedTuple):
    """Notes on what the images contradict, by what they belong to.

    Fields
    ------
    of_sheet : notes on the sheet, which make every camera SUSPECT.
    of_views : notes of each camera.
    wrong_aims : the cameras whose stated aim is contradicted.
    """

    of_sheet: tuple[str, ...]
    of_views: tuple[tuple[str, ...], ...]
    wrong_aims: frozenset[int]


def notes_of_priors(adjustment: Adjustment, known: Knowledge) -> RefutedPriors:
    """Return what the images contradict of what was stated, in sentences.

    An entry that concerns the sheet, or cannot be separated from it, is a note on the sheet.
    """
    of_sheet: list[str] = []
    of_views: list[list[str]] = [[] for _ in adjustment.used]
    wrong_aims: set[int] = set()
    for pull in refuted_priors(adjustment):
        unknowns = (pull.unknown, *pull.partners)
        owners = {view for unknown in unknowns for view in unknown.views}
        wrong_aims |= {view for one in unknowns if one.kind == "aim" for view in one.views}
        if not all(unknown.views for unknown in unknowns):
            of_sheet.append(_capital(sentence_of_pull(pull, adjustment, known, 0)))
            continue
        for view in owners:
            of_views[view].append(sentence_of_pull(pull, adjustment, known, view))
    return RefutedPriors(
        tuple(dict.fromkeys(of_sheet)),
        tuple(tuple(dict.fromkeys(notes)) for notes in of_views),
        frozenset(wrong_aims),
    )


def sentence_of_pull(pull: PriorPull, adjustment: Adjustment, known: Knowledge, view: int) -> str:
    """Return the sentence that reports an unknown which the images contradict, and the remedy.

    Unknowns that the images cannot tell apart share one sentence.
    """
    kind, *others = kinds = list_kinds(pull)
    if others:
        remedies = dict.fromkeys(_REMEDY[kind] for kind in kinds)
        return (
            f"{_join([_NAME[kind] for kind in kinds], 'or')}: one of them is {pull.sigmas:.1f} "
            f"sigma from what was stated, and these images cannot show which. "
            f"{_capital(_join(list(remedies), 'or'))}."
        )
    if kind == "bend":
        return _sentence_of_bend(adjustment, known)
    if kind == "print aspect":
        longer = 100 * float(pull.offset[0])
        return (
            f"the print is {abs(longer):.2f} % longer along {'X' if longer > 0 else 'Y'} than "
            f"along the other axis, {pull.sigmas:.1f} sigma from what was stated: "
            f"{_REMEDY[kind]}."
        )
    if kind == "aim":
        aim_mm = adjustment.parameters(view)[4:6]
        return (
            f"the optical axis misses the origin of the sheet by ({aim_mm[0]:.1f}, "
            f"{aim_mm[1]:.1f}) mm, where {known.aim_sigma_mm:.2g} mm was expected: aim at it, or "
            "state a larger sigma."
        )
    if kind == "all":
        return (
            "what was stated of sheet, lens and aim disagrees with the images as a whole, by "
            f"{pull.sigmas:.1f} sigma, though no part of it does alone: check the pattern and the "
            "lens, and state larger sigmas of what was not measured."
        )
    stated = _NAME[kind].removeprefix("the ")
    return (
        f"the images contradict the stated {stated}: the fit differs by {_amount(pull)}. "
        f"{_capital(_REMEDY[kind])}."
    )


def _amount(pull: PriorPull) -> str:
    """Text of an offset from a stated value, such as "+0.31 %, 4.2 sigma"."""
    sigmas = f"{pull.sigmas:.1f} sigma"
    kind, offset = pull.unknown.kind, pull.offset
    if kind in ("focal length", "aspect", "print size"):
        return f"{100 * float(offset[0]):+.2f} %, {sigmas}"
    if kind == "principal point":
        return f"({offset[0]:+.1f}, {offset[1]:+.1f}) px, {sigmas}"
    return sigmas


def _sentence_of_bend(adjustment: Adjustment, known: Knowledge) -> str:
    shape = dict(zip(BentPaper.names, np.asarray(adjustment.problem.state.sheet), strict=True))
    height_mm = max(abs(float(shape[term])) for term in BentPaper.height_terms)
    return (
        f"the sheet bends by {height_mm:.1f} mm, where {known.systematics.flatness_mm:.2g} mm was "
        f"expected: {_REMEDY['bend']}."
    )


def _join(parts: Sequence[str], word: str) -> str:
    *first, last = parts
    return f"{', '.join(first)} {word} {last}" if first else last


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]
