import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import assume, given
from jax.test_util import check_grads

from tests.geometry.strategies import real, vectors
from trinoc.geometry import rotation as rotation_module

pan_tilt_swing_from_rotation = jax.jit(rotation_module.pan_tilt_swing_from_rotation)
rotation_from_pan_tilt_swing = jax.jit(rotation_module.rotation_from_pan_tilt_swing)
rotation_from_vector = jax.jit(rotation_module.rotation_from_vector)
cayley_rotation = jax.jit(rotation_module.cayley_rotation)
skew = jax.jit(rotation_module.skew)


@given(vectors(3, 3.0), vectors(3, 3.0))
def test_skew_is_the_cross_product(v, w):
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), atol=1e-12)


@given(vectors(3, 3.0))
def test_rotation_vector_gives_a_rotation_that_keeps_its_axis(vector):
    rotation = rotation_from_vector(vector)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-12)
    np.testing.assert_allclose(rotation @ vector, vector, atol=1e-12)
    np.testing.assert_allclose(rotation_from_vector(-vector), rotation.T, atol=1e-12)


@given(vectors(3, 3.0))
def test_cayley_turns_about_the_vector_by_twice_the_angle_whose_tangent_is_half_its_length(vector):
    length = np.linalg.norm(vector)
    angle = 2 * np.arctan(0.5 * length)
    expected = rotation_from_vector(angle / max(length, 1e-300) * vector)
    np.testing.assert_allclose(cayley_rotation(vector), expected, atol=1e-12)


@given(vectors(3, 1.0), real(-1.5, 1.5), real(-1.5, 1.5))
def test_rotations_about_one_axis_add(axis, first, second):
    combined = rotation_from_vector(first * axis) @ rotation_from_vector(second * axis)
    np.testing.assert_allclose(combined, rotation_from_vector((first + second) * axis), atol=1e-12)


def test_rotation_vector_is_smooth_at_zero():
    for size in (0.0, 1e-9, 1e-5, 1.001e-4, 0.3):
        vector = size * np.array([0.6, 0.0, 0.8])
        assert np.isfinite(jax.jacfwd(rotation_from_vector)(vector)).all()
    check_grads(rotation_from_vector, (np.array([1e-6, 2e-6, -1e-6]),), order=1, rtol=1e-6)
    generator = jax.jacfwd(rotation_from_vector)(jnp.zeros(3))[:, :, 2]
    np.testing.assert_allclose(generator, skew(np.array([0.0, 0.0, 1.0])), atol=1e-12)


@given(real(-3.1, 3.1), real(-1.5, 1.5), real(-3.1, 3.1))
def test_pan_tilt_swing_survive_the_rotation_matrix(pan, tilt, swing):
    rotation = rotation_from_pan_tilt_swing(pan, tilt, swing)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(
        pan_tilt_swing_from_rotation(rotation), (pan, tilt, swing), atol=1e-9
    )


@given(real(-3.1, 3.1), real(0.1, 1.4))
def test_signs_of_pan_and_tilt(pan, tilt):
    """The centre is d (cos t sin p, -cos t cos p, sin t), on the backward optical axis."""
    assume(abs(pan) > 1e-6)
    forward = rotation_from_pan_tilt_swing(pan, tilt, 0.0)[2]
    centre = (np.cos(tilt) * np.sin(pan), -np.cos(tilt) * np.cos(pan), np.sin(tilt))
    np.testing.assert_allclose(-forward, centre, atol=1e-12)


def test_a_level_camera_sees_up_as_up():
    """Without swing the world's Z is upward in the picture, and x is horizontal."""
    x, y, _ = rotation_from_pan_tilt_swing(0.3, 0.7, 0.0)
    assert abs(x[2]) < 1e-15
    assert y[2] < 0
