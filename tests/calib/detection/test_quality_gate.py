"""Tests of the model, of cameras that moved, and of further sources of uncertainty."""

import jax
import numpy as np
import pytest

from tests.calib.simulated import (
    EXACT,
    LENS,
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
    epipolar_sigma,
    point_covariance,
    printed_sheet,
    with_systematics,
)
from trinoc.calib.rig_check.comparison import compare_rigs
from trinoc.calib.sentences import fixed_parameter_off
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import InputError
from trinoc.geometry import project
from trinoc.geometry.intrinsics import Intrinsics

SHEET = reference_sheet()


def detections_of(
    cameras: dict[str, tuple[float, ...]], seed: int = 0, sigma_px: float = 0.005
) -> dict[str, Detection]:
    return {
        name: simulated_detection(camera_of(values), SHEET, seed=seed + k, sigma_px=sigma_px)
        for k, (name, values) in enumerate(cameras.items())
    }


def rig_of(seed: int = 0) -> CalibrationResult:
    return calibrate_detections(detections_of(TABLE_1, seed), SHEET, LENS, systematics=EXACT)


def test_a_right_model_is_not_accused() -> None:
    p_values = []
    for seed in range(30):
        detection = simulated_detection(camera_of(TABLE_1["left"]), SHEET, seed=seed)
        result = calibrate_detections({"a": detection}, SHEET, LENS, systematics=EXACT)
        p_values.extend(item.p_value for item in result.fits["a"].fixed_parameter_tests)
    # Aim, focal length, aspect, radial distortion.
    assert len(p_values) == 30 * 4
    assert min(p_values) > 1e-4
    # p-values of a right model are uniform.
    assert 0.3 < np.mean(p_values) < 0.7


@pytest.mark.parametrize(
    ("name", "lens", "aim_mm"),
    [
        ("aim", LENS, (0.05, -0.03)),
        (
            "focal length",
            Intrinsics(
                focal_length_px=np.asarray(LENS.focal_length_px) * 1.004, image_size_px=(512, 480)
            ),
            (0.0, 0.0),
        ),
        (
            "radial distortion",
            Intrinsics(
                focal_length_mm=16,
                pixel_pitch_mm=(0.0162, 0.0134),
                image_size_px=(512, 480),
                distortion=(0.1,),
            ),
            (0.0, 0.0),
        ),
    ],
)
def test_what_the_model_leaves_out_is_named(
    name: str, lens: Intrinsics, aim_mm: tuple[float, float]
) -> None:
    camera = camera_of((23.568, 38.616, -0.994, 472.894), lens, aim_mm)
    detection = simulated_detection(camera, SHEET, seed=1, sigma_px=0.002)
    result = calibrate_detections({"a": detection}, SHEET, LENS, systematics=EXACT)
    first = result.fits["a"].fixed_parameter_tests[0]
    assert first.name == name
    assert first.is_significant
    sentence = fixed_parameter_off(first)
    assert sentence in result.fits["a"].notes
    assert result.status["a"] is Status.SUSPECT
    assert result.summary().startswith(f"SUSPECT a: {sentence}")
    if name == "aim":
        np.testing.assert_allclose(first.estimate, aim_mm, atol=5 * first.sigma.max())


def test_unmoved_cameras_are_left_in_peace() -> None:
    comparison = compare_rigs(rig_of(0), rig_of(50))
    assert comparison.sentences == ("No camera moved.",)
    assert not any(change.moved for change in comparison.cameras.values())


def test_the_camera_that_moved_is_named() -> None:
    pan, tilt, swing, distance = TABLE_1["left"]
    cameras = TABLE_1 | {"left": (pan + 0.05, tilt, swing, distance)}
    later = calibrate_detections(detections_of(cameras, seed=9), SHEET, LENS, systematics=EXACT)
    comparison = compare_rigs(later, rig_of())
    assert [name for name, change in comparison.cameras.items() if change.moved] == ["left"]
    # 0.05 degrees of pan at 474 mm and a tilt of 38 degrees.
    expected = np.radians(0.05) * distance * np.cos(np.radians(tilt))
    assert comparison.cameras["left"].moved_mm == pytest.approx(expected, rel=0.05)
    assert comparison.cameras["left"].turned_deg == pytest.approx(0.05, rel=0.1)
    assert 'Camera "left" moved' in comparison.sentences[0]


def test_swapped_pictures_are_named() -> None:
    detections = detections_of(TABLE_1, seed=4)
    detections["left"], detections["right"] = detections["right"], detections["left"]
    comparison = compare_rigs(
        calibrate_detections(detections, SHEET, LENS, systematics=EXACT), rig_of()
    )
    assert set(comparison.swapped) == {("right", "left"), ("left", "right")}
    assert "swapped" in comparison.sentences[0]


def test_missing_and_new_cameras_are_told() -> None:
    full_rig = rig_of()
    one = calibrate_detections(
        {"x": detections_of(TABLE_1)["left"]}, SHEET, LENS, systematics=EXACT
    )
    sentences = " ".join(compare_rigs(one, full_rig).sentences)
    assert '"x" is not in the earlier rig' in sentences
    assert "upper, right, left of the earlier rig are missing" in sentences


