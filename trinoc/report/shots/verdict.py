"""May a rig from many shots be used? Each check with its number and what to do.

The limits stand in docs/report.md, with their reasons.
"""

from collections.abc import Sequence

import numpy as np

from trinoc.calib import RigFromShots, Status
from trinoc.report.numbers import percent, with_decimals
from trinoc.report.shots.camera_field import CameraField
from trinoc.report.shots.shot_table import shot_table
from trinoc.report.shots.uncertainty import Uncertainty
from trinoc.report.verdict_part import NOISY, Check, Level, Verdict, verdict_of

# Share of each picture that the board's places should surround, over all shots: beyond them a lens
# is extrapolated.
LEAST_COVERAGE = 0.4
# Halves of the shots differ by 1 claimed sigma where the model is right; a ratio over tens of
# parameters seldom leaves .8 to 1.2 by chance.
APART, FAR_APART = 1.5, 3.0
# Mean residuals over chance, beyond which they depend on the place: the lens or the board's shape.
PATTERN = 3.0


def verdict_of_shots(
    result: RigFromShots, fields: Sequence[CameraField], uncertainty: Uncertainty | None
) -> Verdict:
    """Every check that the result can answer."""
    checks = [_determined(result), _shots(result), *_covered(fields), *_noise(result)]
    checks += [*_pattern(fields), _halves(result), *_held_out(result)]
    if uncertainty is not None:
        checks.append(_known(uncertainty))
    return verdict_of(checks, "this rig")


def _determined(result: RigFromShots) -> Check:
    question, part = "Is everything determined?", "cameras"
    remedy = "Show the board in more places, nearer and tilted, and let cameras share shots."
    if result.status is not Status.CONVERGED:
        return Check(question, Level.BAD, "no rig", result.status.value, remedy, part)
    if result.gauge:
        figure = f"{len(result.gauge)} parameters open"
        words = f"the shots leave {', '.join(result.gauge)} free."
        return Check(question, Level.BAD, figure, words, remedy, part)
    figure = f"{len(result.parameters)} parameters"
    return Check(question, Level.GOOD, figure, "the fit converged.", "", part)


def _shots(result: RigFromShots) -> Check:
    table = shot_table(result)
    used, missing, left_out = (table.count(role) for role in ("used", "missing", "left-out"))
    parts = ["took part."]
    if missing:
        parts.append(f"The board was not found in {missing}.")
    if left_out:
        parts.append(f"{left_out} were left out. {' '.join(result.refused[:1])}")
    return Check(
        "Do the shots belong together?",
        Level.CARE if left_out else Level.GOOD,
        f"{used} of {used + missing + left_out} pictures",
        " ".join(parts),
        "Mend what the sentence names, or take these shots out." if left_out else "",
        "shots",
    )


def _covered(fields: Sequence[CameraField]) -> list[Check]:
    if not fields:
        return []
    least = min(fields, key=lambda field: field.share)
    good = least.share >= LEAST_COVERAGE
    return [
        Check(
            "Was the board all over the pictures?",
            Level.GOOD if good else Level.CARE,
            f"{percent(least.share)} of the picture",
            f"its places surround that much in {least.name}, and no less elsewhere.",
            ""
            if good
            else "Beyond them the lens is extrapolated: show the board near the edges and corners.",
            "field-of-board",
        )
    ]


def _noise(result: RigFromShots) -> list[Check]:
    factors = {name: f for name, f in result.sigma_factor.items() if np.isfinite(f)}
    if not factors:
        return []
    worst = max(factors, key=lambda name: factors[name])
    good = factors[worst] <= NOISY
    return [
        Check(
            "Are the residuals mere noise?",
            Level.GOOD if good else Level.CARE,
            f"{with_decimals(factors[worst], 2)} times the noise",
            f"the scatter of the places in {worst}; all sigmas have grown by it.",
            ""
            if good
            else "The board may not be as drawn (measure it), or it moved while pictures were "
            "taken; look at the shots with the largest rms.",
            "shots",
        )
    ]


def _pattern(fields: Sequence[CameraField]) -> list[Check]:
    known = [field for field in fields if np.isfinite(field.over_chance)]
    if not known:
        return []
    worst = max(known, key=lambda field: field.over_chance)
    good = worst.over_chance <= PATTERN
    return [
        Check(
            "Does the lens fit everywhere?",
            Level.GOOD if good else Level.CARE,
            f"{with_decimals(worst.over_chance, 1)} times chance",
            f"mean residuals over parts of the picture of {worst.name}, "
            f"{with_decimals(worst.mean_rms_px, 3)} px rms.",
            ""
            if good
            else "A swirl or a fan is the lens: try --lens-model auto. Arrows that agree within "
            "one shot alone are a bent board.",
            "field-of-board",
        )
    ]


def _halves(result: RigFromShots) -> Check:
    question, part = "Do two halves of the shots agree?", "cameras"
    halves = result.halves
    if halves is None:
        words = "a half of the shots does not determine the rig."
        remedy = "Nothing checks the sigmas: take more shots."
        return Check(question, Level.CARE, "not known", words, remedy, part)
    part = "halves" if halves.over_field else part
    level = Level.GOOD if halves.ratio <= APART else Level.CARE
    level = level if halves.ratio <= FAR_APART else Level.BAD
    return Check(
        question,
        level,
        f"{with_decimals(halves.ratio, 2)} claimed sigmas apart",
        f"over {halves.parameters} parameters, most in {halves.worst} "
        f"({with_decimals(halves.worst_ratio, 1)}).",
        ""
        if level is Level.GOOD
        else "Something is not in the model: the lens, the board, or cameras that moved. The "
        "sigmas claim too much.",
        part,
    )


def _held_out(result: RigFromShots) -> list[Check]:
    """Through other cameras, which is what a rig is for; of one camera, its own."""
    found = result.cross_validation
    if found is None:
        return []
    errors = found.across_px or found.own_px
    worst = max(errors, key=lambda name: errors[name])
    by = "placed by another camera" if found.across_px else "placed by itself"
    return [
        Check(
            "How far off are shots held out?",
            Level.JUDGE,
            f"{with_decimals(errors[worst], 3)} px",
            f"rms of the places in {worst}, the board {by}; lenses and cameras from the others.",
            "If that is much more than the residuals: more shots, at more places and tilts.",
            "shots",
        )
    ]


def _known(uncertainty: Uncertainty) -> Check:
    return Check(
        "How well is a pixel known?",
        Level.JUDGE,
        f"± {with_decimals(uncertainty.worst_at_boards_px, 3)} px",
        "one sigma where it is largest, at the distance of the boards; "
        f"{with_decimals(uncertainty.worst_farther_px, 3)} px three times as far.",
        "If that is too much: shots near the edges, at both ends of the working distance.",
        "uncertainty",
    )
