"""Wrong values assumed exact: the images refute them, or a note says that they may not."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from tests.calib.adjustment.made_views import SHEET, SIGMA_PX, circles_px, detection
from tests.calib.simulated import LENS, TABLE_1
from trinoc.calib.adjustment.adjustment import adjust
from trinoc.calib.adjustment.measurement_advice import find_undetectable_errors
from trinoc.calib.adjustment.model_tests import run_fixed_parameter_tests
from trinoc.calib.camera_notes import is_suspect
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors
from trinoc.calib.result.calibration import FixedParameterTest
from trinoc.calib.sentences import undetectable_errors
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry import Pose
from trinoc.geometry.pose import PoseModel

# Bars were read; paper and aim are as anybody's.
MEASURED = Systematics(print_scale_sigma=(5e-4, 5e-4), flatness_mm=0.3, aim_sigma_mm=20.0)
DRAWS = 40
FOCAL_PX = np.asarray(LENS.focal_length_px)
# Changes of fx, fy, cx, cy, k1 for a unit of each alternative.
CHANGES = {
    "focal length": np.array([[*FOCAL_PX, 0.0, 0.0, 0.0]]),
    "aspect": np.array([[-0.5 * FOCAL_PX[0], 0.5 * FOCAL_PX[1], 0.0, 0.0, 0.0]]),
    "principal point": np.eye(5)[2:4],
    "radial distortion": np.eye(5)[4:],
}


class Fitted(NamedTuple):
    """Tests of one camera's fixed parameters; its pose error in sigmas and in degrees and mm."""

    tests: dict[str, FixedParameterTest]
    distance: float
    scatter: float
    off: np.ndarray


def fitted(seed: int, change: np.ndarray) -> Fitted:
    """Fit of one camera over a random sheet, through a lens that differs from the assumed one."""
    random = np.random.default_rng([6, seed])
    sigma = BentPaper.sigmas(0.0, MEASURED.print_scale_sigma, MEASURED.flatness_mm)
    values = np.append(np.radians(TABLE_1["left"][:3]), TABLE_1["left"][3])
    pose = Pose.from_parameters(jnp.array([*values, *random.normal(size=2)]))
    noise = SIGMA_PX * random.normal(size=(len(SHEET), 2))
    sheet_detection = detection(
        circles_px(pose, change, sigma * random.normal(size=len(sigma))) + noise, SIGMA_PX
    )
    camera = SheetCamera("left", sheet_detection, LENS, None, pose)
    adjustment = adjust([camera], SHEET, SheetPriors(PoseModel.AIMED, MEASURED))
    tests = run_fixed_parameter_tests(adjustment, 0)
    off = adjustment.parameters(0) - np.asarray(pose.parameters)
    off[:3] = np.degrees(off[:3])
    step = np.linalg.solve(adjustment.degrees_by_step(0), off)
    distance = float(np.linalg.norm(adjustment.pose_root(0) @ step))
    by_name = {test.name: test for test in tests}
    return Fitted(by_name, distance, float(adjustment.reduced_chi_square[0]), off)


@pytest.mark.parametrize("name", CHANGES)
def test_four_in_five_changes_that_may_go_unseen_are_found_and_all_move_the_camera(name) -> None:
    unseen = fitted(0, np.zeros(5)).tests[name].undetectable
    made = [fitted(seed, unseen @ CHANGES[name]) for seed in range(DRAWS)]
    share = np.mean([one.tests[name].is_significant for one in made])
    power = TUNING.answer.power
    assert share == pytest.approx(power, abs=3 * np.sqrt(power * (1 - power) / DRAWS))
    # The change, and what chance does in six directions.
    foreseen = np.hypot([one.tests[name].undetectable_strain for one in made], np.sqrt(6))
    distance = np.array([one.distance for one in made])
    assert np.mean(distance / foreseen) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", ["focal length", "aspect"])
def test_what_is_found_and_moves_the_camera_far_is_suspect_though_places_scatter_little(
    name,
) -> None:
    change = 1.1 * fitted(0, np.zeros(5)).tests[name].undetectable @ CHANGES[name]
    fits = [
        fit for fit in (fitted(seed, change) for seed in range(8)) if fit.tests[name].is_significant
    ]
    assert len(fits) > 4
    for fit in fits:
        assert fit.scatter < TUNING.answer.large_chi_square
        assert is_suspect([fit.tests[name]], fit.scatter)
        assert not is_suspect([fit.tests[name]._replace(strain=3.9)], fit.scatter)


@pytest.mark.parametrize("name", ["focal length", "principal point"])
def test_what_goes_unseen_moves_the_camera_by_the_degrees_and_mm_that_are_stated(name) -> None:
    """The same noise is fitted with the change and without it."""
    right = fitted(0, np.zeros(5))
    test = right.tests[name]
    wrong = fitted(0, test.undetectable @ CHANGES[name])
    moved = np.abs(wrong.off - right.off)
    np.testing.assert_allclose(
        moved,
        np.abs(test.undetectable_motion),
        rtol=0.1,
        atol=0.02 * np.abs(test.undetectable_motion).max(),
    )


def test_rare_residuals_are_suspect_where_they_would_move_the_camera_far() -> None:
    test = fitted(0, np.zeros(5)).tests["focal length"]
    rare = test._replace(p_value=0.5 * TUNING.answer.chance_where_strained, strain=4.1)
    assert not rare.is_significant
    assert is_suspect([test._replace(p_value=1e-8, strain=1.0), rare], 1.0)
    assert not is_suspect([rare._replace(strain=3.9)], 1.0)
    assert not is_suspect([rare._replace(p_value=2 * TUNING.answer.chance_where_strained)], 1.0)


def test_what_may_go_unseen_is_said_once_in_the_units_of_the_answer() -> None:
    tests = list(fitted(0, np.zeros(5)).tests.values())
    worst = max(tests, key=lambda test: test.undetectable_strain)
    weaker = worst._replace(
        undetectable=0.5 * worst.undetectable, undetectable_strain=0.5 * worst.undetectable_strain
    )
    sentence = undetectable_errors(*find_undetectable_errors([*tests, weaker]))
    assert sentence.count("The sigmas assume that the lens is exact") == 1
    assert worst.name == "principal point"
    assert f"up to {np.linalg.norm(worst.undetectable):.2g} px of the principal point" in sentence
    assert sentence.count("px of the principal point") == 1
    assert f"distance by {abs(worst.undetectable_motion[3]):.2g} mm" in sentence
    assert f"by {np.abs(worst.undetectable_motion[:3]).max():.2g} deg" in sentence
    assert "trinoc intrinsics" in sentence
    assert "of its sigmas" not in sentence


def test_what_would_move_no_camera_is_not_worth_saying() -> None:
    tests = [
        test._replace(undetectable_strain=3.9) for test in fitted(0, np.zeros(5)).tests.values()
    ]
    assert undetectable_errors(*find_undetectable_errors(tests)) == ""
    assert undetectable_errors(*find_undetectable_errors([])) == ""
