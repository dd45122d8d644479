"""The slope of the light over a sheet is estimated only from paper that no line darkens."""

import numpy as np
import pytest

from tests.calib.simulated import reference_sheet
from trinoc.calib.detection.cross_lines import are_clear_of_lines
from trinoc.calib.detection.measure_circles import light_slope
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING

SHEET = reference_sheet()
# Two pixels a millimetre.
PLACE_PX = 2.0 * SHEET.centres_mm


def test_circles_on_the_crossed_lines_are_beside_them() -> None:
    clear = are_clear_of_lines(SHEET, np.arange(len(SHEET)), TUNING)
    np.testing.assert_array_equal(clear, np.all(SHEET.centres_mm != 0, axis=1))
    between = Pattern.cross_grid(rows=8, columns=8, pitch_mm=20.0, radius_mm=6.0)
    assert are_clear_of_lines(between, np.arange(len(between)), TUNING).all()


@pytest.mark.parametrize("slope", [(0.0, 0.0), (4e-4, -2e-4)])
def test_paper_that_lines_darken_bends_no_light(slope: tuple[float, float]) -> None:
    clear = are_clear_of_lines(SHEET, np.arange(len(SHEET)), TUNING)
    light = 230.0 * (1.0 + PLACE_PX @ np.array(slope))
    estimate, unsure = light_slope(PLACE_PX, np.where(clear, light, 0.97 * light), clear, TUNING)
    np.testing.assert_allclose(estimate, np.array(slope) * (230.0 / light)[:, None], atol=1e-9)
    assert unsure.max() < 1e-9


def test_all_are_believed_where_too_few_are_clear() -> None:
    light, few = 230.0 * (1.0 + 1e-3 * PLACE_PX[:, 0]), np.arange(len(PLACE_PX)) < 3
    estimate, _ = light_slope(PLACE_PX, light, few, TUNING)
    np.testing.assert_allclose(estimate[:, 0], 0.23 / light, rtol=1e-6)
