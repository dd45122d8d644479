"""Distances from right priors are chi-square, and large distances name the wrong prior."""

import jax.numpy as jnp
import numpy as np
import pytest

from tests.calib.adjustment.made_views import (
    LENS_FACTOR,
    SHEET,
    SIGMA_PX,
    TYPICAL,
    circles_px,
    detection,
    made_views,
)
from tests.calib.simulated import LENS, TABLE_1
from trinoc.calib import CalibrationResult, Status
from trinoc.calib.adjustment.adjustment import Adjustment, adjust
from trinoc.calib.adjustment.prior_pulls import PriorSpace, refuted_priors, unknowns_with_priors
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.problem.sheet_problem import SheetPriors
from trinoc.calib.sheet_calibration import calibrate_detections
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry import Pose
from trinoc.geometry.pose import PoseModel

# As `made_views` draws it.
KNOWN = TYPICAL._replace(aim_sigma_mm=2.0)
DRAWS = 30
FOCAL_PX = np.asarray(LENS.focal_length_px)
# A lens of which the focal length along u alone is uncertain, by .2 %.
ALONG_U = np.zeros((5, 1))
ALONG_U[0] = 2e-3 * FOCAL_PX[0]
# Before a camera that looks along Y, u is along X; before one from aside it is not.
AHEAD, ASIDE = (0.0, 50.0, 0.0, 475.0), TABLE_1["left"]


def adjusted(seed: int, systematics: Systematics = KNOWN) -> Adjustment:
    made = made_views(seed, systematics, lens_factor=LENS_FACTOR, cameras=("left",))
    return adjust(made.cameras, SHEET, SheetPriors(PoseModel.AIMED, systematics))


def test_distances_from_right_priors_are_as_probable_as_they_claim() -> None:
    """The p-values of each kind of unknown have a mean of a half, as uniform ones do."""
    chances: dict[str, list[float]] = {}
    for seed in range(DRAWS):
        adjustment = adjusted(seed)
        space = PriorSpace.of(adjustment)
        for pull in map(space.pull, unknowns_with_priors(adjustment)):
            if pull.freedom:
                chances.setdefault(pull.unknown.kind, []).append(pull.p_value)
        assert refuted_priors(adjustment) == []
    assert {"all", "bend", "principal point", "print aspect"} <= set(chances)
    # Unknowns that no image determines are not tested.
    assert "print size" not in chances
    for kind, values in chances.items():
        # Bends of one sheet are twelve tests that hardly depend on each other.
        sigma = np.sqrt(1 / 12 / len(values))
        assert np.mean(values) == pytest.approx(0.5, abs=4 * sigma), kind


def calibrated(values: tuple[float, ...], change: np.ndarray, **sheet: float) -> CalibrationResult:
    """Calibration of one camera, given its lens change and the sheet's shares and heights in mm."""
    shape = np.array([sheet.get(name.replace(" ", "_"), 0.0) for name in BentPaper.names])
    pose = Pose.from_parameters(jnp.array([*np.radians(values[:3]), values[3], 0.0, 0.0]))
    noise = SIGMA_PX * np.random.default_rng(5).normal(size=(len(SHEET), 2))
    detections = {"left": detection(circles_px(pose, change, shape) + noise, SIGMA_PX)}
    systematics = TYPICAL._replace(
        print_scale_sigma=(7e-4, 7e-4), lens_covariance={"left": ALONG_U @ ALONG_U.T}
    )
    return calibrate_detections(detections, SHEET, LENS, systematics=systematics, throw=False)


@pytest.mark.parametrize("is_print", [True, False], ids=["print", "lens"])
def test_two_unknowns_that_look_alike_are_named_together(is_print: bool) -> None:
    """Both priors together, .22 %, are 5.4 sigma from 1.2 %."""
    wrong = {"print_along_X": 0.012} if is_print else {}
    change = np.zeros(5) if is_print else 6 * ALONG_U[:, 0]
    result = calibrated(AHEAD, change, **wrong)
    assert result.status["left"] is Status.SUSPECT
    (note,) = result.notes
    assert "the ratio of the print's scales along X and Y" in note
    assert "the focal length" in note
    assert "contradict one of these stated values" in note
    assert "--print-scale" in note
    assert "--lens" in note
    assert result.fits["left"].notes[0] == note


def test_what_is_within_the_priors_together_is_no_doubt() -> None:
    result = calibrated(AHEAD, np.zeros(5), print_along_X=0.006)
    assert result.status["left"] is Status.CONVERGED
    assert result.notes == ()


def test_a_lens_that_can_be_told_from_the_print_is_named_alone_with_its_amount() -> None:
    result = calibrated(ASIDE, 8 * ALONG_U[:, 0])
    assert result.status["left"] is Status.SUSPECT
    first, *_ = result.fits["left"].notes
    contradiction = "images contradict the stated focal length: the estimate differs from the"
    assert f"{contradiction} stated value by +0." in first
    assert "sigma. Calibrate the lens" in first
    assert not any("one of these" in note for note in result.notes)
