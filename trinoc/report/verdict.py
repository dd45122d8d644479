"""Verdict on a rig and on matches: one table of checks, of which the worst decides.

The checks on matches and their verdict are those of `assess_matches`, which also decides texts,
records and exit codes. docs/report.md lists the limits and the reason for each.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from trinoc.calib.result.calibration import Status
from trinoc.errors import list_names
from trinoc.match.tracks.matches import MatchStatus
from trinoc.match.tracks.reliability import MatchFinding, assess_matches
from trinoc.report.checks import Answer, Level, Limits, ReportCheck, Subject
from trinoc.report.numbers import millimetres, percent, with_decimals
from trinoc.report.shots_part import count_shots, shot_table

SENTENCE_ON_RIG = {
    Level.GOOD: "You can use this rig.",
    Level.CARE: "Use this rig with care.",
    Level.BAD: "Do not rely on this rig.",
}
LEVEL_OF_STATUS = {
    MatchStatus.MATCHED: Level.GOOD,
    MatchStatus.UNCERTAIN: Level.CARE,
    MatchStatus.SUSPECT: Level.BAD,
}
# The question of each finding on matches, and the part of the page to look at.
QUESTION_ON_MATCHES = {
    "rig": ("Was the rig calibrated well?", "cameras"),
    "set": ("Do segments and rig belong together?", "matches"),
    "count": ("Are enough lines sure?", "matches"),
    "agreement": ("Do the three views agree on the scene?", "epipolar"),
    "uncertainty": ("How large are the sigmas of the lines?", "matches"),
}


class Verdict(NamedTuple):
    """Verdict of a report.

    Attributes
    ----------
    level : Level
        Outcome of the worst check.
    sentence : str
        Verdict as a sentence.
    reason : str
        Figure and explanation of the worst check.
    checks : tuple of ReportCheck
        All checks.
    """

    level: Level
    sentence: str
    reason: str
    checks: tuple[ReportCheck, ...]


def find_verdict(subject: Subject) -> Verdict | None:
    """Verdict of a report; None without a calibration and without matches."""
    calibration = subject.result is not None or subject.shots is not None
    if not calibration and subject.matches is None:
        return None
    checks = [check for row in CHECKS if (check := row.check(subject)) is not None]
    assessment = None
    if subject.matches is not None:
        # The calibration of a page has a check of its own.
        assessment = assess_matches(subject.matches, {} if subject.result else subject.doubts)
        checks += map(_check_of_finding, assessment.findings)
    order = list(Level)
    worst = min(checks, key=lambda check: order.index(check.level))
    level = worst.level if worst.level in (Level.BAD, Level.CARE) else Level.GOOD
    reason = f"{worst.figure}: {worst.explanation}"
    if calibration:
        return Verdict(level, SENTENCE_ON_RIG[level], reason, tuple(checks))
    if level is Level.GOOD and assessment is not None:
        reason = assessment.deciding.reason
    (sentence,) = (status.value for status in MatchStatus if LEVEL_OF_STATUS[status] is level)
    return Verdict(level, sentence, reason, tuple(checks))


def _check_of_finding(finding: MatchFinding) -> ReportCheck:
    question, part = QUESTION_ON_MATCHES[finding.topic]
    level = LEVEL_OF_STATUS[finding.status]
    return ReportCheck(question, level, finding.figure, finding.explanation, finding.remedy, part)


def _answer_on_calibration(subject: Subject) -> Answer | None:
    result = subject.result
    if result is None:
        return None
    good = [name for name, status in result.status.items() if status is Status.CONVERGED]
    failed = [name for name in result.status if name not in result.rig.names]
    suspects = [name for name, status in result.status.items() if status is Status.SUSPECT]
    figure = f"{len(good)} of {len(result.status)} cameras calibrated"
    if failed:
        why = result.failures.get(failed[0], result.status[failed[0]].value)
        remedy = "Correct the cause that the sentence names, and take that picture again."
        return Answer(len(failed), figure, f"{failed[0]} failed. {why}", remedy=remedy)
    if suspects:
        notes = result.fits[suspects[0]].notes
        why = notes[0] if notes else result.status[suspects[0]].value
        explanation = f"{list_names(suspects)}: suspect. {why[:1].upper()}{why[1:]}"
        return Answer(len(suspects), figure, explanation)
    return Answer(0, figure, "all fits converged.")


def _answer_on_rank(subject: Subject) -> Answer | None:
    shots = subject.shots
    if shots is None:
        return None
    if shots.overall_status is Status.SUSPECT:
        remedy = "Let the shots determine that lens, or calibrate that lens again."
        return Answer(1, "suspect", shots.notes[0], remedy=remedy)
    if shots.overall_status is not Status.CONVERGED:
        return Answer(1, "no rig", shots.overall_status.value)
    if shots.gauge:
        explanation = f"the shots do not determine {', '.join(shots.gauge)}."
        return Answer(len(shots.gauge), f"{len(shots.gauge)} parameters open", explanation)
    return Answer(0, f"{len(shots.parameters)} parameters", "the fit converged.")


def _answer_on_shots(subject: Subject) -> Answer | None:
    if subject.shots is None:
        return None
    table = shot_table(subject.shots)
    used, missing, left_out = (count_shots(table, role) for role in ("used", "missing", "left-out"))
    explanation = "took part."
    if missing:
        explanation += f" The board was not found in {missing}."
    if left_out:
        explanation += " ".join([f" {left_out} were left out.", *subject.shots.refused[:1]])
    return Answer(left_out, f"{used} of {used + missing + left_out} pictures", explanation)


def _answer_on_coverage(subject: Subject, *, by_shots: bool) -> Answer | None:
    if not subject.coverage or (subject.shots is not None) != by_shots:
        return None
    poorest = min(subject.coverage, key=lambda figure: figure.share)
    subjects = "the board points surround" if by_shots else "the circles surround"
    explanation = (
        f"{subjects} this share in {poorest.name}, and at least this share in every other camera."
    )
    return Answer(poorest.share, f"{percent(poorest.share)} of the picture", explanation)


def _answer_on_residuals(subject: Subject) -> Answer | None:
    ratios = {}
    for name, fit in subject.result.fits.items() if subject.result is not None else ():
        picture = fit.image if fit.method == "pixels" else None
        chi_square = (fit if picture is None else picture).reduced_chi_square
        ratios[name] = float(np.sqrt(max(chi_square, 0.0)))
    explanation = (
        "the residuals of {}, which are the largest of all cameras; noise alone explains 1 or less."
    )
    return _worst_ratio(ratios, explanation)


def _answer_on_scatter(subject: Subject) -> Answer | None:
    fits = {} if subject.shots is None else subject.shots.fits
    factors = {name: fit.sigma_factor for name, fit in fits.items()}
    explanation = "the residuals of the board points in {}, by which all sigmas are multiplied."
    return _worst_ratio(factors, explanation)


def _worst_ratio(ratios: Mapping[str, float], explanation: str) -> Answer | None:
    finite = {name: ratio for name, ratio in ratios.items() if np.isfinite(ratio)}
    if not finite:
        return None
    worst = max(finite, key=lambda name: finite[name])
    figure = f"{with_decimals(finite[worst], 2)} times the noise"
    return Answer(finite[worst], figure, explanation.format(worst))


def _answer_on_epipolar_lines(subject: Subject) -> Answer | None:
    for part in subject.epipolar:
        if part.kind == "circles":
            figure = f"{with_decimals(part.largest_px, 3)} px from the epipolar lines"
            explanation = "the circles of one picture, rms, by the worst pair of cameras."
            return Answer(part.largest_px, figure, explanation)
    return None


def _answer_on_points(subject: Subject) -> Answer | None:
    field, result = subject.field, subject.result
    if field is None or not np.isfinite(field.worst_mm):
        return None
    explanation = (
        "the largest sigma of a point on the sheet and above it, from the errors of the cameras "
        "only."
    )
    advice = "" if result is None else result.advice
    return Answer(field.worst_mm, f"± {millimetres(field.worst_mm)}", explanation, remedy=advice)


def _answer_on_lens_fit(subject: Subject) -> Answer | None:
    fields = [field for field in subject.residuals if np.isfinite(field.over_chance)]
    if not fields:
        return None
    worst = max(fields, key=lambda field: field.over_chance)
    explanation = (
        f"mean residuals over parts of the picture of {worst.name}, "
        f"{with_decimals(worst.rms_px, 3)} px rms."
    )
    figure = f"{with_decimals(worst.over_chance, 1)} times chance"
    return Answer(worst.over_chance, figure, explanation)


def _answer_on_halves(subject: Subject) -> Answer | None:
    if subject.shots is None:
        return None
    halves = subject.shots.halves
    if halves is None:
        explanation = "a half of the shots does not determine the rig."
        remedy = "Nothing checks the sigmas: take more shots."
        return Answer(FAR_APART, "not known", explanation, remedy=remedy)
    return Answer(
        halves.ratio,
        f"{with_decimals(halves.ratio, 2)} claimed sigmas apart",
        f"over {halves.parameters} parameters, most in {halves.worst} "
        f"({with_decimals(halves.worst_ratio, 1)}).",
        "halves" if halves.over_field else "",
    )


def _answer_on_held_out_shots(subject: Subject) -> Answer | None:
    """Rms residual of held-out shots, with the board's pose from another camera if there are
    several.
    """
    held_out = None if subject.shots is None else subject.shots.cross_validation
    if held_out is None:
        return None
    errors = held_out.across_px or held_out.own_px
    worst = max(errors, key=lambda name: errors[name])
    source = "another camera" if held_out.across_px else "the same camera"
    explanation = (
        f"rms over {worst}, with the board's pose from {source}, and lenses and cameras from the "
        "other shots."
    )
    return Answer(errors[worst], f"{with_decimals(errors[worst], 3)} px", explanation)


def _answer_on_pixels(subject: Subject) -> Answer | None:
    uncertainty = subject.uncertainty
    if uncertainty is None:
        return None
    at_boards = uncertainty.at_boards
    explanation = (
        "one sigma, the median over the images at the distance of the boards; "
        f"{at_boards.worst_px:.2g} px at the worst position, and "
        f"{uncertainty.worst_farther_px:.2g} px at three times the distance."
    )
    if at_boards.size_px > 0.0:
        explanation += (
            " The error of the board's size, a scale that no image shows, adds up to "
            f"{at_boards.size_px:.2g} px."
        )
    return Answer(at_boards.worst_px, f"± {at_boards.median_px:.2g} px", explanation)


def _answer_on_frames(subject: Subject) -> Answer | None:
    recording = subject.recording
    if recording is None:
        return None
    bad = [fate for fate in recording.frames if fate.problem]
    count = len(recording.frames)
    explanation = "none failed, and none is suspect."
    if bad:
        explanation = f"Frame {bad[0].name}: {bad[0].problem}"
    uncertain = sum(bool(fate.care) for fate in recording.frames)
    if uncertain:
        explanation += f" Of these, use {uncertain:,} with care."
    figure = f"{count - len(bad):,} of {count:,} frames have no problem"
    return Answer(len(bad) / count, figure, explanation)


def _answer_on_time(subject: Subject) -> Answer | None:
    recording = subject.recording
    if recording is None or not len(recording.agreement):
        return None
    low, high = recording.agreement.min(), recording.agreement.max()
    explanation = (
        "the difference between the views in the position of a segment (medians of consecutive "
        "frames)."
    )
    figure = f"{with_decimals(low, 2)} to {with_decimals(high, 2)} times their sigma"
    return Answer(high, figure, explanation)


# Halves of the shots differ by 1 claimed sigma where the model is right; a ratio over tens of
# parameters seldom leaves .8 to 1.2 by chance.
APART, FAR_APART = 1.5, 3.0
# Residuals over noise: `calibrate` writes a note at a chi-square of 2.
NOISY = 2**0.5

CHECKS = (
    Limits(
        "Did every frame work?", "recording", 0,
        "Look at these frames. If they are consecutive, something moved there.",
        _answer_on_frames,
        bad=0.5,
    ),
    Limits(
        "Do the views agree in all frames?", "recording", 2,
        "A camera was knocked where the line has a step: run `trinoc check` on a later frame.",
        _answer_on_time,
    ),
    Limits(
        "Is every camera calibrated?", "cameras", 0,
        "The model does not describe the picture, so the sigmas are too small: check the pattern "
        "file, the lens, focus and light, and calibrate again.",
        _answer_on_calibration,
        Level.BAD,
    ),
    Limits(
        "Is everything determined?", "cameras", 0,
        "Show the board at more positions, nearer and tilted, and show it to several cameras in "
        "one shot.",
        _answer_on_rank,
        Level.BAD,
    ),
    Limits(
        "Do the shots agree?", "shots", 0,
        "Correct the cause that the sentence names, or remove these shots.",
        _answer_on_shots,
    ),
    Limits(
        "Does the sheet fill the images?", "detection", 0.1,
        "Outside the circles, the lens and the angles are extrapolated: move the sheet nearer, or "
        "print a larger sheet.",
        lambda subject: _answer_on_coverage(subject, by_shots=False),
        at_least=True,
    ),
    Limits(
        "Did the board cover the images?", "field-of-board", 0.4,
        "Outside these regions, the lens is extrapolated: show the board near the edges and "
        "corners.",
        lambda subject: _answer_on_coverage(subject, by_shots=True),
        at_least=True,
    ),
    Limits(
        "Do the residuals agree with the noise?", "detection", NOISY,
        "Look at the arrows: a swirl or a fan shows an error of the lens (run `trinoc "
        "intrinsics`), arrows on one side only show a bent sheet or a shadow, and arrows "
        "everywhere show a wrong pattern file.",
        _answer_on_residuals,
        bad=3,
    ),
    Limits(
        "Do the residuals agree with the noise?", "shots", NOISY,
        "The board may not be as drawn (measure it), or it moved while pictures were taken; look "
        "at the shots with the largest rms.",
        _answer_on_scatter,
    ),
    Limits(
        "Does the lens fit everywhere?", "field-of-board", 3,
        "A swirl or a fan shows an error of the lens: try `--lens-model auto`. Arrows that agree "
        "within one shot only show a bent board.",
        _answer_on_lens_fit,
    ),
    Limits(
        "Do two halves of the shots agree?", "cameras", APART,
        "The model of the lens, of the board or of the cameras' poses is not sufficient, so the "
        "sigmas are too small.",
        _answer_on_halves,
        bad=FAR_APART,
    ),
    Limits(
        "How large is the held-out residual?", "shots", None,
        "If this is much more than the residuals, take more shots, with more positions and tilts.",
        _answer_on_held_out_shots,
    ),
    Limits(
        "How large is the sigma of a pixel?", "uncertainty", None,
        "If this is too much, take shots near the edges, and at both ends of the working distance.",
        _answer_on_pixels,
    ),
    Limits(
        "Do the cameras agree with each other?", "epipolar", 0.1,
        "The epipolar lines must be accurate to some tenths of a pixel: calibrate the lens, and "
        "check that sheet and cameras did not move between the pictures.",
        _answer_on_epipolar_lines,
        bad=0.5,
    ),
    Limits(
        "How large is the sigma of a point?", "field", None,
        "If this is too much, measure the bars of the sheet (`--print-scale`), calibrate the lens, "
        "or put the cameras farther apart.",
        _answer_on_points,
    ),
)  # fmt: skip
