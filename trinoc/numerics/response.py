"""Grey levels against light, for cameras that are not linear.

One family from linear to sRGB and beyond, ((x + t)^p - t^p) / ((1 + t)^p - t^p) with
p = 2.4^-bend: sRGB's curve (IEC 61966-2-1) at bend 1 within .0002. Levels and light run from 0 to
1.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.numerics.arrays import ArrayLike

Scalar = Float[ArrayLike, ""]

_TOE = 0.001
_LOG_GAMMA = float(np.log(2.4))
# Light below black, as ringing makes it, is taken along the tangent.
_LEAST_LIGHT = -0.8 * _TOE


def level_of_light(light: Scalar, bend: Scalar) -> Scalar:
    """The grey level; the identity at bend 0."""
    power = jnp.exp(-_LOG_GAMMA * bend)
    base = jnp.maximum(light, _LEAST_LIGHT) + _TOE
    level = (base**power - _TOE**power) / _range(power)
    slope = power * (_LEAST_LIGHT + _TOE) ** (power - 1) / _range(power)
    return level + slope * jnp.minimum(light - _LEAST_LIGHT, 0.0)


def light_of_level(level: Scalar, bend: Scalar) -> Scalar:
    """Inverse of `level_of_light`, of levels above black."""
    power = jnp.exp(-_LOG_GAMMA * bend)
    base = jnp.maximum(level, 1e-6) * _range(power) + _TOE**power
    return base ** (1 / power) - _TOE


def _range(power: Scalar) -> Scalar:
    return (1 + _TOE) ** power - _TOE**power
