"""What it would give to know the lens or the print better, without another picture of the rig."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.adjustment import Adjustment, prior_weights
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.result.calibration import Alternative
from trinoc.calib.tuning.every_group import TUNING, AnswerTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import PARAMETER_NAMES

# What may be known better, and how. The bend of the paper is not among it: pictures show it.
_HOW = {
    "lens": "calibrate the lens (`trinoc intrinsics`, ten pictures of the sheet)",
    "print": "measure the sheet's two bars (--print-scale)",
}
# What is assumed exact and may be wrong, by the names of its tests, with the size of the error.
_LENS_ERRORS = {
    "focal length": "up to {:.2g} % of the focal length",
    "aspect": "up to {:.2g} % of the ratio of its focal lengths",
    "principal point": "up to {:.2g} px of the principal point",
    "radial distortion": "up to {:.2g} of the radial distortion k1",
}
_PERCENT = ("focal length", "aspect")
# numerical: for words only: of errors of the lens, those that move the camera most are listed.
_MOST_LISTED = 2


class BetterKnowledge(NamedTuple):
    """The one thing to know better that narrows the cameras' sigmas most.

    Fields
    ------
    what : "lens" or "print".
    angle_now_deg, angle_then_deg : the largest sigma of pan, tilt and swing over all cameras, and
        what it would be, were this known so much better.
    distance_now_mm, distance_then_mm : the same of the distance.
    tuning : what counts as a gain, and how much better is compared.
    """

    what: str
    angle_now_deg: float
    angle_then_deg: float
    distance_now_mm: float
    distance_then_mm: float
    tuning: AnswerTuning = TUNING.answer

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
            if now > self.tuning.enough_gain * then
        )
        sentence = (
            f"What is assumed of the {self.what} makes up most of the cameras' sigmas: "
            f"{_HOW[self.what]}. Were it known {self.tuning.better_known:.0f} times as well, one "
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
    """Return the assumption that makes up most of the sigmas; None if the images make up more.

    adjustments : of cameras that share nothing. systematics : what they were fitted under; bars
    that were measured are not measured again.

    A prior that is narrower adds rows to the root of the information (Golub and Van Loan, Matrix
    Computations, 6.5): nothing is fitted anew.
    """
    now = np.concatenate([_sigmas(each, each.covariance) for each in adjustments])
    if not now.all():
        # A pose that the circles leave free wants circles first.
        return None
    gains, tuning = {}, adjustments[0].problem.tuning.answer
    for what in _HOW:
        if what == "print" and not systematics.print_size_sigma:
            continue
        then = np.concatenate([_sigmas(each, _covariance(each, what)) for each in adjustments])
        mean = float(np.mean(np.log(now / then)))
        if mean > np.log(tuning.enough_gain):
            gains[what] = mean, then.max(axis=0)
    if not gains:
        return None
    what = max(gains, key=lambda what: gains[what][0])
    most, then = now.max(axis=0), gains[what][1]
    return BetterKnowledge(
        what, float(most[:3].max()), float(then[:3].max()), float(most[3]), float(then[3]), tuning
    )


def say_what_goes_unseen(alternatives: Mapping[str, Sequence[Alternative]]) -> str:
    """Return what the images cannot show of a lens or aim that is assumed exact, and the remedy.

    Parameters
    ----------
    alternatives : for each camera, the tests of all that is held fixed.

    Returns
    -------
    Errors that a test would miss, and by how much each would change the worst camera, in the units
    of the answer; empty if none changes a camera by more than a few of its sigmas.
    """
    worst: dict[str, Alternative] = {}
    for tests in alternatives.values():
        for test in tests:
            is_worse = test.name not in worst or (
                test.unseen_strain > worst[test.name].unseen_strain
            )
            if is_worse and test.unseen_strain > test.tuning.strain_sigmas:
                worst[test.name] = test
    ranked = sorted(worst.values(), key=lambda test: test.unseen_strain, reverse=True)
    of_lens = [test for test in ranked if test.name in _LENS_ERRORS][:_MOST_LISTED]
    sentences = []
    if of_lens:
        errors = " or of ".join(f"{_error_of_lens(test)} ({_motion(test)})" for test in of_lens)
        sentences.append(
            "The sigmas rest on the lens being exact. One image of a plane cannot show an error "
            f"of {errors}: calibrate the lens with several images (`trinoc intrinsics`) and pass "
            "it with --lens."
        )
    if "aim" in worst:
        aim = worst["aim"]
        sentences.append(
            "The sigmas rest on the optical axis meeting the origin of the sheet exactly. The "
            f"image cannot show an error of up to {np.linalg.norm(aim.unseen):.2g} mm "
            f"({_motion(aim)}): state the sigma of the aim (--sigma aim_mm=)."
        )
    return " ".join(sentences)


def _error_of_lens(test: Alternative) -> str:
    size = float(np.linalg.norm(test.unseen))
    return _LENS_ERRORS[test.name].format(100 * size if test.name in _PERCENT else size)


def _motion(test: Alternative) -> str:
    """By how much the camera would be off, in its largest angle and in distance."""
    angles = np.abs(test.unseen_motion[:3])
    name = PARAMETER_NAMES[int(np.argmax(angles))].removesuffix("_deg")
    return (
        f"it would change {name} by {angles.max():.2g} deg and distance by "
        f"{abs(float(test.unseen_motion[3])):.2g} mm"
    )


def _covariance(adjustment: Adjustment, what: str) -> Float[np.ndarray, "f f"]:
    """The covariance, were the prior's sigmas of one thing so many times as small."""
    slices = adjustment.problem.slices
    better = np.zeros(len(adjustment.problem.free))
    narrower = np.sqrt(adjustment.problem.tuning.answer.better_known**2 - 1)
    better[slices.lenses] = what == "lens"
    first = slices.sheets.start + BentPaper.names.index(BentPaper.print_terms[0])
    better[first : first + len(BentPaper.print_terms)] = what == "print"
    return adjustment.covariance_with(
        (narrower * better * prior_weights(adjustment.problem))[adjustment.free]
    )


def _sigmas(
    adjustment: Adjustment, covariance: Float[np.ndarray, "f f"]
) -> Float[np.ndarray, "v 4"]:
    """Sigmas of each camera's pan, tilt and swing, degrees, and distance, mm."""
    sigmas = []
    for view in range(len(adjustment.used)):
        rows = adjustment.rows(view)
        by_step = adjustment.degrees_by_step(view)
        variance = np.diag(by_step @ covariance[np.ix_(rows, rows)] @ by_step.T)
        sigmas.append(np.sqrt(variance[: PoseModel.AIMED.size]))
    return np.array(sigmas)
