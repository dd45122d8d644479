"""Predicted effect of a better measured lens or print on the sigmas, without another image."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.adjustment import Adjustment, prior_weights
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.result.calibration import FixedParameterTest
from trinoc.calib.tuning.every_group import TUNING, AnswerTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.pose import PoseModel

# What can be measured better. The bend of the paper is not among it: the images show it.
_SUBJECTS = ("lens", "print")
# numerical: at most so many lens errors are listed, those that move a camera most.
_MOST_LISTED = 2


class MeasurementAdvice(NamedTuple):
    """The additional measurement (of the lens or of the print) that would reduce the sigmas most.

    Attributes
    ----------
    subject : "lens" or "print".
    angle_now_deg, angle_then_deg : largest sigma of pan, tilt and swing of all cameras, before and
        after the measurement.
    distance_now_mm, distance_then_mm : largest sigma of the distance of all cameras, before and
        after the measurement.
    tuning : least reduction that is reported, and the assumed improvement of the prior.
    """

    subject: str
    angle_now_deg: float
    angle_then_deg: float
    distance_now_mm: float
    distance_then_mm: float
    tuning: AnswerTuning = TUNING.answer

    @property
    def gains(self) -> tuple[tuple[str, float, float, str], ...]:
        """(quantity, sigma before, sigma after, unit) of each quantity whose sigma would shrink
        enough.
        """
        quantities = (
            ("angles", self.angle_now_deg, self.angle_then_deg, "deg"),
            ("distances", self.distance_now_mm, self.distance_then_mm, "mm"),
        )
        least_gain = self.tuning.enough_gain
        return tuple(quantity for quantity in quantities if quantity[1] > least_gain * quantity[2])


def advise_measurement(
    adjustments: Sequence[Adjustment], systematics: Systematics
) -> MeasurementAdvice | None:
    """Find the prior (lens or print) whose uncertainty contributes most to the sigmas of the
    cameras.

    Parameters
    ----------
    adjustments : adjustments of independent groups of cameras.
    systematics : priors of these adjustments. Measuring the print is not advised if its size is
        exact.

    Returns
    -------
    The advice. None if a better lens or print would not reduce the sigmas much.

    Notes
    -----
    The effect of a narrower prior is predicted by adding rows to the root of the information (Golub
    and Van Loan, Matrix Computations, 6.5), without a new fit.
    """
    now = np.concatenate([_sigmas(adjustment, adjustment.covariance) for adjustment in adjustments])
    if not now.all():
        # An undetermined pose needs more circles first.
        return None
    gains, tuning = {}, adjustments[0].problem.tuning.answer
    for subject in _SUBJECTS:
        if subject == "print" and not systematics.print_size_sigma:
            continue
        then = np.concatenate(
            [_sigmas(adjustment, _covariance(adjustment, subject)) for adjustment in adjustments]
        )
        mean = float(np.mean(np.log(now / then)))
        if mean > np.log(tuning.enough_gain):
            gains[subject] = mean, then.max(axis=0)
    if not gains:
        return None
    subject = max(gains, key=lambda subject: gains[subject][0])
    largest_now, then = now.max(axis=0), gains[subject][1]
    return MeasurementAdvice(
        subject,
        float(largest_now[:3].max()),
        float(then[:3].max()),
        float(largest_now[3]),
        float(then[3]),
        tuning,
    )


def find_undetectable_errors(
    tests: Iterable[FixedParameterTest],
) -> tuple[list[FixedParameterTest], FixedParameterTest | None]:
    """Find the errors of lens and aim that would move a camera far and that the images cannot show.

    Only lens parameters and aims that are assumed exact are considered.

    Parameters
    ----------
    tests : score tests of all cameras.

    Returns
    -------
    The tests of the lens errors that would move a camera most, and the test of the aim or None.
    Errors that would move every camera by less than a few of its sigmas are omitted.
    """
    worst: dict[str, FixedParameterTest] = {}
    for test in tests:
        is_worse = test.name not in worst or (
            test.undetectable_strain > worst[test.name].undetectable_strain
        )
        if is_worse and test.undetectable_strain > test.tuning.strain_sigmas:
            worst[test.name] = test
    ranked = sorted(worst.values(), key=lambda test: test.undetectable_strain, reverse=True)
    lens_tests = [test for test in ranked if test.name != "aim"]
    return lens_tests[:_MOST_LISTED], worst.get("aim")


def _covariance(adjustment: Adjustment, subject: str) -> Float[np.ndarray, "f f"]:
    """Predicted covariance, (f, f), of the estimated parameters if lens or print had a narrower
    prior.

    The prior sigmas are divided by `better_known` of the tuning.

    subject : "lens" or "print".
    """
    slices = adjustment.problem.slices
    better = np.zeros(len(adjustment.problem.free))
    narrower = np.sqrt(adjustment.problem.tuning.answer.better_known**2 - 1)
    better[slices.lenses] = subject == "lens"
    first = slices.sheets.start + BentPaper.names.index(BentPaper.print_terms[0])
    better[first : first + len(BentPaper.print_terms)] = subject == "print"
    return adjustment.covariance_with(
        (narrower * better * prior_weights(adjustment.problem))[adjustment.free]
    )


def _sigmas(
    adjustment: Adjustment, covariance: Float[np.ndarray, "f f"]
) -> Float[np.ndarray, "v 4"]:
    """Sigmas of pan, tilt, swing (degrees) and distance (mm) of each camera, (v, 4)."""
    sigmas = []
    for view in range(len(adjustment.used)):
        rows = adjustment.rows(view)
        by_step = adjustment.degrees_by_step(view)
        variance = np.diag(by_step @ covariance[np.ix_(rows, rows)] @ by_step.T)
        sigmas.append(np.sqrt(variance[: PoseModel.AIMED.size]))
    return np.array(sigmas)
