"""Baseline and rotation of a pair of cameras have true sigmas, in any world frame."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.calib.made_shots import BOARD, LENSES, cam_from_rig, chained, inverse, shots
from trinoc.calib.result.camera_pairs import CameraPair, camera_pairs
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.geometry.rig import Rig

EXACT = Systematics()
LENS = Intrinsics(image_size_px=(640, 480), focal_length_px=800.0)


def numbers_of(pair: CameraPair) -> np.ndarray:
    return np.array([pair.baseline_mm, pair.angle_deg, *pair.turn_deg])


def sigmas_of(pair: CameraPair) -> np.ndarray:
    return np.array([pair.baseline_sigma_mm, pair.angle_sigma_deg, *pair.turn_sigma_deg])


def true_pair(first: str, second: str) -> np.ndarray:
    """True baseline and rotation of two simulated cameras, computed by matrices."""
    step = chained(cam_from_rig(second), inverse(cam_from_rig(first)))
    turn = Rotation.from_matrix(step[:, :3].T).as_rotvec(degrees=True)
    return np.array([np.linalg.norm(step[:, 3]), np.linalg.norm(turn), *turn])


@pytest.fixture(scope="module")
def calibration():
    return calibrate_rig(shots(), BOARD, systematics=EXACT)


def test_every_pair_is_there_and_the_first_camera_comes_first(calibration):
    names = [(pair.first, pair.second) for pair in calibration.pairs]
    assert names == [("left", "middle"), ("left", "right"), ("middle", "right")]


def test_pairs_are_what_was_made(calibration):
    for pair in calibration.pairs:
        error = numbers_of(pair) - true_pair(pair.first, pair.second)
        assert np.all(np.abs(error) < 4.5 * sigmas_of(pair))
        pose = Pose(pair.second_from_first)
        assert np.linalg.norm(pose.translation_mm) == pytest.approx(pair.baseline_mm, rel=1e-12)
        assert np.linalg.norm(pair.turn_deg) == pytest.approx(pair.angle_deg, rel=1e-12)


@pytest.mark.parametrize("world", ["shot 6", "middle"])
def test_the_world_does_not_matter(world, calibration):
    """The pairs are the same in the frame of another board and in that of a camera."""
    other = calibrate_rig(shots(), BOARD, systematics=EXACT, world=world)
    for pair, same in zip(calibration.pairs, other.pairs, strict=True):
        np.testing.assert_allclose(numbers_of(same), numbers_of(pair), rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(sigmas_of(same), sigmas_of(pair), rtol=2e-4)


def test_baselines_and_rotations_scatter_as_is_said():
    """Over draws of the noise, the sum of squared normalised errors is a chi-square."""
    squared = np.zeros(5)
    runs = 12
    for seed in range(runs):
        result = calibrate_rig(
            shots(seed=seed, count=6, cameras=("left", "right")),
            BOARD,
            distortion=4,
            systematics=EXACT,
        )
        (pair,) = result.pairs
        squared += ((numbers_of(pair) - true_pair("left", "right")) / sigmas_of(pair)) ** 2
    low, high = chi2(runs).ppf([1e-4, 1 - 1e-4])
    assert np.all((low < squared) & (squared < high))


@pytest.mark.parametrize("model", [PoseModel.AIM_FREE, PoseModel.RIGID])
def test_sigmas_are_those_of_cameras_drawn_from_the_covariance(model):
    """The sigmas equal the scatter of drawn cameras, even for angles beyond a quarter turn."""
    random = np.random.default_rng(3)
    cameras = {
        "a": Camera.from_degrees(LENS, pan_deg=-70, tilt_deg=40, swing_deg=5, distance_mm=500),
        "b": Camera.from_degrees(LENS, pan_deg=65, tilt_deg=35, swing_deg=-8, distance_mm=450),
    }
    parameters = tuple(
        f"{name}.{parameter}" for name in cameras for parameter in model.parameter_names
    )
    scale = np.tile([0.01, 0.01, 0.01, 0.1, 0.1, 0.1], 2)
    root = np.tril(random.uniform(-1, 1, (12, 12))) * scale[:, None]
    covariance = root @ root.T
    (pair,) = camera_pairs(Rig(cameras), parameters, covariance)
    assert pair.angle_deg > 90.0
    draws = random.normal(size=(20_000, 12)) @ root.T
    numbers = _drawn_pairs(cameras, model, draws)
    np.testing.assert_allclose(numbers.std(axis=0), sigmas_of(pair), rtol=0.03)


def _drawn_pairs(cameras: dict[str, Camera], model: PoseModel, draws: np.ndarray) -> np.ndarray:
    """(n, 5) baseline, angle and turn of the two cameras for n draws of their 12 parameters."""
    first, second = (
        _drawn_poses(camera, model, change)
        for camera, change in zip(cameras.values(), (draws[:, :6], draws[:, 6:]), strict=True)
    )
    turn = second[:, :, :3] @ np.swapaxes(first[:, :, :3], 1, 2)
    shift = second[:, :, 3] - np.einsum("nij,nj->ni", turn, first[:, :, 3])
    vector = Rotation.from_matrix(np.swapaxes(turn, 1, 2)).as_rotvec(degrees=True)
    length, angle = (np.linalg.norm(each, axis=1) for each in (shift, vector))
    return np.column_stack([length, angle, vector])


def _drawn_poses(camera: Camera, model: PoseModel, change: np.ndarray) -> np.ndarray:
    """(n, 3, 4) camera from world for n changes of the pose's six parameters."""
    pose = np.asarray(camera.cam_from_world)
    if model is PoseModel.RIGID:
        turn = Rotation.from_rotvec(change[:, :3], degrees=True).as_matrix() @ pose[:, :3]
        centre = change[:, 3:] - pose[:, :3].T @ pose[:, 3]
        return np.concatenate([turn, -(turn @ centre[..., None])], axis=2)
    values = [camera.pan_deg, camera.tilt_deg, camera.swing_deg, camera.distance_mm]
    moved = np.array([*values, *camera.aim_mm]) + change
    radians = np.concatenate([np.radians(moved[:, :3]), moved[:, 3:]], axis=1)
    return np.asarray(jax.vmap(lambda one: Pose.from_parameters(one).cam_from_world)(radians))


