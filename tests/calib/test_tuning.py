"""The constants of calibration are arguments, and another value changes the result."""

import dataclasses

import numpy as np

from simulation.camera_picture.render import render_sheet
from tests.calib.made_shots import BOARD, shots
from tests.calib.simulated import EXACT, TABLE_1, camera_of, reference_sheet, simulated_detection
from trinoc.calib import CalibrationResult, calibrate_detections
from trinoc.calib.lens_calibration import calibrate_intrinsics
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.sheet_calibration import calibrate
from trinoc.calib.tuning.every_group import TUNING, CalibTuning


def with_gate(gate: float) -> CalibTuning:
    """The default tuning with another gate for wrong corners and circles."""
    return dataclasses.replace(TUNING, problem=dataclasses.replace(TUNING.problem, gate=gate))


def left_out(result: CalibrationResult) -> int:
    return sum(int((~fit.used).sum()) for fit in result.fits.values())


def test_a_tighter_gate_leaves_out_more_corners_of_a_rig() -> None:
    detections = shots(count=6)
    default, same = (calibrate_rig(detections, BOARD, throw=False) for _ in range(2))
    strict = calibrate_rig(detections, BOARD, throw=False, tuning=with_gate(2.0))
    explicit_default = calibrate_rig(detections, BOARD, throw=False, tuning=CalibTuning())
    assert left_out(strict) > left_out(default) == 0
    np.testing.assert_array_equal(default.values, explicit_default.values)
    np.testing.assert_array_equal(default.values, same.values)


def test_a_tighter_gate_leaves_out_more_corners_of_a_lens() -> None:
    detections = shots(count=8, cameras=("left",))["left"]
    results = [
        calibrate_intrinsics(detections, BOARD, throw=False, tuning=with_gate(gate))
        for gate in (6.0, 2.0)
    ]
    assert left_out(results[1]) > left_out(results[0]) == 0


def test_a_tighter_gate_leaves_out_more_circles_of_a_sheet() -> None:
    sheet = reference_sheet()
    detections = {"left": simulated_detection(camera_of(TABLE_1["left"]), sheet, seed=1)}
    lens = camera_of(TABLE_1["left"]).intrinsics
    default, strict = (
        calibrate_detections(detections, sheet, lens, systematics=EXACT, tuning=with_gate(gate))
        for gate in (6.0, 1.5)
    )
    assert left_out(strict) > left_out(default) == 0


def test_an_image_of_too_little_contrast_is_not_fitted() -> None:
    sheet, camera = reference_sheet(), camera_of(TABLE_1["left"])
    image = render_sheet(sheet, camera, blur_px=0.6)
    changed = dataclasses.replace(TUNING.photometric, least_contrast=1e4)
    tuning = dataclasses.replace(TUNING, photometric=changed)
    result = calibrate(
        {"left": image}, sheet, camera.intrinsics, orientation="upright", tuning=tuning
    )
    assert result.fits["left"].method == "points"
    assert any("contrast is too low" in note for note in result.fits["left"].notes)
