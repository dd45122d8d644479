"""Rotations: exponential map, Cayley map, and the pan-tilt-swing parametrisation of a camera."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike, ScalarLike, array_namespace

# [e]x of the three axes e: the matrix with [e]x w = e x w.
_CROSS = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)


def skew(vector: Float[ArrayLike, "3"]) -> Float[ArrayLike, "3 3"]:
    """Cross-product matrix [v]x (3, 3) with [v]x w = v x w."""
    array = jnp.asarray(vector)
    return jnp.sum(array[:, None, None] * _CROSS.astype(array.dtype), axis=0)


def cayley_rotation(vector_rad: Float[ArrayLike, "3"]) -> Float[ArrayLike, "3 3"]:
    """Cayley map: rotation (3, 3) about `vector_rad` by the angle 2 atan(length / 2), rad.

    For small vectors, angle and length are equal to second order. The map is rational and has no
    special case near zero. Source: A. Cayley, "Sur quelques propriétés des déterminants gauches"
    (1846).
    """
    half = skew(0.5 * vector_rad)
    share = 2 / (1 + 0.25 * jnp.sum(jnp.square(vector_rad)))
    return np.eye(3, dtype=half.dtype) + share * (half + half @ half)


def rotation_from_vector(vector_rad: Float[ArrayLike, "3"]) -> Float[ArrayLike, "3 3"]:
    """Rotation (3, 3) about `vector_rad` by its length in rad: Rodrigues' formula.

    Below 1e-4 rad a Taylor series is used, so that derivatives exist at zero.
    """
    squared = jnp.sum(jnp.square(vector_rad))
    small = squared < 1e-8
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    first = jnp.where(small, 1 - squared / 6, jnp.sin(angle) / angle)
    second = jnp.where(small, 0.5 - squared / 24, (1 - jnp.cos(angle)) / (angle * angle))
    cross = skew(vector_rad)
    return jnp.eye(3) + first * cross + second * cross @ cross


def vector_from_rotation(rotation: Float[ArrayLike, "3 3"]) -> Float[ArrayLike, "3"]:
    """Rotation vector (3,), rad, of a rotation; inverse of `rotation_from_vector`.

    The angle must be below 90 degrees. Below 1e-6 rad a Taylor series is used, so that derivatives
    exist at zero.
    """
    axis = 0.5 * jnp.stack(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    squared = axis @ axis
    small = squared < 1e-12
    sine = jnp.sqrt(jnp.where(small, 1.0, squared))
    return axis * jnp.where(small, 1 + squared / 6, jnp.arcsin(sine) / sine)


def rotation_from_pan_tilt_swing(
    pan_rad: ScalarLike, tilt_rad: ScalarLike, swing_rad: ScalarLike
) -> Float[ArrayLike, "3 3"]:
    """Rotation cam_from_world (3, 3); its rows are the camera's x (right), y (down), z (forward).

    Pan is the azimuth of the camera, 0 on the -Y side and positive toward +X. Tilt is the elevation
    of the camera above Z = 0. Swing turns the camera's x axis toward its y axis.
    """
    xp = array_namespace(pan_rad, tilt_rad, swing_rad)
    sin_p, cos_p = xp.sin(pan_rad), xp.cos(pan_rad)
    sin_t, cos_t = xp.sin(tilt_rad), xp.cos(tilt_rad)
    sin_s, cos_s = xp.sin(swing_rad), xp.cos(swing_rad)
    right, down, forward = _level_axes(sin_p, cos_p, sin_t, cos_t)
    return xp.stack([cos_s * right + sin_s * down, -sin_s * right + cos_s * down, forward])


def pan_tilt_swing_from_rotation(
    rotation: Float[ArrayLike, "3 3"],
) -> tuple[Float[ArrayLike, ""], Float[ArrayLike, ""], Float[ArrayLike, ""]]:
    """(pan, tilt, swing), rad, of a rotation cam_from_world.

    This is the inverse of `rotation_from_pan_tilt_swing`. At a tilt of +-90 degrees only a
    combination of pan and swing is defined; their separate values are arbitrary.
    """
    xp = array_namespace(rotation)
    x, forward = rotation[0], rotation[2]
    pan = xp.arctan2(-forward[0], forward[1])
    tilt = xp.arctan2(-forward[2], xp.hypot(forward[0], forward[1]))
    right, down, _ = _level_axes(xp.sin(pan), xp.cos(pan), xp.sin(tilt), xp.cos(tilt))
    return pan, tilt, xp.arctan2(x @ down, x @ right)


def _level_axes(
    sin_p: Float[ArrayLike, ""],
    cos_p: Float[ArrayLike, ""],
    sin_t: Float[ArrayLike, ""],
    cos_t: Float[ArrayLike, ""],
) -> tuple[Float[ArrayLike, "3"], Float[ArrayLike, "3"], Float[ArrayLike, "3"]]:
    """Axes (right, down, forward) of a camera with swing 0, unit vectors in the world frame.

    The arguments are sine and cosine of pan and tilt.
    """
    xp = array_namespace(sin_p, cos_p, sin_t, cos_t)
    forward = xp.stack([-cos_t * sin_p, cos_t * cos_p, -sin_t])
    right = xp.stack([cos_p, sin_p, xp.zeros_like(sin_p)])
    return right, xp.cross(forward, right), forward
