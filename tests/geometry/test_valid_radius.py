"""A lens that folds inside its image is one to one up to a radius and NaN beyond it."""

import jax
import numpy as np
import pytest

from trinoc.geometry import (
    distort_pixels,
    project,
    project_points,
    sheet_from_pixel,
    undistort_pixels,
)
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import (
    Intrinsics,
    describe_fold,
    describe_unusable_fold,
    describe_usable_fold,
    share_beyond_fold,
)
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import BrownConrady, Rational, ThinPrism
from trinoc.geometry.lenses.splined import SPLINED, SplinedKannalaBrandt, SplinedRational
from trinoc.geometry.pose import Pose

SIZE_PX = (1280, 720)
RADIAL = [0.3, 0.2, 0.003, 0.003, 0.1]
# Standard deviation of each coefficient of random lenses.
SPREADS = {
    BrownConrady: RADIAL,
    Rational: [*RADIAL, 0.3, 0.2, 0.1],
    ThinPrism: [*RADIAL, 0.3, 0.2, 0.1, 0.003, 0.003, 0.003, 0.003],
    KannalaBrandt: [0.2, 0.1, 0.05, 0.02],
}
# A real one, whose tangential distortion moves the fold on one side.
TANGENTIAL = Intrinsics(
    image_size_px=SIZE_PX,
    focal_length_px=(898.33, 893.86),
    principal_point_px=(609.6, 339.5),
    distortion=(-0.25406, 0.0, -0.00135, 0.01405, 0.0),
)
SPLINED_MODELS = (SplinedRational, SplinedKannalaBrandt)


def folding_lenses(model: type, count: int, seed: int = 0) -> list[Intrinsics]:
    """Random lenses of a model whose fold lies inside the image."""
    random, lenses = np.random.default_rng(seed), []
    while len(lenses) < count:
        core = model if model in SPREADS else model.core_model
        focal_px = random.uniform(400, 1400) * np.array([1.0, random.uniform(0.9, 1.1)])
        values = [*focal_px, 630.0, 370.0, *random.normal(0, SPREADS[core])]
        lens = core.from_parameters(np.array(values))
        if core is not model:
            lens = SPLINED[core].of_core(lens, SIZE_PX)
            moved = np.array(lens.parameters)
            moved[-lens.control_count :] = random.normal(0, 2.0, lens.control_count)
            lens = lens.with_parameters(moved)
        intrinsics = Intrinsics.of_lens(lens, SIZE_PX)
        if 0.0 < intrinsics.valid_radius_px < 700.0:
            lenses.append(intrinsics)
    return lenses


def pixels_about(lens: Intrinsics, share: tuple[float, float], seed: int = 0) -> np.ndarray:
    """Pixels in a ring about the principal point between these shares of the valid radius."""
    random = np.random.default_rng(seed)
    angle = random.uniform(0, 2 * np.pi, 200)
    radius = lens.valid_radius_px * np.sqrt(random.uniform(share[0] ** 2, share[1] ** 2, 200))
    radius[:50] = lens.valid_radius_px * share[1]
    offset = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(lens.principal_point_px) + offset


@pytest.mark.parametrize("model", [*SPREADS, *SPLINED_MODELS], ids=lambda model: model.model)
def test_inside_the_radius_every_pixel_has_its_ray_and_beyond_none(model):
    """The test includes pixels exactly at the radius."""
    # The angle from the axis is no place of an ideal picture beyond 90 degrees.
    for lens in folding_lenses(model, 40):
        if lens.lens.fold_angle_rad() >= np.pi / 2:
            continue
        uv_px = pixels_about(lens, (0.0, 1.0))
        flat = undistort_pixels(lens, uv_px)
        np.testing.assert_allclose(distort_pixels(lens, flat), uv_px, atol=1e-6, rtol=0)
        assert np.isnan(undistort_pixels(lens, pixels_about(lens, (1.001, 3.0)))).all()
        ray = np.linalg.inv(lens.matrix) @ np.vstack([flat.T, np.ones(len(flat))])
        angle = np.arctan(np.hypot(ray[0], ray[1]))
        assert (angle < lens.lens.fold_angle_rad()).all()