def test_print_scale_moves_distances_in_proportion() -> None:
    result = rig_of()
    wide = with_systematics(result, Systematics(print_scale_sigma=(1e-3, 1e-3)))
    # Both scales of one size: each alone is weaker than both together, which is the distance.
    added = wide.sigma("upper.distance_mm") ** 2 - result.sigma("upper.distance_mm") ** 2
    assert 0.3 < np.sqrt(added) / (1e-3 * TABLE_1["upper"][3]) < 1.0
    k, m = (wide.parameters.index(f"{name}.distance_mm") for name in ("upper", "left"))
    correlation = wide.covariance[k, m] / np.sqrt(wide.covariance[k, k] * wide.covariance[m, m])
    assert correlation > 0.5
    assert "print scale" in wide.summary()
    np.testing.assert_array_equal(wide.values, result.values)


def test_the_response_to_print_scale_is_that_of_a_new_fit() -> None:
    share = 1e-4
    detection = simulated_detection(camera_of(TABLE_1["left"]), SHEET, seed=0, sigma_px=1e-3)
    printed = Pattern(
        name="printed",
        centres_mm=SHEET.centres_mm * np.array([1 + share, 1.0]),
        radius_mm=SHEET.radius_mm,
        inner_radius_mm=SHEET.inner_radius_mm,
        lattice=SHEET.lattice,
        line_width_mm=SHEET.line_width_mm,
        line_half_length_mm=SHEET.line_half_length_mm,
        line_style=SHEET.line_style,
        line_gap_mm=SHEET.line_gap_mm,
    )
    plain = calibrate_detections({"a": detection}, SHEET, LENS, systematics=EXACT)
    other = calibrate_detections({"a": detection}, printed, LENS, systematics=EXACT)
    systematic = with_systematics(plain, Systematics(print_scale_sigma=(share, 0.0)))
    added = np.sqrt(np.diag(systematic.covariance - plain.covariance))
    np.testing.assert_allclose(added, np.abs(other.values - plain.values), rtol=0.02, atol=1e-7)


def test_an_uncertain_focal_length_reaches_the_distance() -> None:
    result = rig_of()
    lens = np.diag([1.0, 1.0, 0.0, 0.0])
    wide = with_systematics(result, Systematics(lens_covariance=lens, flatness_mm=0.02))
    assert wide.sigma("upper.distance_mm") > 10 * result.sigma("upper.distance_mm")
    assert wide.systematics == ("flatness of the sheet (0.02 mm)", "the lens covariance")
    with pytest.raises(InputError, match="shape"):
        with_systematics(result, Systematics(lens_covariance=np.zeros((2, 3))))


def test_measured_bars_rescale_the_sheet() -> None:
    printed = printed_sheet(
        SHEET, nominal_mm=(100.0, 50.0), measured_mm=(101.0, 49.5), sigma_mm=0.1
    )
    np.testing.assert_allclose(printed.pattern.centres_mm, SHEET.centres_mm * [1.01, 0.99])
    assert printed.scale_sigma == pytest.approx((1e-3, 2e-3))
    with pytest.raises(InputError, match="unit"):
        printed_sheet(SHEET, nominal_mm=(100.0, 50.0), measured_mm=(10.0, 5.0))


def test_points_scatter_as_the_rig_says() -> None:
    trials, point = 25, np.array([20.0, -10.0, 15.0])
    covariance = point_covariance(rig_of().rig, point)
    truth = {name: camera_of(values) for name, values in TABLE_1.items()}
    pixels = np.stack([np.asarray(jax.jit(project)(camera, point)) for camera in truth.values()])
    points_mm = []
    for k in range(trials):
        rig = rig_of(1000 + 10 * k).rig
        rows = []
        for matrix, (u, v) in zip(rig.matrices_px, pixels, strict=True):
            rows += [u * matrix[2] - matrix[0], v * matrix[2] - matrix[1]]
        vector = np.linalg.svd(np.stack(rows))[2][-1]
        points_mm.append(vector[:3] / vector[3])
    ratio = np.std(points_mm, axis=0) / np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(ratio, 1.0, atol=0.45)


def test_epipolar_lines_are_known_to_a_fraction_of_a_pixel() -> None:
    field = epipolar_sigma(rig_of().rig, "upper", "left")
    assert field.sigma_px.shape == (25,)
    # The model with the aim held knows that both axes pass through the origin.
    assert field.sigma_px[12] < 1e-9
    corners = field.sigma_px[[0, 4, 20, 24]]
    assert ((corners > 1e-4) & (corners < 0.05)).all()


def test_a_rig_without_covariance_says_so() -> None:
    cameras = jax.tree.map(np.asarray, rig_of().rig.cameras)
    bare = type(rig_of().rig)(dict(zip(TABLE_1, cameras, strict=True)))
    with pytest.raises(InputError, match="covariance"):
        epipolar_sigma(bare, "upper", "left")
