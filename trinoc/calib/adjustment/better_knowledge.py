"""What it would give to know the lens or the print better, without another picture of the rig."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.estimate import Adjustment, prior_weights
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.pose import PoseModel

# What may be known better, and how. The bend of the paper is not among it: pictures show it.
_HOW = {
    "lens": "calibrate the lens (`trinoc intrinsics`, ten pictures of the sheet)",
    "print": "measure the sheet's two bars (--print-scale)",
}


class BetterKnowledge(NamedTuple):
    """The one thing to know better that narrows the cameras' sigmas most.

    Fields
    ------
    what : "lens" or "print".
    angle_now_deg, angle_then_deg : the largest sigma of pan, tilt and swing over all cameras, and
        what it would be, were this known so much better.
    distance_now_mm, distance_then_mm : the same of the distance.
    """

    what: str
    angle_now_deg: float
    angle_then_deg: float
    distance_now_mm: float
    distance_then_mm: float

    @property
    def sentence(self) -> str:
        """The advice for people."""
        pairs = (
            ("angles", self.angle_now_deg, self.angle_then_deg, "deg"),
            ("distances", self.distance_now_mm, self.distance_then_mm, "mm"),
        )
        gains = " and ".join(
            f"{of} within {then:.2g} {unit} (now {now:.2g})"
            for of, now, then, unit in pairs
            if now > TUNING.answer.enough_gain * then
        )
        sentence = (
            f"What is assumed of the {self.what} makes up most of the cameras' sigmas: "
            f"{_HOW[self.what]}. Were it known {TUNING.answer.better_known:.0f} times as well, one "
            f"sigma would hold {gains}."
        )
        if self.what != "lens":
            return sentence
        return (
            f"{sentence} Errors of lens and pose cancel over the sheet: points there are known far "
            "better than that."
        )


def advise_better_knowledge(
    adjustments: Sequence[Adjustment], systematics: Systematics
) -> BetterKnowledge | None:
    """What counts most of what is assumed; None where the pictures count more than any of it.

    adjustments : of cameras that share nothing. systematics : what they were fitted under; bars
    that were measured are not measured again.

    A prior that is narrower adds rows to the root of the information (Golub and Van Loan, Matrix
    Computations, 6.5): nothing is fitted anew.
    """
    now = np.concatenate([_sigmas(each, each.covariance) for each in adjustments])
    if not now.all():
        # A pose that the circles leave free wants circles first.
        return None
    gains = {}
    for what in _HOW:
        if what == "print" and not systematics.print_size_sigma:
            continue
        then = np.concatenate([_sigmas(each, _covariance(each, what)) for each in adjustments])
        mean = float(np.mean(np.log(now / then)))
        if mean > np.log(TUNING.answer.enough_gain):
            gains[what] = mean, then.max(axis=0)
    if not gains:
        return None
    what = max(gains, key=lambda what: gains[what][0])
    most, then = now.max(axis=0), gains[what][1]
    return BetterKnowledge(
        what, float(most[:3].max()), float(then[:3].max()), float(most[3]), float(then[3])
    )


def _covariance(adjustment: Adjustment, what: str) -> Float[np.ndarray, "f f"]:
    """The covariance, were the prior's sigmas of one thing so many times as small."""
    chart = adjustment.problem.chart
    better = np.zeros(len(chart.free))
    narrower = np.sqrt(TUNING.answer.better_known**2 - 1)
    better[: chart.lens_count] = what == "lens"
    first = chart.sheet_first + BentPaper.names.index(BentPaper.print_terms[0])
    better[first : first + len(BentPaper.print_terms)] = what == "print"
    return adjustment.covariance_with(
        (narrower * better * prior_weights(adjustment.problem))[adjustment.free]
    )


def _sigmas(
    adjustment: Adjustment, covariance: Float[np.ndarray, "f f"]
) -> Float[np.ndarray, "v 4"]:
    """Of pan, tilt and swing in degrees and of the distance in mm, of each camera."""
    sigmas = []
    for view in range(len(adjustment.used)):
        rows = adjustment.rows(view)
        by_step = adjustment.degrees_by_step(view)
        variance = np.diag(by_step @ covariance[np.ix_(rows, rows)] @ by_step.T)
        sigmas.append(np.sqrt(variance[: PoseModel.AIMED.size]))
    return np.array(sigmas)
