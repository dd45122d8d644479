"""Calibration from images to a rig, and the messages for bad images."""

import functools

import numpy as np
import pytest

from simulation.camera_picture.render import render_sheet
from tests.calib.simulated import DISTORTED_LENS, EXACT, LENS, TABLE_1, camera_of
from trinoc.calib import CalibrationResult, Status, sheet_calibration
from trinoc.calib.adjustment.adjustment import adjust
from trinoc.calib.sheet_calibration import calibrate
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.intrinsics import Intrinsics

SHEET = Pattern.default()


@functools.cache
def picture(name: str, lens_is_distorted: bool = False) -> np.ndarray:
    lens = DISTORTED_LENS if lens_is_distorted else LENS
    camera = camera_of(TABLE_1[name], lens)
    return render_sheet(SHEET, camera, noise_sigma=2.0, seed=7, supersampling=16)


def pictures() -> dict[str, np.ndarray]:
    return {name: picture(name) for name in TABLE_1}


def errors_in_sigmas(result: CalibrationResult) -> np.ndarray:
    truth = np.concatenate([TABLE_1[name] for name in result.rig.names])
    return (result.values - truth) / np.sqrt(np.diag(result.covariance))


def test_cameras_are_adjusted_once_by_circles_and_once_by_grey_levels(monkeypatch) -> None:
    """Two adjustments are enough if the ink has not spread and no grey levels are rejected."""
    methods = []

    def counted(cameras, *arguments):
        methods.append([camera.method for camera in cameras])
        return adjust(cameras, *arguments)

    monkeypatch.setattr(sheet_calibration, "adjust", counted)
    calibrate({"left": picture("left")}, SHEET, LENS, systematics=EXACT)
    assert methods == [["points"], ["pixels"]]


@pytest.mark.slow
def test_the_paper_s_rig_is_recovered() -> None:
    by_image = calibrate(pictures(), SHEET, LENS, systematics=EXACT)
    by_circles = calibrate(pictures(), SHEET, LENS, method="points", systematics=EXACT)
    for result in (by_image, by_circles):
        assert set(result.status.values()) == {Status.CONVERGED}
        assert np.abs(errors_in_sigmas(result)).max() < 5.0
    truth = np.concatenate(list(TABLE_1.values()))
    error = np.abs(by_image.values - truth).reshape(3, 4)
    assert error[:, :3].max() < 0.005
    assert error[:, 3].max() < 0.03
    for name in TABLE_1:
        quality = by_image.fits[name].image
        assert quality is not None
        assert by_circles.fits[name].image is None
        assert by_image.sigma(f"{name}.pan_deg") < by_circles.sigma(f"{name}.pan_deg")
        assert 0.9 < quality.reduced_chi_square < 1.15
        assert quality.blur_px == pytest.approx(0.7, abs=0.02)
        assert quality.ink_over_paper == pytest.approx(25 / 230, abs=0.01)


@pytest.mark.slow
def test_distortion_is_modelled_and_missed_when_it_is_left_out() -> None:
    images = {"left": picture("left", lens_is_distorted=True)}
    modelled = calibrate(images, SHEET, DISTORTED_LENS, systematics=EXACT)
    assert np.abs(errors_in_sigmas(modelled)).max() < 5.0
    ignored = calibrate(images, SHEET, LENS, systematics=EXACT)
    assert "radial distortion" in ignored.fits["left"].notes[0]


@pytest.mark.slow
def test_grey_levels_of_any_depth_give_one_answer() -> None:
    eight = picture("left")
    results = [
        calibrate({"left": image}, SHEET, LENS, systematics=EXACT)
        for image in (eight, eight.astype(np.uint16) * 257, np.stack([eight] * 3, axis=-1))
    ]
    for result in results[1:]:
        np.testing.assert_allclose(result.values, results[0].values, atol=1e-5)


def test_bad_pictures_are_named() -> None:
    blank = np.full((480, 512), 128, dtype=np.uint8)
    with pytest.raises(CalibrationError, match='amera "right"') as caught:
        calibrate({"left": picture("left"), "right": blank}, SHEET, LENS, systematics=EXACT)
    assert isinstance(caught.value.result, CalibrationResult)
    assert caught.value.result.status["right"] is Status.NOT_DETECTED
    with pytest.raises(InputError, match="same image"):
        calibrate({"a": picture("left"), "b": picture("left")}, SHEET, LENS, systematics=EXACT)
    with pytest.raises(InputError, match="512 x 400"):
        calibrate({"a": picture("left")[:400]}, SHEET, LENS, systematics=EXACT)


def test_a_wrong_focal_length_is_named() -> None:
    wrong = Intrinsics(
        focal_length_mm=16.1, pixel_pitch_mm=(0.0162, 0.0134), image_size_px=(512, 480)
    )
    result = calibrate({"left": picture("left")}, SHEET, wrong, method="points", systematics=EXACT)
    assert "focal length" in result.fits["left"].notes[0]


def test_colours_may_come_in_either_order() -> None:
    tint = np.random.default_rng(2).integers(-9, 10, (*picture("upper").shape, 3))
    colour = np.clip(picture("upper")[..., None] + tint, 0, 255).astype(np.uint8)
    answers = [
        calibrate({"upper": image}, SHEET, LENS, method="points", systematics=EXACT).values
        for image in (colour, colour[..., ::-1])
    ]
    np.testing.assert_array_equal(answers[0], answers[1])
