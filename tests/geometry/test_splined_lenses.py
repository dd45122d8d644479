"""Laws of splined lenses: core, surface, prior, and the region in which they are one to one."""

import pickle

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.interpolate import BSpline

from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import BrownConrady, ThinPrism
from trinoc.geometry.lenses.registry import simplify_lens, spline_lens
from trinoc.geometry.lenses.splined import (
    ORDER,
    SPLINED,
    AbstractSplinedLens,
    SplinedBrownConrady,
    SplinedKannalaBrandt,
    smoothness,
    surface,
)
from trinoc.io import load_intrinsics
from trinoc.io.intrinsics_json import expect_lens
from trinoc.io.saving import save

SIZE_PX = (640, 480)
AFFINE = np.array([620.0, 625.0, 325.0, 236.0])
CORE = BrownConrady.from_parameters(np.append(AFFINE, [-0.2, 0.05, 0.001, -0.0005, 0.0]))
FISHEYE = KannalaBrandt.from_parameters(np.append(AFFINE / [4, 4, 1, 1], [0.02, -0.001, 0, 0]))
height = jax.jit(surface)
project = jax.jit(jax.vmap(lambda lens, ray: lens.project_ray(ray), (None, 0)))
unproject = jax.jit(jax.vmap(lambda lens, uv_px: lens.unproject(uv_px), (None, 0)))


def corrected(core=CORE, scale_px=2.0, seed=0):
    """A lens with random control points about 0."""
    lens = spline_lens(core, SIZE_PX)
    values = np.array(lens.parameters)
    control = np.random.default_rng(seed).normal(0.0, scale_px, lens.control_count)
    values[-lens.control_count :] = control
    moved = lens.with_parameters(values)
    assert isinstance(moved, AbstractSplinedLens)
    return moved


def pixels(count=60, seed=1):
    """A grid of pixels of the picture, including its corners."""
    corners = [[u, v] for u in (0, SIZE_PX[0] - 1) for v in (0, SIZE_PX[1] - 1)]
    inside = np.random.default_rng(seed).uniform((0, 0), SIZE_PX, (count, 2))
    return np.concatenate([corners, inside])


def test_the_surface_is_de_boor_s():
    random = np.random.default_rng(0)
    control = random.normal(size=(7, 9))
    for point in random.uniform((0, 0), (6, 4), (20, 2)):
        expected = control
        for axis, along in enumerate(point[::-1]):
            count = expected.shape[0]
            knots = np.arange(count + ORDER) - (ORDER - 1.0)
            expected = BSpline(knots, expected, ORDER - 1)(along)
            assert axis == 1 or expected.shape == (9,)
        np.testing.assert_allclose(height(control, point), expected, atol=1e-12)


def test_beyond_its_grid_the_surface_stays_as_it_is_at_the_edge():
    control = np.random.default_rng(0).normal(size=(7, 9))
    np.testing.assert_array_equal(
        height(control, np.array([-3.0, 9.0])), height(control, np.array([0.0, 4.0]))
    )


@pytest.mark.parametrize("core", [CORE, FISHEYE], ids=["perspective", "fisheye"])
def test_a_correction_of_zero_is_the_core(core):
    lens = spline_lens(core, SIZE_PX)
    rays = unproject(core, pixels())
    np.testing.assert_allclose(project(lens, rays), project(core, rays), atol=1e-9)
    assert type(simplify_lens(lens)) is type(core)
    np.testing.assert_array_equal(simplify_lens(lens).parameters, core.parameters)
    assert lens.fold_angle_rad() == core.fold_angle_rad()


@pytest.mark.parametrize("core", [CORE, FISHEYE], ids=["perspective", "fisheye"])
def test_every_pixel_has_its_ray(core):
    lens = corrected(core)
    assert lens.steepness() < 1.0
    uv_px = pixels()
    rays = unproject(lens, uv_px)
    np.testing.assert_allclose(project(lens, 3.0 * rays), uv_px, atol=1e-9)
    if core is FISHEYE:
        assert np.degrees(np.arccos(rays[:, 2])).max() > 100.0


@given(value=st.floats(-3.0, 3.0))
def test_one_height_everywhere_moves_all_pixels_by_it(value):
    lens = spline_lens(CORE, SIZE_PX)
    values = np.array(lens.parameters)
    values[-lens.control_count // 2 :] = value
    rays = unproject(CORE, pixels(4))
    moved = np.asarray(project(lens.with_parameters(values), rays)) - project(CORE, rays)
    np.testing.assert_allclose(moved, np.full((8, 2), [0.0, value]), atol=1e-9)


def test_pixels_are_linear_in_the_control_points():
    lens = corrected()
    rays = unproject(lens, pixels(6))
    control = lens.control_count

    @jax.jit
    @jax.jacfwd
    def by_parameters(values):
        return jax.vmap(lens.with_parameters(values).project_ray)(rays)

    expected = by_parameters(lens.parameters)[..., -control:]
    by_control = jax.vmap(lens.by_control)(project(lens.core, rays))
    np.testing.assert_allclose(by_control, expected, atol=1e-9)
    np.testing.assert_allclose(np.sum(by_control, axis=(1, 2)), 2.0, rtol=1e-12)


def test_the_prior_knows_the_correction_to_one_pixel_and_nothing_else():
    information = SplinedBrownConrady.correction_information()
    control = SplinedBrownConrady.control_count
    assert not information[:-control].any()
    assert not information[:, :-control].any()
    np.linalg.cholesky(information[-control:, -control:])
    one = smoothness(10, 12, 4.0)
    drawn = np.linalg.solve(
        np.linalg.cholesky(one).T, np.random.default_rng(0).normal(size=(120, 300))
    ).T.reshape(300, 10, 12)
    middles = jax.vmap(lambda surface_: height(surface_, np.array([4.5, 3.5])))(drawn)
    assert 0.75 < np.std(middles) < 1.15


def test_it_is_pickled_and_written_whole(tmp_path):
    for core in (CORE, FISHEYE):
        lens = Intrinsics.of_lens(corrected(core), SIZE_PX)
        save(lens, tmp_path / "camera.json")
        for back in (pickle.loads(pickle.dumps(lens)), load_intrinsics(tmp_path / "camera.json")):
            assert type(back.lens) is type(lens.lens)
            np.testing.assert_array_equal(back.lens.parameters, lens.lens.parameters)


def test_a_correction_that_folds_is_refused():
    steep = corrected(scale_px=40.0)
    assert steep.steepness() > 1.0
    with pytest.raises(InputError, match="folds the image: neighbouring control points"):
        expect_lens(Intrinsics.of_lens(steep, SIZE_PX), "lens.json")


def test_what_is_no_core_is_told():
    prism = ThinPrism.from_parameters(np.append(AFFINE, np.zeros(12) + 1e-3))
    with pytest.raises(InputError, match="thin_prism takes no correction"):
        spline_lens(prism, SIZE_PX)
    assert set(SPLINED.values()) >= {SplinedBrownConrady, SplinedKannalaBrandt}
