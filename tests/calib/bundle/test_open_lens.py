"""A calibration whose lens is uncertain: segments refine pose and lens together."""

import numpy as np
import pytest

from tests.calib.bundle.made_tracks import ANGLES_AND_DISTANCES, made_tracks
from tests.calib.simulated import LENS, camera_of, reference_sheet, simulated_detection
from trinoc.calib import CalibrationResult, calibrate_detections
from trinoc.calib.bundle.refinement import refine
from trinoc.calib.rig_check.knocked import check_rig
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.rig import PARAMETER_NAMES, Rig

SHEET = reference_sheet()


def data_sheet_calibration(seed: int, *, exact: tuple[str, ...] = ()) -> CalibrationResult:
    """Calibration of Table 1's rig with lenses known by their data sheet only."""
    detections = {
        name: simulated_detection(camera_of(values), SHEET, seed=10 * seed + k, sigma_px=0.02)
        for k, (name, values) in enumerate(ANGLES_AND_DISTANCES.items())
    }
    # One in pixels comes from a calibration.
    in_pixels = Intrinsics.from_matrix(LENS.matrix, LENS.image_size_px)
    lens = {name: in_pixels if name in exact else LENS for name in detections}
    return calibrate_detections(detections, SHEET, lens)


def values_of(camera: Camera) -> np.ndarray:
    lens = camera.intrinsics
    pose = [getattr(camera, name) for name in PARAMETER_NAMES[:4]]
    return np.array([*pose, *camera.aim_mm, *lens.focal_length_px, *lens.principal_point_px])


def errors(rig: Rig) -> np.ndarray:
    return np.concatenate(
        [values_of(rig[name]) - values_of(camera_of(ANGLES_AND_DISTANCES[name])) for name in rig]
    )


@pytest.mark.slow
def test_segments_join_what_the_sheet_says_of_pose_and_lens() -> None:
    squared, gain = [], []
    for seed in range(5):
        sheet = data_sheet_calibration(seed)
        refined = refine(sheet, made_tracks(seed, 60)[0])
        names = [f"{name}.{key}" for name in sheet.rig for key in PARAMETER_NAMES]
        assert set(refined.parameters) == set(sheet.rig.parameters) > set(names)
        assert set(refined.rig.parameters) == set(sheet.rig.parameters)
        error = errors(refined.rig)
        squared.append(error @ np.linalg.solve(refined.covariance, error) / len(error))
        gain.append(refined.rig.sigma("upper.fx_px") / sheet.rig.sigma("upper.fx_px"))
    # The sheet is flatter and better printed than it claims, which makes errors smaller.
    assert 0.4 < np.mean(squared) < 1 + 4 * np.sqrt(2 / (30 * 5))
    assert max(gain) < 1


@pytest.mark.slow
def test_a_lens_that_is_exact_stays_while_others_are_open() -> None:
    sheet = data_sheet_calibration(7, exact=("upper",))
    refined = refine(sheet, made_tracks(7, 60)[0])
    np.testing.assert_allclose(
        refined.rig["upper"].intrinsics.matrix, sheet.rig["upper"].intrinsics.matrix, atol=1e-2
    )
    assert 0 < refined.rig.sigma("upper.fx_px") < 2e-3
    with_lens_fixed = refine(sheet, made_tracks(7, 60)[0], free_lens=False)
    assert not any(name.endswith(AFFINE_PARAMETERS) for name in with_lens_fixed.parameters)


@pytest.mark.slow
def test_an_open_lens_hides_no_knock_and_makes_none_up() -> None:
    sheet, lines = data_sheet_calibration(9).rig, made_tracks(9, 100)[0]
    assert check_rig(sheet, lines).moved == ()
    turned = camera_of((*np.add(ANGLES_AND_DISTANCES["left"][:3], 0.5), 474.471))
    before = {**dict(sheet.items()), "left": Camera(sheet["left"].intrinsics, turned.pose)}
    knocked = Rig(before, parameters=sheet.parameters, covariance=sheet.covariance)
    check = check_rig(knocked, lines)
    assert check.moved == ("left",)
    assert check.motions[0].parameters == PARAMETER_NAMES
