"""Laws of every lens: inverse, derivatives, stacking, tracing, and agreement with OpenCV."""

import cv2
import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from tests.geometry.strategies import vectors
from trinoc.errors import InputError
from trinoc.geometry import AbstractLens
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import BrownConrady, Pinhole, Rational, ThinPrism
from trinoc.geometry.lenses.registry import (
    LENS_MODELS,
    lens_model,
    promote_lens,
    simplify_lens,
    stack_lenses,
)
from trinoc.geometry.lenses.splined import SPLINED

SIZE_PX = (512, 480)
AFFINE = (987.0, 1194.0, 250.0, 243.0)


def example(model: type[AbstractLens]) -> AbstractLens:
    """A lens of the model. Each coefficient moves the corners of the image by some pixels."""
    ideal = model.from_parameters(np.array([*AFFINE, *np.zeros(len(model.coefficient_names))]))
    signs = (-1.0) ** np.arange(len(model.coefficient_names))
    return ideal.retract(
        ideal.parameter_scales(SIZE_PX) * np.array([0.0, 0.0, 0.0, 0.0, *0.01 * signs])
    )


# Of the splined ones, which differ by their cores, one.
MODELS = {
    name: model
    for name, model in LENS_MODELS.items()
    if model not in SPLINED.values() or model is SPLINED[KannalaBrandt]
}
LENSES = [example(model) for model in MODELS.values()]
every_lens = pytest.mark.parametrize("lens", LENSES, ids=MODELS)
project_ray = jax.jit(lambda lens, ray: lens.project_ray(ray))
unproject = jax.jit(lambda lens, uv_px: lens.unproject(uv_px))


@every_lens
def test_names_values_and_scales_belong_together(lens):
    names = lens.parameter_names
    assert names == (*AFFINE_PARAMETERS, *lens.coefficient_names)
    assert len(set(names)) == len(names) == len(lens.parameters)
    assert (lens.parameter_scales(SIZE_PX) > 0).all()
    assert set(lens.dispensable) <= set(lens.coefficient_names)
    assert lens.coefficient_counts[0] == 0
    assert lens.coefficient_counts[-1] == len(lens.coefficient_names)
    assert lens_model(lens.model) is type(lens)
    rebuilt = type(lens).from_parameters(lens.parameters)
    np.testing.assert_array_equal(rebuilt.parameters, lens.parameters)


@every_lens
@given(point=vectors(2, 0.25))
def test_unproject_inverts_project_ray_at_any_length_of_the_ray(lens, point):
    ray = np.append(point, 1.0)
    uv_px = project_ray(lens, ray)
    np.testing.assert_allclose(project_ray(lens, 7.0 * ray), uv_px, rtol=1e-12)
    np.testing.assert_allclose(unproject(lens, uv_px), ray / np.linalg.norm(ray), atol=1e-12)


@every_lens
def test_a_change_of_zero_leaves_the_lens_and_others_add(lens):
    zero = np.zeros(len(lens.parameter_names))
    np.testing.assert_array_equal(lens.retract(zero).parameters, lens.parameters)
    part = np.array([1.0, 2.0])
    np.testing.assert_allclose(lens.retract(part).parameters[:2], lens.parameters[:2] + part)
    np.testing.assert_array_equal(lens.retract(part).parameters[2:], lens.parameters[2:])