@pytest.mark.parametrize("lens", [*folding_lenses(BrownConrady, 3), TANGENTIAL])
def test_beyond_the_fold_every_projection_is_nan_and_inside_it_is_unchanged(lens):
    camera = Camera(lens, Pose(np.column_stack([np.diag([1.0, -1.0, -1.0]), [1.0, 2.0, 500.0]])))
    fold = np.tan(lens.lens.fold_angle_rad())
    azimuth = np.linspace(0, 6, 30)
    directions = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    edge = undistort_pixels(lens, pixels_about(lens, (1.0, 1.0)))
    edge_tangent = np.hypot(*((edge - lens.principal_point_px) / lens.focal_length_px).T).min()
    traced = jax.jit(jax.vmap(project, in_axes=(None, 0)))
    for tangent, is_imaged in (
        (0.5 * edge_tangent, True),
        (0.99 * edge_tangent, True),
        (1.01 * fold, False),
    ):
        in_camera = 500.0 * np.pad(tangent * directions, ((0, 0), (0, 1)), constant_values=1.0)
        points = (in_camera - camera.cam_from_world[:, 3]) @ camera.cam_from_world[:, :3]
        for uv_px in (
            project_points(camera.pose, lens.lens, points),
            np.stack([camera.project(point) for point in points]),
            np.asarray(jax.vmap(lambda point: project(camera, point))(points)),
        ):
            assert np.isfinite(uv_px).all(axis=1).tolist() == [is_imaged] * 30
            if is_imaged:
                np.testing.assert_allclose(uv_px, traced(camera, points), rtol=1e-12)
        normalised = tangent * directions[0]
        assert np.isfinite(lens.pixel_from_normalised(normalised)).all() == is_imaged
        ideal_px = lens.matrix[:2, :2] @ normalised + lens.matrix[:2, 2]
        assert np.isfinite(lens.distort_pixel(ideal_px)).all() == is_imaged


def test_beyond_the_radius_a_pixel_has_no_ray_and_no_place_on_the_sheet():
    camera = Camera(TANGENTIAL, Pose(np.column_stack([np.diag([1.0, -1, -1]), [0.0, 0.0, 500.0]])))
    for share, is_imaged in ((0.99, True), (1.01, False)):
        for uv_px in pixels_about(TANGENTIAL, (share, share))[:5]:
            for value in (
                sheet_from_pixel(camera, uv_px),
                TANGENTIAL.normalised_from_pixel(uv_px),
                TANGENTIAL.undistort_pixel(uv_px),
            ):
                assert np.isfinite(np.asarray(value)).all() == is_imaged


def test_derivatives_inside_are_those_without_a_fold():
    """NaN beyond the fold does not turn the derivatives inside it into NaN."""
    camera = Camera(TANGENTIAL, Pose(np.column_stack([np.eye(3), [0.0, 0.0, 500.0]])))
    point = np.array([20.0, -30.0, 0.0])
    by_point = jax.jacfwd(lambda p: project(camera, p))(point)
    expected = jax.jit(jax.jacfwd(project, argnums=1))(camera, point)
    np.testing.assert_allclose(by_point, expected, rtol=1e-12)


@pytest.mark.parametrize("model", [BrownConrady, Rational, KannalaBrandt], ids=lambda m: m.model)
def test_a_lens_without_a_fold_has_no_limit(model):
    zeros = np.zeros(len(model.coefficient_names))
    lens = Intrinsics.of_lens(
        model.from_parameters(np.array([800.0, 800.0, 639.5, 359.5, *zeros])), SIZE_PX
    )
    assert lens.valid_radius_px == np.inf
    assert share_beyond_fold(lens) == 0.0
    assert describe_fold(lens) is None


def test_a_correction_that_folds_leaves_no_pixel():
    core = folding_lenses(BrownConrady, 1)[0].lens
    steep = SPLINED[BrownConrady].of_core(core, SIZE_PX)
    values = np.array(steep.parameters)
    values[-steep.control_count :: 2] = 500.0
    lens = Intrinsics.of_lens(steep.with_parameters(values), SIZE_PX)
    assert lens.valid_radius_px == 0.0
    assert "neighbouring control points" in str(describe_unusable_fold(lens))


def test_a_fold_in_the_corners_leaves_a_usable_lens():
    assert describe_unusable_fold(TANGENTIAL) is None
    sentence = describe_usable_fold(TANGENTIAL)
    assert sentence == (
        "folds the image 633 px from the principal point (two rays have one pixel there, and the "
        "farthest corner is 769 px away); lines and points beyond this radius, in 7.6 % of the "
        "image, are not used"
    )


@pytest.mark.parametrize(
    ("k1", "is_usable"),
    [(-0.05, True), (-0.18, True), (-0.25, True), (-0.28, False), (-2.0, False)],
)
def test_a_fold_that_takes_more_than_a_third_of_the_image_makes_a_lens_unusable(k1, is_usable):
    lens = Intrinsics(image_size_px=(640, 480), focal_length_px=350.0, distortion=(k1,))
    assert (describe_unusable_fold(lens) is None) == is_usable
    assert is_usable == (share_beyond_fold(lens) <= 1 / 3)


def test_a_fold_within_half_the_shorter_side_makes_a_lens_unusable():
    """The fold then removes 21 % of the area of a square image."""
    for k1, is_usable in ((-0.195, True), (-0.21, False)):
        lens = Intrinsics(image_size_px=(590, 590), focal_length_px=350.0, distortion=(k1,))
        assert (lens.valid_radius_px > 295.0) == is_usable
        assert share_beyond_fold(lens) < 1 / 3
        assert (describe_unusable_fold(lens) is None) == is_usable
