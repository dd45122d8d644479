"""A chi-square is stated as the deviation of a normal number with the same probability."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from trinoc.calib.rig_check.comparison import compare_rigs, sigmas_of_chi_square
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.propagation import field_grid_px
from trinoc.geometry.camera import POSE_NAMES, Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.numerics.tables import with_field
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
    deviations = [sigmas_of_chi_square(x, freedom) for x in np.linspace(1000.0, 4000.0, 200)]
    assert np.all(np.diff(deviations) > 0)
    assert deviations[-1] == pytest.approx(np.sqrt(4000.0))


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
    assert not compare_rigs(now, before).cameras["a"].moved
    strict = with_field(TUNING, "rig_check.moved_sigmas", 3.9)
    assert compare_rigs(now, before, tuning=strict).cameras["a"].moved


NAMES = tuple(f"a.{name}" for name in PARAMETER_NAMES)


def drawn(rig: Rig, covariance: np.ndarray, random: np.random.Generator) -> Rig:
    """The rig with errors drawn from this covariance."""
    off = dict(
        zip(NAMES, random.multivariate_normal(np.zeros(len(NAMES)), covariance), strict=True)
    )
    camera = rig["a"]
    values = {name: getattr(camera, name) + off[f"a.{name}"] for name in POSE_NAMES}
    aim = camera.aim_mm + np.array([off["a.aim_x_mm"], off["a.aim_y_mm"]])
    moved = Camera.from_degrees(camera.intrinsics, **values, aim_mm=aim)
    return Rig({"a": moved}, parameters=NAMES, covariance=covariance)


def test_rigs_that_differ_by_their_errors_differ_by_one_sigma_over_the_field() -> None:
    random = np.random.default_rng(6)
    rig = Rig({"a": table1_rig()["left"]})
    root = random.normal(size=(6, 6)) * np.array([0.02, 0.02, 0.02, 0.2, 0.2, 0.2])[:, None]
    squared = []
    for _ in range(200):
        now, before = (drawn(rig, share * root @ root.T, random) for share in (1.0, 0.5))
        change = compare_rigs(now, before).cameras["a"]
        assert change.field_px > 0
        squared.append(change.field_sigmas**2)
    # Six numbers at most, which the field weighs unequally.
    assert np.mean(squared) == pytest.approx(1.0, abs=0.3)


def test_a_turn_about_the_optical_axis_is_so_many_pixels_over_the_field() -> None:
    camera = table1_rig()["left"]
    swung = Camera.from_degrees(
        camera.intrinsics,
        pan_deg=camera.pan_deg,
        tilt_deg=camera.tilt_deg,
        swing_deg=camera.swing_deg + 0.1,
        distance_mm=camera.distance_mm,
    )
    change = compare_rigs(Rig({"a": swung}), Rig({"a": camera})).cameras["a"]
    from_middle = field_grid_px(camera.image_size_px) - camera.intrinsics.principal_point_px
    unlike = np.asarray(camera.intrinsics.focal_length_px)
    turned = (from_middle / unlike)[..., ::-1] * unlike * np.radians(0.1)
    assert change.field_px == pytest.approx(np.sqrt(np.mean(np.sum(turned**2, -1))), rel=1e-3)
    assert np.isnan(change.field_sigmas)
    assert np.isnan(change.sigmas)


def test_a_camera_whose_frame_is_the_world_has_no_distance_to_compare_at() -> None:
    camera = Camera(table1_rig()["left"].intrinsics, Pose(np.eye(3, 4)))
    rig = Rig({"a": camera}, parameters=NAMES, covariance=np.eye(6))
    assert np.isnan(compare_rigs(rig, rig).cameras["a"].field_px)


def test_pictures_of_another_size_have_no_field_in_common() -> None:
    camera = table1_rig()["left"]
    half = Intrinsics(
        focal_length_px=np.asarray(camera.intrinsics.focal_length_px) / 2, image_size_px=(256, 240)
    )
    change = compare_rigs(Rig({"a": Camera(half, camera.pose)}), Rig({"a": camera})).cameras["a"]
    assert np.isnan(change.field_px)
    assert change.moved_mm == pytest.approx(0)
