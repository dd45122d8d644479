"""Images as cameras deliver them: the estimate that is used, and its sigmas."""

import numpy as np
import pytest

from benchmarks.picture_conditions import CONDITIONS
from simulation.camera_picture.render import camera_picture
from trinoc.calib import CalibrationResult, Status
from trinoc.calib.sheet_calibration import calibrate
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.systematics import Systematics, data_sheet_covariance
from trinoc.synth import table1_lens
from trinoc.synth.rigs import TABLE_1

LENS = table1_lens()
PAN, TILT, SWING, DISTANCE = TABLE_1["right"]
POSE = (PAN + 1.0, TILT - 2.0, SWING + 0.5, DISTANCE + 6.0)


def answer(name: str, systematics: Systematics) -> tuple[CalibrationResult, np.ndarray]:
    """The calibration of one image, and its errors in reported sigmas."""
    condition = CONDITIONS[name]
    grid = condition.sheet
    pattern = Pattern.cross_grid(
        rows=grid.rows, columns=grid.columns, pitch_mm=grid.pitch_mm, radius_mm=grid.radius_mm
    )
    image = camera_picture(pattern, condition.camera(LENS, POSE), condition, seed=41)
    result = calibrate({"a": image}, pattern, LENS, systematics=systematics)
    return result, (result.values - POSE) / np.sqrt(np.diag(result.covariance))


EXACT = Systematics()
# Systematics of a bench set-up with a calibrated lens, and with a lens known by its data sheet.
BENCH = Systematics.typical({})
DATA_SHEET = BENCH._replace(lens_covariance={"a": data_sheet_covariance(LENS)})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "systematics", "method"),
    [
        ("sRGB, dark ink", EXACT, "pixels"),
        ("overexposed", EXACT, "pixels"),
        ("bent .1 mm", BENCH, "pixels"),
        ("print .1 % longer along X", BENCH, "pixels"),
        ("vignette and broad glare", DATA_SHEET, "pixels"),
    ],
)
def test_no_error_beyond_four_sigmas_is_silent(name, systematics, method) -> None:
    result, z = answer(name, systematics)
    assert result.status["a"] is Status.CONVERGED
    assert result.fits["a"].method == method
    assert np.abs(z).max() < 4
    assert (method == "points") == any(
        "Only the circle centres of this image were used" in note for note in result.fits["a"].notes
    )


@pytest.mark.slow
def test_a_picture_of_two_levels_counts_by_its_circles_alone() -> None:
    """A threshold moves edges, which no model of light explains."""
    condition = CONDITIONS["sRGB, dark ink"]
    pattern = Pattern.cross_grid(rows=8, columns=8, pitch_mm=20.0, radius_mm=6.0)
    picture = camera_picture(pattern, condition.camera(LENS, POSE), condition, seed=41)
    two_levels = np.where(picture > picture.mean(), 255, 0).astype(np.uint8)
    result = calibrate({"a": two_levels}, pattern, LENS, systematics=BENCH)
    assert result.fits["a"].method == "points"
    assert any("has two grey levels alone" in note for note in result.fits["a"].notes)
    z = (result.values - POSE) / np.sqrt(np.diag(result.covariance))
    assert np.abs(z).max() < 4


@pytest.mark.slow
def test_an_aim_beside_the_origin_is_said_and_allowed_for() -> None:
    result, _ = answer("aim .1 mm off", BENCH)
    assert "misses the origin of the sheet by (0.06, 0.08)" in result.fits["a"].notes[0]
    assert result.parameters == tuple(
        f"a.{name}" for name in ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
    )
    np.testing.assert_allclose(
        result.rig["a"].aim_mm, CONDITIONS["aim .1 mm off"].aim_mm, atol=0.01
    )
    assert result.sigma("a.aim_x_mm") < 0.01


@pytest.mark.slow
def test_an_exact_aim_that_is_not_is_suspect() -> None:
    result, _ = answer("aim .1 mm off", EXACT)
    assert result.status["a"] is Status.SUSPECT
