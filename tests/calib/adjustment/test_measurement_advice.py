"""The promised gain of a better measurement equals that of a fit with that measurement."""

import dataclasses
import functools

import numpy as np
import pytest

from tests.calib.adjustment.made_views import LENS_FACTOR, SHEET, made_views
from trinoc.calib.adjustment.adjustment import Adjustment, adjust
from trinoc.calib.adjustment.measurement_advice import advise_measurement
from trinoc.calib.problem.sheet_problem import SheetPriors
from trinoc.calib.sentences import measurement_advice
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.pose import PoseModel

AIM_MM = 20.0
# The lens covariance of a data sheet.
WIDE = 10 * LENS_FACTOR
SHEET_OF_PRINTER = Systematics(
    print_scale_sigma=(7e-4, 7e-4), print_size_sigma=2e-3, flatness_mm=0.3
)


@functools.cache
def made_cameras():
    return made_views(3, Systematics()).cameras


def fitted(systematics: Systematics, lens_factor: np.ndarray | None = None) -> Adjustment:
    """Adjustment of the same circles, of an exact sheet, under the stated systematics."""
    cameras = [dataclasses.replace(each, lens_factor=lens_factor) for each in made_cameras()]
    return adjust(
        cameras, SHEET, SheetPriors(PoseModel.AIMED, systematics._replace(aim_sigma_mm=AIM_MM))
    )


def largest_sigmas(adjustment: Adjustment) -> tuple[float, float]:
    """Largest sigma of the angles, in degrees, and of the distances, in mm."""
    sigmas = []
    for view in range(len(made_cameras())):
        rows, by_step = adjustment.rows(view), adjustment.degrees_by_step(view)
        camera_covariance = by_step @ adjustment.covariance[np.ix_(rows, rows)] @ by_step.T
        sigmas.append(np.sqrt(np.diag(camera_covariance)))
    angles, distances = np.split(np.array(sigmas)[:, :4], [3], axis=1)
    return float(angles.max()), float(distances.max())


@pytest.mark.parametrize(
    ("subject", "systematics", "lens", "better", "better_lens"),
    [
        ("lens", SHEET_OF_PRINTER, WIDE, SHEET_OF_PRINTER, WIDE / 10),
        (
            "print",
            SHEET_OF_PRINTER,
            None,
            SHEET_OF_PRINTER._replace(print_scale_sigma=(7e-5, 7e-5), print_size_sigma=2e-4),
            None,
        ),
    ],
)
def test_what_is_promised_is_what_a_fit_that_knows_so_much_gives(
    subject, systematics, lens, better, better_lens
) -> None:
    adjustment = fitted(systematics, lens)
    advice = advise_measurement([adjustment], systematics)
    assert advice is not None
    assert advice.subject == subject
    now, then = largest_sigmas(adjustment), largest_sigmas(fitted(better, better_lens))
    np.testing.assert_allclose((advice.angle_now_deg, advice.distance_now_mm), now)
    np.testing.assert_allclose((advice.angle_then_deg, advice.distance_then_mm), then, rtol=0.02)
    for number in (advice.distance_then_mm, advice.distance_now_mm):
        assert f"{number:.2g}" in measurement_advice(advice)


def test_where_nothing_is_assumed_nothing_is_advised() -> None:
    assert advise_measurement([fitted(Systematics())], Systematics()) is None


def test_bars_that_were_measured_are_not_measured_again() -> None:
    measured = Systematics(print_scale_sigma=(5e-4, 5e-4))
    assert advise_measurement([fitted(measured)], measured) is None
