"""A chi-square counts as the deviation of one normal number that is as improbable."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from trinoc.calib.rig_check.comparison import compare_rigs, sigmas_of_chi_square
from trinoc.geometry.camera import Camera
from trinoc.geometry.rig import Rig
from trinoc.synth import table1_rig


@given(st.floats(0.0, 37.0))
def test_of_one_number_it_is_its_own_deviation(sigmas: float) -> None:
    assert sigmas_of_chi_square(sigmas**2, 1) == pytest.approx(sigmas, abs=1e-6)


@given(st.floats(0.01, 500.0), st.integers(1, 12))
def test_it_is_exceeded_as_seldom(chi_square: float, freedom: int) -> None:
    sigmas = sigmas_of_chi_square(chi_square, freedom)
    tail = stats.chi2.sf(chi_square, freedom)
    assert 2 * stats.norm.sf(sigmas) == pytest.approx(tail, rel=1e-6)


@pytest.mark.parametrize("freedom", [1, 6, 12])
def test_a_change_too_improbable_for_a_number_still_grows(freedom: int) -> None:
    each = [sigmas_of_chi_square(x, freedom) for x in np.linspace(1000.0, 4000.0, 200)]
    assert np.all(np.diff(each) > 0)
    assert each[-1] == pytest.approx(np.sqrt(4000.0))


def test_a_change_is_measured_by_the_variances_of_both_rigs() -> None:
    _, camera = next(iter(table1_rig().items()))
    turned = Camera.from_degrees(
        camera.intrinsics,
        pan_deg=camera.pan_deg + 0.2,
        tilt_deg=camera.tilt_deg,
        swing_deg=camera.swing_deg,
        distance_mm=camera.distance_mm,
        aim_mm=camera.aim_mm,
    )
    now, before = (
        Rig({"a": each}, parameters=("a.pan_deg",), covariance=np.array([[sigma**2]]))
        for each, sigma in ((turned, 0.03), (camera, 0.04))
    )
    assert compare_rigs(now, before).cameras["a"].sigmas == pytest.approx(0.2 / 0.05, rel=1e-6)
    assert compare_rigs(before, now).cameras["a"].sigmas == pytest.approx(0.2 / 0.05, rel=1e-6)
