"""Rays beside an axis: those of an outline touch the cylinder, and derivatives are right."""

import numpy as np
import pytest

from tests.match.cylinders.made_outlines import Placed
from tests.match.made import rig_of
from trinoc.match.bodies.outlines import Rays, abreast_mm, before_camera, ray_axis_distances
from trinoc.numerics.vectors import complete_axes

TILTED = Placed(9.0, 40.0, turn=(0.3, -0.7, 0.2), shift_mm=(12.0, -8.0, 15.0))


def rays_to(centre_mm: np.ndarray, ends_mm: np.ndarray, slope: np.ndarray | None = None) -> Rays:
    away = ends_mm - centre_mm
    slope = np.zeros_like(away) if slope is None else slope
    return Rays(np.broadcast_to(centre_mm, away[:, 0].shape), away, slope)


@pytest.mark.parametrize("name", ["upper", "left", "low"])
def test_rays_of_outlines_touch_the_cylinder_on_either_side(name) -> None:
    centre = np.asarray(rig_of(name)[name].centre_world_mm)
    lines = TILTED.outlines_mm(centre)
    first, second = TILTED.axis_mm
    way = (second - first) / 40.0
    rays = rays_to(centre, lines)
    distance = ray_axis_distances(rays, first[None], way[None]).distance_mm
    np.testing.assert_allclose(np.sort(distance, axis=0), [[-9.0, -9.0], [9.0, 9.0]], atol=1e-9)
    along = abreast_mm(rays, first[None], way[None])
    np.testing.assert_allclose(along, [[0.0, 40.0]] * 2, atol=1e-9)
    assert before_camera(rays, first[None]).all()
    assert not before_camera(rays, (2 * centre - first)[None]).any()


def test_derivatives_are_those_of_differences() -> None:
    rng = np.random.default_rng(3)
    centre, point = np.array([100.0, -300.0, 250.0]), np.array([5.0, -3.0, 8.0])
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    ends, slope = rng.normal(size=(1, 2, 3)) * 40.0, rng.normal(size=(1, 2, 3))
    across = complete_axes(way)
    found = ray_axis_distances(rays_to(centre, ends, slope), point[None], way[None])
    step = 1e-5

    still = np.zeros(3)

    def change(d_point=still, d_way=still, d_ray=still):
        values = []
        for sign in (1.0, -1.0):
            turned = way + sign * step * d_way
            rays = rays_to(centre, ends + sign * step * d_ray)
            moved = point + sign * step * d_point
            values.append(
                ray_axis_distances(rays, moved[None], turned[None] / np.linalg.norm(turned))
            )
        return (values[0].distance_mm - values[1].distance_mm) / (2 * step)

    for k in (0, 1):
        offset, tilt = change(d_point=across[k]), change(d_way=across[k])
        np.testing.assert_allclose(found.by_axis[..., k], offset, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(found.by_axis[..., 2 + k], tilt, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.per_px, change(d_ray=slope), rtol=1e-6, atol=1e-7)
