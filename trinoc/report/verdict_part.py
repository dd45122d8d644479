"""May this rig be used, and may these matches? A sentence, the number that decides, and each check.

What a check calls bad is said in docs/report.md, with the reason for each limit.
"""

import enum
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from trinoc.calib import CalibrationResult, Status
from trinoc.match import TRINOCULAR, Matches
from trinoc.report.coverage_part import CoverageFigure
from trinoc.report.epipolar_part import EpipolarPart
from trinoc.report.field_part import FieldPart
from trinoc.report.matches_part import share_matched
from trinoc.report.numbers import millimetres, percent, with_decimals

# Least share of a picture that the circles should surround.
LEAST_COVERAGE = 0.1
# Residuals over the noise that they should have: calibration notes a chi-square of 2, and
# beyond 3 times the noise the sigmas say nothing.
NOISY, WRONG = 2**0.5, 3.0
# What the position of a good segment is known to, and what is assumed of anybody's segments.
FINE_PX, COARSE_PX = 0.1, 0.5
# Share of the segments of the poorest view that three views match; see `cli.match`.
LEAST_MATCHED = 0.25
# The views' disagreement over the segments' own sigmas, at which a knocked camera is likely.
DISAGREEING = 2.0


class Level(enum.Enum):
    """How a check came out; the value is what the page says."""

    GOOD = "good"
    JUDGE = "for you to judge"
    CARE = "take care"
    BAD = "bad"


class Check(NamedTuple):
    """One question, its answer in a figure and in words, and what to do where it is not good."""

    question: str
    level: Level
    figure: str
    words: str
    remedy: str
    part: str


class Verdict(NamedTuple):
    """The worst of the checks in one sentence, with the number that decides."""

    level: Level
    sentence: str
    reason: str
    checks: tuple[Check, ...]


def verdict_part(
    result: CalibrationResult | None,
    matches: Matches | None,
    doubts: Mapping[str, str],
    coverage: Sequence[CoverageFigure],
    epipolar: Sequence[EpipolarPart],
    field: FieldPart | None,
) -> Verdict | None:
    """None where there is neither a calibration nor a matching to judge."""
    checks = []
    if result is not None:
        checks += [_cameras(result), *_covered(coverage), *_residuals(result)]
    elif doubts:
        checks.append(_doubted(doubts))
    for part in epipolar:
        if part.kind == "circles":
            checks.append(_epipolar(part))
    if field is not None and np.isfinite(field.worst_mm):
        checks.append(_known(field, result))
    if matches is not None:
        checks += [_matched(matches), *_agreeing(matches), *_located(matches)]
    if not checks or (result is None and matches is None):
        return None
    return verdict_of(checks, "this rig" if result is not None else "these matches")


def verdict_of(checks: Sequence[Check], what: str) -> Verdict:
    """The worst of the checks, of which there is one at least."""
    order = [Level.BAD, Level.CARE, Level.JUDGE, Level.GOOD]
    worst = min(checks, key=lambda check: order.index(check.level))
    level = worst.level if worst.level in (Level.BAD, Level.CARE) else Level.GOOD
    sentence = {
        Level.GOOD: f"You can use {what}.",
        Level.CARE: f"Use {what} with care.",
        Level.BAD: f"Do not rely on {what}.",
    }[level]
    return Verdict(level, sentence, f"{worst.figure}: {worst.words}", tuple(checks))


def _cameras(result: CalibrationResult) -> Check:
    good = [name for name, status in result.status.items() if status is Status.CONVERGED]
    failed = [name for name in result.status if name not in result.rig.names]
    figure = f"{len(good)} of {len(result.status)} cameras calibrated"
    if failed:
        why = result.failures.get(failed[0], result.status[failed[0]].value)
        return Check(
            "Is every camera calibrated?",
            Level.BAD,
            figure,
            f"{failed[0]} failed. {why}",
            "Mend what the sentence names, and take that picture again.",
            "cameras",
        )
    suspects = [name for name, status in result.status.items() if status is Status.SUSPECT]
    if suspects:
        notes = result.fits[suspects[0]].notes
        why = notes[0] if notes else result.status[suspects[0]].value
        return Check(
            "Is every camera calibrated?",
            Level.BAD,
            figure,
            f"{', '.join(suspects)}: suspect. {why}",
            "The picture is not what the model says, so its sigmas are too small: check the "
            "pattern file, the lens, focus and light, and calibrate again.",
            "cameras",
        )
    return Check(
        "Is every camera calibrated?", Level.GOOD, figure, "all fits converged.", "", "cameras"
    )


def _doubted(doubts: Mapping[str, str]) -> Check:
    name, why = next(iter(doubts.items()))
    return Check(
        "Was the rig calibrated well?",
        Level.BAD,
        f"{len(doubts)} suspect",
        f"the calibration of {name} was suspect. {why}",
        "The segments in space inherit this error, and their sigmas do not hold it: calibrate "
        "again.",
        "cameras",
    )


