"""Laws of the calibration of a lens, and the scatter of its errors against their covariance."""

import dataclasses

import numpy as np
import pytest

from tests.calib.simulated_lens import (
    LENS,
    SHEET,
    SIZE_PX,
    detections,
    fitted_names,
    good_poses,
    lens_sigmas,
    lens_values,
    squared_distance,
)
from trinoc.calib import Status
from trinoc.calib.lens_calibration import calibrate_intrinsics
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.lenses.polynomial import BrownConrady

POSES = good_poses()


def test_exact_centres_give_the_lens_back():
    result = calibrate_intrinsics(detections(POSES, sigma_px=0.0), SHEET)
    assert result.overall_status is Status.CONVERGED
    assert result.fits["camera"].rank == 9
    np.testing.assert_allclose(lens_values(result)[:4], LENS[:4], atol=1e-3)
    np.testing.assert_allclose(lens_values(result)[4:8], LENS[4:8], atol=1e-3)
    np.testing.assert_allclose(result.world_from_board, POSES, atol=1e-3)
    assert result.has_rig
    assert result.lens.image_size_px == SIZE_PX


def test_the_order_of_pictures_does_not_matter():
    image_detections = detections(POSES)
    one = calibrate_intrinsics(image_detections, SHEET)
    other = calibrate_intrinsics(image_detections[::-1], SHEET)
    assert (np.abs(lens_values(one) - lens_values(other)) < 1e-3 * lens_sigmas(one)).all()
    np.testing.assert_allclose(lens_sigmas(one), lens_sigmas(other), rtol=1e-4)


def test_turning_the_sheet_by_90_degrees_leaves_the_lens():
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    turned = Pattern(
        name="turned",
        centres_mm=SHEET.centres_mm @ quarter.T,
        radius_mm=SHEET.radius_mm,
        inner_radius_mm=SHEET.inner_radius_mm,
        lattice=np.round(SHEET.lattice @ quarter.T).astype(int),
        line_width_mm=SHEET.line_width_mm,
        line_half_length_mm=SHEET.line_half_length_mm,
        line_style=SHEET.line_style,
        line_gap_mm=SHEET.line_gap_mm,
    )
    image_detections = detections(POSES)
    one, other = (
        calibrate_intrinsics(image_detections, SHEET),
        calibrate_intrinsics(image_detections, turned),
    )
    assert (np.abs(lens_values(one) - lens_values(other)) < 1e-3 * lens_sigmas(one)).all()
    np.testing.assert_allclose(lens_sigmas(one), lens_sigmas(other), rtol=1e-4)


@pytest.mark.slow
def test_errors_scatter_as_the_covariance_says():
    trials, squared, scores = 40, [], []
    for seed in range(trials):
        result = calibrate_intrinsics(detections(POSES, seed=seed), SHEET)
        squared.append(squared_distance(result, LENS))
        scores.append((lens_values(result) - LENS) / lens_sigmas(result))
    # A mean of `trials` chi-squares of nine degrees of freedom, within four deviations.
    assert abs(np.mean(squared) / 9 - 1) < 4 * np.sqrt(2 / (9 * trials))
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    np.testing.assert_allclose(rms, 1.0, atol=4 / np.sqrt(2 * trials))


def test_circles_located_wrongly_are_left_out_and_counted():
    image_detections = detections(POSES)
    clean = calibrate_intrinsics(detections(POSES), SHEET)
    for number, rows, shift in ((2, [5], [0.4, -0.3]), (5, [1, 7], [30.0, 30.0])):
        centres = image_detections[number].centres_px.copy()
        centres[rows] += shift
        image_detections[number] = dataclasses.replace(image_detections[number], centres_px=centres)
    result = calibrate_intrinsics(image_detections, SHEET)
    used = [view.used for view in result.views]
    assert np.flatnonzero(~used[2]).tolist() == [5]
    assert np.flatnonzero(~used[5]).tolist() == [1, 7]
    assert all(used[k].all() for k in range(8) if k not in (2, 5))
    assert (np.abs(lens_values(result) - lens_values(clean)) < lens_sigmas(clean)).all()
    assert any("picture 6: 2 of" in sentence for sentence in result.refused)


def test_sigmas_grow_with_the_residuals():
    honest = calibrate_intrinsics(detections(POSES, sigma_px=0.05), SHEET)
    image_detections = [
        dataclasses.replace(each, covariance_px2=each.covariance_px2 / 100.0)
        for each in detections(POSES, sigma_px=0.05)
    ]
    bold = calibrate_intrinsics(image_detections, SHEET)
    assert bold.fits["camera"].sigma_factor == pytest.approx(10.0, rel=0.1)
    np.testing.assert_allclose(lens_sigmas(bold), lens_sigmas(honest), rtol=0.1)


def test_a_lens_without_distortion_asks_for_none():
    straight = np.append(LENS[:4], np.zeros(5))
    image_detections = detections(POSES, values=straight)
    result = calibrate_intrinsics(image_detections, SHEET)
    assert any("need no distortion" in note for note in result.notes)
    undistorted = calibrate_intrinsics(image_detections, SHEET, distortion=0)
    assert undistorted.has_rig
    assert undistorted.lens.distortion_model == "none"
    assert (lens_sigmas(undistorted)[4:] == 0).all()
    assert (np.abs(lens_values(undistorted) - straight) <= 4 * lens_sigmas(undistorted)).all()


def test_a_known_aspect_is_held_and_gives_millimetres():
    pitch = (0.0162, 0.0134)
    lens = LENS.copy()
    lens[:2] = 16.0 / np.array(pitch)
    image_detections = detections(POSES, values=lens)
    result = calibrate_intrinsics(image_detections, SHEET, pixel_pitch_mm=pitch, aspect="pitch")
    assert fitted_names(result) == BrownConrady.parameter_names
    assert result.value("fy_px") / result.value("fx_px") == pytest.approx(
        pitch[0] / pitch[1], rel=1e-12
    )
    assert result.has_rig
    assert result.lens.focal_length_mm == pytest.approx(
        16.0, abs=4 * result.sigma("fx_px") * 0.0162
    )
    # Both change by one step: their errors are one, in that ratio.
    focal_covariance = result.lens_covariance[:2, :2]
    of_fx = np.array([1.0, pitch[0] / pitch[1]])
    np.testing.assert_allclose(focal_covariance, focal_covariance[0, 0] * np.outer(of_fx, of_fx))
    free = calibrate_intrinsics(image_detections, SHEET, pixel_pitch_mm=pitch)
    assert result.sigma("fy_px") <= free.sigma("fy_px")


def test_the_picture_is_best_known_amid_the_circles():
    result = calibrate_intrinsics(detections(POSES), SHEET)
    sigma = result.field_sigma_px
    assert sigma[2, 2] == sigma.min()
    assert sigma.max() == max(sigma[0, 0], sigma[0, 4], sigma[4, 0], sigma[4, 4])
    text = result.summary()
    assert sum(line.startswith("  ") and "+-" in line for line in text.splitlines()) == 9
    assert "8 images" in text
