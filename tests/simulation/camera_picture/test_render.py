"""The whole chain of rendering, compared with the other ray caster and for all conditions."""

import jax
import numpy as np
import pytest

from benchmarks.picture_conditions import CONDITIONS, Case, LensError
from simulation.camera_picture.optics import Optics, irradiance
from simulation.camera_picture.paper import Paper
from simulation.camera_picture.render import camera_picture, delivered_picture
from simulation.camera_picture.scene import SheetScene, radiance
from simulation.camera_picture.surfaces import RolledPaper
from tests.simulation.camera_picture.views import SHEET, SMALL_LENS, camera_of
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry import project
from trinoc.geometry.intrinsics import Intrinsics

POSE = (25.0, 40.0, 3.0, 300.0)
ENDLESS = (1e4, 1e4)


def test_a_circle_on_bent_paper_lies_where_its_points_project():
    surface = RolledPaper.from_sagitta(6.0, direction_deg=35.0)
    disc = Pattern.cross_grid(
        rows=1, columns=1, pitch_mm=40.0, radius_mm=20.0, line_width_mm=0.0, rings="none"
    )
    camera = camera_of()
    paper = Paper(surface, paper=0.9, ink=0.1, size_mm=ENDLESS)
    light = irradiance(radiance(disc, camera, SheetScene(paper)), Optics())
    share = (0.9 - light) / 0.8
    # The moments of the disc's image, from a fine polar grid of its points.
    r, angle = np.meshgrid((np.arange(80) + 0.5) / 4, np.arange(160) * np.pi / 80)
    points_mm = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1).reshape(-1, 2)

    def image(point_mm):
        return project(camera, surface.point_world_mm(point_mm))

    pixels = np.asarray(jax.jit(jax.vmap(image))(points_mm))
    jacobians = np.asarray(jax.jit(jax.vmap(jax.jacfwd(image)))(points_mm))
    area = np.abs(np.linalg.det(jacobians)) * r.reshape(-1)
    rows, columns = np.indices(share.shape)
    centroid_px = np.array([(share * columns).sum(), (share * rows).sum()]) / share.sum()
    np.testing.assert_allclose(centroid_px, (area[:, None] * pixels).sum(0) / area.sum(), atol=2e-4)
    step = 0.25 * np.pi / 80
    assert share.sum() == pytest.approx(area.sum() * step, rel=1e-4)


@pytest.mark.parametrize("name", CONDITIONS)
def test_every_condition_delivers_a_picture(name):
    condition = CONDITIONS[name]
    field = np.full((40, 48), 0.85)
    field[10:30, 15:30] = 0.09
    picture = delivered_picture(field, condition.sensor, condition.processing, seed=1)
    grey = condition.sensor.mosaic is None or condition.processing.interpolation is None
    assert picture.shape == ((40, 48) if grey else (40, 48, 3))
    assert picture.dtype == (np.uint8 if condition.processing.bits == 8 else np.uint16)
    assert picture[15:25, 20:25].mean() < 0.6 * picture[:5].mean()


def test_a_picture_repeats_by_seed_alone():
    condition = CONDITIONS["phone"]
    camera = condition.camera(SMALL_LENS, POSE)
    first, repeated, other = (camera_picture(SHEET, camera, condition, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, repeated)
    assert not np.array_equal(first, other)


def test_a_condition_s_camera_stands_where_the_condition_says():
    condition = Case(aim_mm=(0.3, -0.2), distance_scale=1.5, turn_deg=180.0)
    camera = condition.camera(SMALL_LENS, POSE)
    assert camera.aim_mm == pytest.approx((0.3, -0.2))
    assert camera.distance_mm == pytest.approx(450.0)
    assert camera.swing_deg == pytest.approx(-177.0)


def test_a_lens_is_off_by_what_is_said():
    nominal = Intrinsics(focal_length_px=(200.0, 250.0), image_size_px=(96, 90), distortion=(-0.2,))
    error = LensError(focal_length=0.01, aspect=0.002, principal_point_px=(3.0, -4.0))
    true = error.of(nominal)
    np.testing.assert_allclose(true.focal_length_px, [202.0, 250.0 * 1.01 * 1.002])
    moved = np.asarray(true.principal_point_px) - np.asarray(nominal.principal_point_px)
    np.testing.assert_allclose(moved, [3.0, -4.0])
    np.testing.assert_array_equal(true.distortion, nominal.distortion)