def _covered(coverage: Sequence[CoverageFigure]) -> list[Check]:
    if not coverage:
        return []
    least = min(coverage, key=lambda figure: figure.share)
    good = least.share >= LEAST_COVERAGE
    return [
        Check(
            "Does the sheet fill the pictures?",
            Level.GOOD if good else Level.CARE,
            f"{percent(least.share)} of the picture",
            f"the circles surround that much in {least.name}, and no less elsewhere.",
            ""
            if good
            else "Beyond the circles lens and angles are extrapolated: bring the sheet nearer or "
            "print it larger.",
            "detection",
        )
    ]


def _residuals(result: CalibrationResult) -> list[Check]:
    ratios = {}
    for name, fit in result.fits.items():
        chi_square = fit.reduced_chi_square
        if fit.method == "picture" and fit.image is not None:
            chi_square = fit.image.reduced_chi_square
        if np.isfinite(chi_square):
            ratios[name] = float(np.sqrt(max(chi_square, 0.0)))
    if not ratios:
        return []
    worst = max(ratios, key=lambda name: ratios[name])
    ratio = ratios[worst]
    level = Level.GOOD if ratio <= NOISY else Level.CARE if ratio <= WRONG else Level.BAD
    return [
        Check(
            "Are the residuals mere noise?",
            level,
            f"{with_decimals(ratio, 2)} times the noise",
            f"the largest residuals, those of {worst}; 1 or less is noise and nothing else.",
            ""
            if level is Level.GOOD
            else "Look at the arrows: a swirl or a fan is the lens (run trinoc intrinsics), one "
            "side alone a bent sheet or a shadow, all over a wrong pattern file.",
            "detection",
        )
    ]


def _distance_level(distance_px: float) -> Level:
    if not distance_px <= COARSE_PX:
        return Level.BAD
    return Level.GOOD if distance_px <= FINE_PX else Level.CARE


def _epipolar(part: EpipolarPart) -> Check:
    level = _distance_level(part.largest_px)
    return Check(
        "Do the cameras agree with each other?",
        level,
        f"{with_decimals(part.largest_px, 3)} px from the epipolar lines",
        "the circles of one picture, rms, by the worst pair of cameras.",
        ""
        if level is Level.GOOD
        else "A segment is matched within some tenths of a pixel: calibrate the lens, and check "
        "that sheet and cameras stood still between the pictures.",
        "epipolar",
    )


def _known(field: FieldPart, result: CalibrationResult | None) -> Check:
    included = (
        "" if result is None else f" They include {', '.join(('noise', *result.systematics))}."
    )
    return Check(
        "How well is a place known?",
        Level.JUDGE,
        f"± {millimetres(field.worst_mm)}",
        "one sigma where it is largest, on the sheet and above it, by the errors of the cameras "
        f"alone.{included}",
        "If that is too much: measure the bars of the sheet (--print-scale), calibrate the lens, "
        "put the cameras farther apart.",
        "field",
    )


def _matched(matches: Matches) -> Check:
    in_three = int((np.asarray(matches.stage) == TRINOCULAR).sum())
    fewest = min((len(words) for words in matches.reasons.values()), default=0)
    two_views = len(matches.views) < 3
    found = len(matches) if two_views else in_three
    good = found > LEAST_MATCHED * fewest
    views = "both views" if two_views else "three views or more"
    return Check(
        "Were the segments matched?",
        Level.GOOD if good else Level.BAD,
        f"{found} tracks in {views}",
        f"and {len(matches) - found} in two; {share_matched(matches)} of all segments are on a "
        "track.",
        ""
        if good
        else "Too few for a rig that took these pictures: check that each name stands before its "
        "own picture and that no camera was moved (trinoc check).",
        "matches",
    )


def _agreeing(matches: Matches) -> list[Check]:
    if (np.asarray(matches.stage) != TRINOCULAR).all():
        return []
    scale = float(matches.noise_scale)
    good = scale <= DISAGREEING
    return [
        Check(
            "Do the three views agree on the scene?",
            Level.GOOD if good else Level.CARE,
            f"{with_decimals(scale, 2)} times their sigma",
            "by which the views place a segment differently; near 1 they agree as well as the "
            "segments were measured.",
            ""
            if good
            else "A camera may have been knocked (run trinoc check), or the pictures are sharpened "
            "or moved; the sigmas on this page have grown to match.",
            "epipolar",
        )
    ]


def _located(matches: Matches) -> list[Check]:
    if not len(matches):
        return []
    across = float(np.nanmedian(matches.across_sigma_mm))
    return [
        Check(
            "How well are the segments known?",
            Level.JUDGE,
            f"± {millimetres(across)}",
            "the median sigma across a segment in space; each has its own, in the table.",
            "If that is too much: more light and focus, a longer lens, or cameras farther apart.",
            "matches",
        )
    ]
