import jax
import numpy as np
import pytest
from hypothesis import given

from tests.geometry.strategies import LENS, points_near_sheet, rigs_of_three
from trinoc.geometry import (
    camera,
    line_through,
    plane_of_line,
    triangulation,
)
from trinoc.geometry.camera import Camera
from trinoc.geometry.lines import line_of_planes
from trinoc.geometry.segments import covariance_of_ends

project = jax.jit(camera.project)
triangulate_point = jax.jit(triangulation.triangulate_point)
triangulate_segment = jax.jit(triangulation.triangulate_segment)


def images(rig, ends):
    return np.stack([[project(camera, end) for end in ends] for camera in rig])


def matrices(rig):
    return np.stack([camera.matrix_px for camera in rig])


@given(rigs_of_three(), points_near_sheet())
def test_a_point_comes_back_from_its_images(rig, point):
    uv = np.stack([project(camera, point) for camera in rig])
    np.testing.assert_allclose(triangulate_point(matrices(rig), uv, np.ones(3)), point, atol=1e-6)


@given(rigs_of_three(), points_near_sheet(), points_near_sheet())
def test_a_segment_comes_back_from_two_or_three_views(rig, first, second):
    if np.linalg.norm(second - first) < 5:
        return
    fragments = images(rig, (first, second))
    if np.linalg.norm(np.diff(fragments, axis=1), axis=-1).min() < 3:
        return  # seen end on
    covariance = np.stack([covariance_of_ends(f[None], 0.3, 0.3)[0] for f in fragments])
    for is_visible in ([True] * 3, [True, False, True], [False, True, True]):
        visible_fragments = np.where(np.array(is_visible)[:, None, None], fragments, np.nan)
        answer = triangulate_segment(
            matrices(rig), visible_fragments, covariance, np.array(is_visible)
        )
        np.testing.assert_allclose(answer.ends_mm, (first, second), atol=1e-5)
        assert abs(answer.chi_square) < 1e-8
        eigenvalues = np.linalg.eigvalsh(answer.covariance_mm2)
        assert (eigenvalues > 0).all()


def test_the_order_of_views_does_not_matter():
    rig, fragments, covariance = noisy_example(3)
    order = np.array([2, 0, 1])
    is_visible = np.ones(3, bool)
    one = triangulate_segment(matrices(rig), fragments, covariance, is_visible)
    two = triangulate_segment(matrices(rig)[order], fragments[order], covariance[order], is_visible)
    np.testing.assert_allclose(one.ends_mm, two.ends_mm, atol=1e-9)
    np.testing.assert_allclose(one.covariance_mm2, two.covariance_mm2, rtol=1e-9)


def noisy_example(seed):
    random = np.random.default_rng(seed)
    rig = [
        Camera.from_degrees(LENS, pan_deg=p, tilt_deg=t, swing_deg=0, distance_mm=472)
        for p, t in ((2, 53), (-23, 38), (23, 38))
    ]
    ends = np.array([[10.0, -20.0, 5.0], [30.0, 25.0, 30.0]])
    truth = images(rig, ends)
    covariance = np.stack([covariance_of_ends(f[None], 0.3, 1.5)[0] for f in truth])
    noise = np.stack([random.multivariate_normal(np.zeros(4), c) for c in covariance])
    return rig, truth + noise.reshape(-1, 2, 2), covariance


def test_the_covariance_is_that_of_many_noisy_segments():
    """Squared normalised errors of 2,000 triangulations follow chi-square with 6 degrees."""
    rig, _, covariance = noisy_example(0)
    ends = np.array([[10.0, -20.0, 5.0], [30.0, 25.0, 30.0]])
    truth = images(rig, ends)
    random = np.random.default_rng(1)
    factor = np.linalg.cholesky(covariance)
    noise = np.einsum("vij,nvj->nvi", factor, random.standard_normal((2000, 3, 4)))
    solve = jax.vmap(triangulate_segment, (None, 0, None, None))
    answer = solve(matrices(rig), truth + noise.reshape(-1, 3, 2, 2), covariance, np.ones(3, bool))
    error = (np.asarray(answer.ends_mm) - ends).reshape(-1, 6)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(answer.covariance_mm2), error)
    assert squared.mean() == pytest.approx(6, abs=4 * np.sqrt(12 / 2000))
    assert (squared < 12.592).mean() == pytest.approx(0.95, abs=0.02)  # 95 % of chi-square(6)
    assert np.mean(answer.chi_square) == pytest.approx(6, abs=0.4)  # 12 observations, 6 unknowns


def test_views_that_see_nothing_do_not_speak():
    rig, fragments, covariance = noisy_example(5)
    is_visible = np.array([True, False, True])
    fragments_nan = fragments.copy()
    fragments_nan[1] = np.nan
    covariance_nan = covariance.copy()
    covariance_nan[1] = np.nan
    one = triangulate_segment(matrices(rig), fragments, covariance, is_visible)
    two = triangulate_segment(matrices(rig), fragments_nan, covariance_nan, is_visible)
    np.testing.assert_array_equal(one.ends_mm, two.ends_mm)


@given(rigs_of_three(), points_near_sheet(), points_near_sheet())
def test_two_planes_meet_in_the_line(rig, first, second):
    a, b, _ = rig
    if np.linalg.norm(second - first) < 5:
        return
    planes = [
        plane_of_line(c.matrix_px, line_through(project(c, first), project(c, second)))
        for c in (a, b)
    ]
    planes = [np.asarray(plane) / np.linalg.norm(plane[:3]) for plane in planes]
    if np.linalg.norm(np.cross(planes[0][:3], planes[1][:3])) < 0.02:
        return
    point, direction = line_of_planes(*planes)
    assert abs(np.asarray(point) @ np.asarray(direction)) < 1e-6
    for end in (first, second):
        across = np.cross(end - point, direction)
        np.testing.assert_allclose(across, 0, atol=1e-4)
