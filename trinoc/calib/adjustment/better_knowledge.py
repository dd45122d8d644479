"""What it would give to know the lens or the print better, without another picture of the rig."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.estimate import Adjustment, prior_weights
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.result.calibration import Alternative
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.pose import PoseModel

# What may be known better, and how. The bend of the paper is not among it: pictures show it.
_HOW = {
    "lens": "calibrate the lens (`trinoc intrinsics`, ten pictures of the sheet)",
    "print": "measure the sheet's two bars (--print-scale)",
}
# What is taken to be exact and may be wrong, and how to say better.
_UNSEEN = {
    "aim": "an optical axis {:.2g} mm beside the origin of the sheet",
    "focal length": "a focal length {:.2%} off",
    "aspect": "a focal length along v {:.2%} off against that along u",
    "principal point": "a principal point {:.2g} px off",
    "radial distortion": "a radial distortion k1 {:.2g} off",
}
_SAY_LENS = "give a lens with its covariance, as `trinoc intrinsics` writes it"
_SAY_AIM = "state its sigma"


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


def say_what_goes_unseen(alternatives: Mapping[str, Sequence[Alternative]]) -> str:
    """The worst that may be wrong with what is taken to be exact, and does not show; empty where
    nothing of it moves a camera by much.

    alternatives : for each camera, what its residuals say of all that is held fixed.
    """
    tests = [(test, name) for name, own in alternatives.items() for test in own]
    if not tests:
        return ""
    worst, name = max(tests, key=lambda item: item[0].unseen_strain)
    if worst.unseen_strain <= TUNING.answer.strain_sigmas:
        return ""
    of, better = ("aim", _SAY_AIM) if worst.name == "aim" else ("lens", _SAY_LENS)
    return (
        f"The {of} is taken to be exact. The picture of {name} may well not show "
        f"{_UNSEEN[worst.name].format(np.linalg.norm(worst.unseen))}, which moves the camera by "
        f"{worst.unseen_strain:.0f} of its sigmas: {better}."
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