@every_lens
def test_forward_reverse_and_numeric_derivatives_agree(lens):
    ray = np.array([0.13, -0.21, 1.1])

    @jax.jit
    def pixel(delta, ray):
        return lens.retract(lens.parameter_scales(SIZE_PX) * delta).project_ray(ray)

    zero = np.zeros(len(lens.parameter_names))
    forward = jax.jacfwd(pixel, argnums=(0, 1))(zero, ray)
    reverse = jax.jacrev(pixel, argnums=(0, 1))(zero, ray)
    for one, other in zip(forward, reverse, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
    for k in range(len(zero)):
        step = 1e-6 * np.eye(len(zero))[k]
        numeric = (pixel(step, ray) - pixel(-step, ray)) / 2e-6
        np.testing.assert_allclose(forward[0][:, k], numeric, rtol=1e-6, atol=1e-4)


# One that is inverted in the plane, and one by its radius.
@pytest.mark.parametrize("model", [BrownConrady, KannalaBrandt])
def test_there_and_back_is_the_identity_to_second_order(model):
    lens = example(model)

    def back(delta, uv_px):
        here = lens.retract(lens.parameter_scales(SIZE_PX) * delta)
        return here.project_ray(here.unproject(uv_px))

    arguments = np.zeros(len(lens.parameter_names)), np.array([400.0, 90.0])
    by_both = jax.jacfwd(back, argnums=(0, 1))
    (by_lens, by_pixel), (_, bend) = jax.jit(
        lambda delta, uv_px: (by_both(delta, uv_px), jax.jacfwd(by_both, argnums=1)(delta, uv_px))
    )(*arguments)
    np.testing.assert_allclose(by_lens, 0.0, atol=1e-9)
    np.testing.assert_allclose(by_pixel, np.eye(2), atol=1e-9)
    np.testing.assert_allclose(bend, 0.0, atol=1e-9)


@every_lens
def test_lenses_of_one_model_stack_and_go_through_vmap(lens):
    ray = np.array([0.1, -0.2, 1.0])
    stacked = stack_lenses([lens, lens.with_focal_factor(np.array([2.0, 3.0]))])
    together = jax.vmap(project_ray, in_axes=(0, None))(stacked, ray)
    centre = lens.principal_point_px
    np.testing.assert_allclose(together[0], project_ray(lens, ray))
    np.testing.assert_allclose(together[1] - centre, (together[0] - centre) * np.array([2.0, 3.0]))


@every_lens
def test_an_ideal_lens_is_promoted_to_the_others_it_is_stacked_with(lens):
    ideal = Pinhole.from_parameters(np.array(AFFINE))
    if not lens.zero_is_ideal:
        with pytest.raises(InputError, match=" and ".join(sorted((lens.model, "none")))):
            stack_lenses([ideal, lens])
        return
    stacked = stack_lenses([ideal, lens])
    assert type(stacked) is type(lens)
    ray = np.array([0.1, -0.2, 1.0])
    both = jax.vmap(project_ray, in_axes=(0, None))(stacked, ray)
    np.testing.assert_allclose(both[0], project_ray(ideal, ray), rtol=1e-12)
    np.testing.assert_allclose(both[1], project_ray(lens, ray), rtol=1e-12)


def test_two_models_that_both_distort_do_not_stack():
    class Other(BrownConrady):
        model = "other"

    lens = example(BrownConrady)
    with pytest.raises(InputError, match="brown_conrady and other"):
        stack_lenses([lens, Other.from_parameters(lens.parameters)])


def test_promotion_and_simplification_are_inverse():
    ideal = Pinhole.from_parameters(np.array(AFFINE))
    assert isinstance(promote_lens(ideal), BrownConrady)
    assert isinstance(simplify_lens(promote_lens(ideal)), Pinhole)
    lens = example(BrownConrady)
    assert promote_lens(lens) is lens
    assert simplify_lens(lens) is lens


def test_a_lens_that_is_not_known_is_refused():
    with pytest.raises(InputError, match="brown_conrady"):
        Intrinsics(focal_length_px=900, image_size_px=SIZE_PX, distortion_model="mirror")


@pytest.mark.parametrize("model", [BrownConrady, Rational, ThinPrism, KannalaBrandt])
def test_opencv_projects_alike(model):
    lens = example(model)
    points = np.random.default_rng(0).uniform((-60, -60, 240), (60, 60, 360), (50, 3))
    still, coefficients = np.zeros(3), np.asarray(lens.coefficients)
    if model is KannalaBrandt:
        points *= (20, 20, 1)  # up to 78 degrees off the axis
        fisheye_points = points[:, None]
        matrix = np.asarray(lens.matrix)
        expected, _ = cv2.fisheye.projectPoints(fisheye_points, still, still, matrix, coefficients)
    else:
        expected, _ = cv2.projectPoints(points, still, still, np.asarray(lens.matrix), coefficients)
    ours = jax.vmap(project_ray, in_axes=(None, 0))(lens, points)
    np.testing.assert_allclose(ours, expected.reshape(-1, 2), atol=1e-9)


@given(angle_deg=st.floats(0.0, 179.0), about=st.floats(0.0, 6.28))
def test_a_fisheye_sees_rays_from_behind(angle_deg, about):
    lens = KannalaBrandt.from_parameters(np.array([*AFFINE, 0.05, -0.02, 0.003, -0.0001]))
    angle = np.radians(angle_deg)
    ray = np.array([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)])
    np.testing.assert_allclose(unproject(lens, project_ray(lens, ray)), ray, atol=1e-9)


def test_a_fisheye_has_derivatives_on_its_axis():
    lens = example(KannalaBrandt)
    for ray in (np.array([0.0, 0.0, 2.0]), np.array([1e-9, -2e-9, 2.0])):
        by_ray = jax.jit(jax.jacfwd(lens.project_ray))(ray)
        np.testing.assert_allclose(by_ray[:, :2], np.diag(lens.focal_length_px) / 2, atol=1e-5)
        by_pixel = jax.jit(jax.jacrev(lens.unproject))(project_ray(lens, ray))
        np.testing.assert_allclose(by_pixel[:2], np.diag(1 / lens.focal_length_px), atol=1e-9)


@pytest.mark.parametrize(
    ("model", "coefficients", "angle_deg"),
    [
        # r (1 - r^2 / 3) stops to grow at r = 1, and so does that of a quotient at its own pole.
        (BrownConrady, [-1 / 3, 0, 0, 0, 0], 45.0),
        (Rational, [-1 / 3, 0, 0, 0, 0, 0, 0, 0], 45.0),
        (Rational, [0, 0, 0, 0, 0, -1 / 3, 0, 0], 60.0),
        (Rational, [0, 0, 0, 0, 0, 1.0, 0, 0], 45.0),
        (KannalaBrandt, [-1 / 3, 0, 0, 0], np.degrees(1.0)),
        (KannalaBrandt, [-1 / 12, 0, 0, 0], np.degrees(2.0)),
        (KannalaBrandt, [0, 0, 0, 0], 180.0),
        (BrownConrady, [0.1, 0, 0, 0, 0], 90.0),
    ],
)
def test_the_fold_is_where_the_radius_stops_to_grow(model, coefficients, angle_deg):
    lens = model.from_parameters(np.array([100.0, 100.0, 0.0, 0.0, *coefficients]))
    np.testing.assert_allclose(np.degrees(lens.fold_angle_rad()), angle_deg, rtol=1e-9)
    if angle_deg < 60.0:
        angle = np.radians(angle_deg)
        edge = project_ray(lens, np.array([np.sin(angle), 0.0, np.cos(angle)]))[0]
        # Newton's method ends at 95 % of the fold's ray, where the radius has hardly changed.
        assert 0.99 * edge < lens.valid_radius_px() < edge


def test_a_fisheye_without_coefficients_is_no_pinhole():
    lens = KannalaBrandt.from_parameters(np.array([*AFFINE, 0.0, 0.0, 0.0, 0.0]))
    assert simplify_lens(lens) is lens
