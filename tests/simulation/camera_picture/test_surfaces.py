"""Paper bends and does not stretch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from simulation.camera_picture.surfaces import ConePaper, RolledPaper, TwistedPaper

BENDS = {
    "cylinder": RolledPaper.from_sagitta(1.0, direction_deg=30.0),
    "deep cylinder": RolledPaper.from_sagitta(-12.0, direction_deg=110.0),
    "cone": ConePaper.from_sagitta(1.0, apex_mm=200.0, direction_deg=-40.0),
    "deep cone": ConePaper.from_sagitta(-9.0, apex_mm=150.0, direction_deg=75.0),
}
PLACES = np.random.default_rng(0).uniform(-90.0, 90.0, (40, 2))


@pytest.mark.parametrize("surface", BENDS.values(), ids=BENDS.keys())
def test_the_metric_of_bent_paper_is_that_of_flat_paper(surface):
    # Step by step: XLA without its optimisations, as tests have it, gets the deep cone wrong.
    jacobians = jax.vmap(jax.jacfwd(surface.point_world_mm))(PLACES)
    metrics = np.einsum("nki,nkj->nij", jacobians, jacobians)
    np.testing.assert_allclose(metrics, np.broadcast_to(np.eye(2), metrics.shape), atol=1e-12)


@pytest.mark.parametrize("surface", BENDS.values(), ids=BENDS.keys())
def test_a_curve_on_the_paper_keeps_its_length(surface):
    # A circle of 60 mm, whose points lie anywhere to the bend.
    def point(angle):
        return surface.point_world_mm(60.0 * jnp.stack([jnp.cos(angle), jnp.sin(angle)]))

    speed = jax.jit(lambda angle: jnp.linalg.norm(jax.jacfwd(point)(angle)))
    length, _ = quad(lambda angle: float(speed(angle)), 0.0, 2 * np.pi, epsabs=1e-10)
    assert length == pytest.approx(2 * np.pi * 60.0, rel=1e-9)


@pytest.mark.parametrize("surface", BENDS.values(), ids=BENDS.keys())
def test_the_sheet_touches_its_plane_at_the_origin(surface):
    zero = np.zeros(2)
    np.testing.assert_allclose(surface.point_world_mm(zero), np.zeros(3), atol=1e-12)
    expected = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    np.testing.assert_allclose(jax.jacfwd(surface.point_world_mm)(zero), expected, atol=1e-12)


@pytest.mark.parametrize("make", [RolledPaper.from_sagitta, ConePaper.from_sagitta])
@pytest.mark.parametrize("sagitta_mm", [-3.0, 0.0, 0.1, 5.0])
def test_the_rise_at_the_reach_is_the_sagitta(make, sagitta_mm):
    surface = make(sagitta_mm, direction_deg=50.0, reach_mm=80.0)
    along = np.radians(50.0)
    for sign in (-1.0, 1.0):
        point_mm = sign * 80.0 * np.array([np.cos(along), np.sin(along)])
        assert float(surface.point_world_mm(point_mm)[2]) == pytest.approx(sagitta_mm, abs=1e-9)


def test_across_the_bend_paper_stays_straight():
    surface = RolledPaper.from_sagitta(4.0, direction_deg=90.0)
    cone = ConePaper.from_sagitta(4.0, apex_mm=200.0, direction_deg=90.0)
    for bent in (surface, cone):
        point = bent.point_world_mm(np.array([70.0, 0.0]))
        np.testing.assert_allclose(point, [70.0, 0.0, 0.0], atol=1e-12)


def test_a_cone_with_its_apex_far_away_is_a_cylinder():
    cylinder = RolledPaper.from_sagitta(2.0, direction_deg=20.0)
    cone = ConePaper.from_sagitta(2.0, apex_mm=1e7, direction_deg=20.0)
    first, second = (jax.vmap(surface.point_world_mm)(PLACES) for surface in (cylinder, cone))
    np.testing.assert_allclose(first, second, atol=1e-4)


def test_a_twist_stretches_no_more_than_it_says():
    surface = TwistedPaper(RolledPaper(), 0.3, reach_mm=75.0)
    corners = 75.0 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
    heights = jax.vmap(surface.point_world_mm)(corners)[:, 2]
    np.testing.assert_allclose(heights, [0.3, -0.3, 0.3, -0.3])
    jacobian = jax.jacfwd(surface.point_world_mm)(corners[0])
    stretch = np.linalg.svd(np.asarray(jacobian), compute_uv=False) - 1
    assert stretch.max() == pytest.approx((0.3 / 75.0) ** 2, rel=1e-3)
