"""A lens defined by one file and one line of the registry works in the fits and the files."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

from tests.calib.simulated import EXACT, TABLE_1, camera_of, reference_sheet, simulated_detection
from trinoc.calib import calibrate_detections
from trinoc.calib.from_points import calibrate_points
from trinoc.geometry import AbstractLens
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.lenses.registry import LENS_MODELS
from trinoc.io import load_intrinsics
from trinoc.io.intrinsics_json import save_intrinsics
from trinoc.numerics.precision import ArrayLike


class Equidistant(AbstractLens):
    """Fisheye whose distance in the image is the angle from the axis times 1 + k1 angle^2."""

    model: ClassVar[str] = "equidistant"
    coefficient_names: ClassVar[tuple[str, ...]] = ("k1",)
    parameter_names: ClassVar[tuple[str, ...]] = (*AFFINE_PARAMETERS, *coefficient_names)
    coefficient_powers: ClassVar[tuple[int, ...]] = (2,)
    coefficient_counts: ClassVar[tuple[int, ...]] = (0, 1)
    dispensable: ClassVar[tuple[str, ...]] = ()

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """The angle along the direction of (x, y)."""
        across = jnp.sqrt(ray_cam[0] ** 2 + ray_cam[1] ** 2 + 1e-30)
        angle = jnp.arctan2(across, ray_cam[2])
        return angle * (1 + self.coefficients[0] * angle**2) / across * ray_cam[:2]

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """By Newton's method for the angle."""
        radius = jnp.sqrt(distorted @ distorted + 1e-30)
        angle, k1 = radius, self.coefficients[0]
        for _ in range(8):
            angle = angle - (angle * (1 + k1 * angle**2) - radius) / (1 + 3 * k1 * angle**2)
        across = jnp.sin(angle) / radius * distorted
        return jnp.stack([across[0], across[1], jnp.cos(angle)])


@pytest.fixture
def lens(monkeypatch: pytest.MonkeyPatch) -> Intrinsics:
    monkeypatch.setitem(LENS_MODELS, Equidistant.model, Equidistant)
    return Intrinsics(
        focal_length_mm=16,
        pixel_pitch_mm=(0.0162, 0.0134),
        image_size_px=(512, 480),
        distortion=[0.05],
        distortion_model="equidistant",
    )


def test_it_sees_beyond_ninety_degrees(lens: Intrinsics) -> None:
    ray = np.array([1.0, 0.5, -0.3])
    uv_px = lens.lens.project_ray(ray)
    np.testing.assert_allclose(lens.lens.unproject(uv_px), ray / np.linalg.norm(ray), atol=1e-12)


def test_it_survives_a_file(lens: Intrinsics, tmp_path) -> None:
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0])
    save_intrinsics(lens, tmp_path / "camera.json", covariance=covariance)
    loaded = load_intrinsics(tmp_path / "camera.json")
    assert isinstance(loaded.lens, Equidistant)
    np.testing.assert_allclose(loaded.lens.parameters, lens.lens.parameters, rtol=1e-15)


@pytest.mark.slow
def test_a_camera_behind_it_is_found_from_circles(lens: Intrinsics) -> None:
    values = TABLE_1["right"]
    detection = simulated_detection(camera_of(values, lens), reference_sheet(), seed=1)
    result = calibrate_detections({"right": detection}, reference_sheet(), lens, systematics=EXACT)
    sigma = np.sqrt(np.diag(result.covariance))
    assert (np.abs(result.values - values) < 5 * sigma).all()


def test_its_coefficient_is_found_from_points(lens: Intrinsics) -> None:
    random = np.random.default_rng(0)
    points, camera = random.uniform(-60, 60, (60, 3)), camera_of(TABLE_1["left"], lens)
    uv_px = np.array([camera.project(point) for point in points])
    noisy = uv_px + random.normal(0, 0.02, uv_px.shape)
    result = calibrate_points(points, noisy, lens, free=("k1",))
    error = result.camera.intrinsics.distortion[0] - 0.05
    assert abs(error) < 5 * result.sigma("k1")
