"""Messages of the circle fit if circles are wrong, too few, or of another sheet or lens."""

import dataclasses

import numpy as np
import pytest

from tests.calib.simulated import (
    EXACT,
    LENS,
    SIGMA_PX,
    TABLE_1,
    camera_of,
    reference_sheet,
    simulated_detection,
)
from trinoc.calib import (
    CalibrationResult,
    Detection,
    Status,
    calibrate_detections,
)
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.numerics.information import observability

SHEET = reference_sheet()
UPPER = camera_of(TABLE_1["upper"])


def detect(**options: object) -> Detection:
    return simulated_detection(UPPER, SHEET, seed=3, **options)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("shift_px", [0.2, 3.0, 40.0])
def test_a_circle_located_wrongly_is_dropped_and_counted(shift_px: float) -> None:
    detection = detect()
    clean = calibrate_detections({"a": detect()}, SHEET, LENS, systematics=EXACT)
    shift = np.zeros_like(detection.centres_px)
    shift[7] = [shift_px, -0.5 * shift_px]
    detection = dataclasses.replace(detection, centres_px=detection.centres_px + shift)
    result = calibrate_detections({"a": detection}, SHEET, LENS, systematics=EXACT)
    assert np.flatnonzero(~result.fits["a"].used).tolist() == [7]
    assert "1 circle was located wrongly" in " ".join(result.fits["a"].notes)
    error = np.abs(result.values - clean.values)
    assert (error < np.sqrt(np.diag(clean.covariance))).all()


def test_four_circles_of_25_located_wrongly_are_dropped() -> None:
    detection = detect()
    centres = detection.centres_px.copy()
    centres[[0, 6, 13, 24]] += np.array([[9.0, 4.0], [-3, 8], [1, 1], [30, -20]])
    detection = dataclasses.replace(detection, centres_px=centres)
    result = calibrate_detections({"a": detection}, SHEET, LENS, systematics=EXACT)
    assert np.flatnonzero(~result.fits["a"].used).tolist() == [0, 6, 13, 24]


def test_one_circle_leaves_named_parameters_free() -> None:
    with pytest.raises(CalibrationError, match="do not determine") as caught:
        calibrate_detections({"a": detect(circles=np.array([3]))}, SHEET, LENS, systematics=EXACT)
    assert caught.value.result is None
    assert "distance_mm" in caught.value.failures["a"]


# Small circles: large ones tell the tilt, weakly, by the shift of their ellipses' centres.
DOTS = Pattern.cross_grid(rows=5, columns=5, pitch_mm=20.0, radius_mm=0.5, rings="none")
ROW = np.flatnonzero(DOTS.centres_mm[:, 1] == 0.0)


def row_and_sheet() -> dict[str, Detection]:
    """Detections of a row through the origin by one camera and of the whole sheet by the others."""
    return {
        "upper": simulated_detection(UPPER, DOTS, seed=3, circles=ROW),
        "left": simulated_detection(camera_of(TABLE_1["left"]), DOTS, seed=1),
        "right": simulated_detection(camera_of(TABLE_1["right"]), DOTS, seed=2),
    }


def test_a_row_through_the_origin_does_not_hold_the_turn_about_itself() -> None:
    result = calibrate_detections(row_and_sheet(), DOTS, LENS, throw=False, systematics=EXACT)
    assert result.status == {
        "upper": Status.RANK_DEFICIENT,
        "left": Status.CONVERGED,
        "right": Status.CONVERGED,
    }
    assert result.rig.names == ("left", "right")
    assert result.fits["upper"].rank == 3
    assert "tilt_deg" in result.fits["upper"].gauge
    assert "upper: " in result.summary()


def test_a_failed_camera_is_named_and_the_others_are_kept() -> None:
    with pytest.raises(CalibrationError, match='amera "upper"') as caught:
        calibrate_detections(row_and_sheet(), DOTS, LENS, systematics=EXACT)
    assert isinstance(caught.value.result, CalibrationResult)
    assert caught.value.result.rig.names == ("left", "right")


def test_a_sheet_of_another_shape_is_refused_with_the_next_step() -> None:
    other = Pattern.cross_grid(rows=5, columns=5, pitch_mm=20.0, radius_mm=6.0, rings="none")
    other = dataclasses.replace(other, centres_mm=other.centres_mm * [1.0, 1.4])
    with pytest.raises(CalibrationError, match="pattern"):
        calibrate_detections({"a": detect()}, other, LENS, systematics=EXACT)


def test_sigmas_grow_with_the_residuals() -> None:
    noisy = simulated_detection(UPPER, SHEET, seed=3, sigma_px=10 * SIGMA_PX)
    noisy = dataclasses.replace(noisy, covariance_px2=noisy.covariance_px2 / 100.0)
    result = calibrate_detections({"a": noisy}, SHEET, LENS, systematics=EXACT)
    honest = simulated_detection(UPPER, SHEET, seed=3, sigma_px=10 * SIGMA_PX)
    expected = calibrate_detections({"a": honest}, SHEET, LENS, systematics=EXACT)
    ratio = result.sigma("a.pan_deg") / expected.sigma("a.pan_deg")
    assert ratio == pytest.approx(np.sqrt(expected.fits["a"].reduced_chi_square), rel=1e-3)


def test_a_missing_lens_is_named() -> None:
    lenses: dict[str, Intrinsics] = {"a": LENS}
    with pytest.raises(InputError, match='"b"'):
        calibrate_detections({"a": detect(), "b": detect()}, SHEET, lenses, systematics=EXACT)


def test_covariance_is_refused_off_the_determined_directions() -> None:
    information = np.diag([1e10, 1e10, 0.0])
    parameters = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
    determined = observability(information, parameters, np.ones(3))
    assert determined.rank == 2
    assert determined.gauge == (2,)
    np.testing.assert_allclose(determined.covariance[:2, :2], 1e-10 * np.eye(2), atol=1e-20)
    assert np.isnan(determined.covariance[2]).all()


def test_summary_holds_every_camera_and_its_sigmas() -> None:
    detections = {
        name: simulated_detection(camera_of(values), SHEET, seed=k)
        for k, (name, values) in enumerate(TABLE_1.items())
    }
    text = calibrate_detections(detections, SHEET, LENS, systematics=EXACT).summary()
    assert all(name in text for name in TABLE_1)
    assert text.count("+-") == 12
    assert "25 of 25" in text