def test_a_board_of_uncertain_size_moves_baselines_by_its_share_and_turns_by_nothing():
    share = 2e-3
    detections = shots(cameras=("left", "right"))
    (exact,) = calibrate_rig(detections, BOARD, systematics=EXACT).pairs
    (sized,) = calibrate_rig(
        detections, BOARD, systematics=Systematics(print_size_sigma=share)
    ).pairs
    assert exact.size_sigma_mm == 0.0
    assert exact.rest_sigma_mm == exact.baseline_sigma_mm
    assert sized.size_sigma_mm == pytest.approx(share * sized.baseline_mm, rel=1e-2)
    assert sized.rest_sigma_mm == pytest.approx(exact.rest_sigma_mm, rel=2e-2)
    total_sigma = np.hypot(sized.size_sigma_mm, sized.rest_sigma_mm)
    assert sized.baseline_sigma_mm == pytest.approx(total_sigma, rel=1e-9)
    np.testing.assert_allclose(sized.turn_sigma_deg, exact.turn_sigma_deg, rtol=1e-2)


def test_cameras_that_share_their_error_have_no_error_between_them():
    """Both cameras turn and move as one rigid body, so that their relative pose is constant."""
    cameras = {
        "a": Camera.from_degrees(LENS, pan_deg=-20, tilt_deg=40, swing_deg=5, distance_mm=500),
        "b": Camera.from_degrees(LENS, pan_deg=30, tilt_deg=35, swing_deg=-8, distance_mm=450),
    }
    parameters = tuple(
        f"{name}.{parameter}" for name in cameras for parameter in PoseModel.RIGID.parameter_names
    )
    about = np.array([0.01, -0.02, 0.015])
    response = np.concatenate(
        [
            [*(camera.pose.rotation @ about), *np.cross(np.radians(about), camera.centre_world_mm)]
            for camera in cameras.values()
        ]
    )
    # A turn of the world about `about` turns a camera the other way about its own axes.
    response[[0, 1, 2, 6, 7, 8]] *= -1.0
    (pair,) = camera_pairs(Rig(cameras), parameters, np.outer(response, response))
    assert np.all(sigmas_of(pair) < 1e-6)


def test_a_failed_fit_has_no_pairs(calibration):
    assert LENSES.keys() == set(calibration.cameras)
    result = calibrate_rig(
        {name: detections[:1] for name, detections in shots().items()},
        BOARD,
        systematics=EXACT,
        throw=False,
    )
    assert not result.has_rig
    assert result.pairs == ()
