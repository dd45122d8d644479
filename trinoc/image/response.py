"""Grey levels against light: the response of a camera.

Levels and light run from 0, black, to 1, full white. All rooms know a response by its three
functions and the numbers that it is made of; another curve is another class in this file, and a
name in `_NAMED`.
"""

import abc
import numbers
from types import ModuleType
from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.numerics.precision import ArrayLike, ScalarLike, array_namespace

# Elementwise, NumPy where nothing is traced.
Values = Float[ArrayLike, "..."]


class Parameter(NamedTuple):
    """A number of a response, where it is fitted to a picture.

    least, most : bounds. usual, sigma : what is known of it before.
    """

    least: float
    most: float
    usual: float
    sigma: float


class AbstractResponse(eqx.Module):
    """How a camera makes grey levels of light. The fields of a response are its parameters."""

    PARAMETERS: ClassVar[dict[str, Parameter]]

    @abc.abstractmethod
    def level_of(self, light: Values | float) -> Values:
        """The grey level that light gives."""

    @abc.abstractmethod
    def light_of(self, level: Values | float) -> Values:
        """Inverse of `level_of`, of levels above black."""

    @abc.abstractmethod
    def slope_at(self, light: Values | float) -> Values:
        """By how much the level grows with the light."""

    @property
    @abc.abstractmethod
    def is_linear(self) -> bool:
        """Whether light and level are one; of a response that nobody traces."""

    @property
    @abc.abstractmethod
    def words(self) -> str:
        """What the curve is like, in a few words."""


class PowerResponse(AbstractResponse):
    """One family from linear to sRGB and beyond, ((x + t)^p - t^p) / ((1 + t)^p - t^p) with
    p = 2.4^-bend: sRGB's curve (IEC 61966-2-1) at bend 1 within .0002.

    bend : 0 linear, 1 sRGB.
    """

    bend: ScalarLike = 0.0

    PARAMETERS: ClassVar[dict[str, Parameter]] = {"bend": Parameter(-1.0, 3.0, 0.0, 1.0)}
    # Bends that a user may give.
    LEAST: ClassVar[float] = -1.0
    MOST: ClassVar[float] = 2.0
    _TOE: ClassVar[float] = 0.001
    _LOG_GAMMA: ClassVar[float] = float(np.log(2.4))
    # Light below black, as ringing makes it, is taken along the tangent.
    _LEAST_LIGHT: ClassVar[float] = -0.8 * _TOE
    _LEAST_LEVEL: ClassVar[float] = 1e-6

    def level_of(self, light: Values | float) -> Values:
        """The grey level; the identity at bend 0."""
        xp, power = self._namespace_and_power(light)
        base = xp.maximum(light, self._LEAST_LIGHT) + self._TOE
        level = (base**power - self._TOE**power) / self._range(power)
        slope = self._slope(self._LEAST_LIGHT + self._TOE, power)
        return level + slope * xp.minimum(light - self._LEAST_LIGHT, 0.0)

    def light_of(self, level: Values | float) -> Values:
        """Inverse of `level_of`, of levels above black."""
        xp, power = self._namespace_and_power(level)
        base = xp.maximum(level, self._LEAST_LEVEL) * self._range(power) + self._TOE**power
        return base ** (1 / power) - self._TOE

    def slope_at(self, light: Values | float) -> Values:
        """By how much the level grows with the light."""
        xp, power = self._namespace_and_power(light)
        return self._slope(xp.maximum(light, self._LEAST_LIGHT) + self._TOE, power)

    @property
    def is_linear(self) -> bool:
        """Whether light and level are one."""
        return not self.bend

    @property
    def words(self) -> str:
        """What the curve is like, in a few words."""
        if abs(self.bend - 1) < 0.1:
            return "as sRGB"
        if self.bend < 0:
            return "below linear"
        return "between linear and sRGB" if self.bend < 1 else "beyond sRGB"

    def _namespace_and_power(self, values: Values | float) -> tuple[ModuleType, ScalarLike]:
        xp = array_namespace(values, self.bend)
        return xp, xp.exp(-self._LOG_GAMMA * self.bend)

    def _slope(self, base: Values | float, power: ScalarLike) -> Values:
        return power * base ** (power - 1) / self._range(power)

    def _range(self, power: ScalarLike) -> ScalarLike:
        return (1 + self._TOE) ** power - self._TOE**power


# How a camera makes grey levels of light, as users say it: by name, by how far its curve bends, or
# as a curve of their own.
ResponseLike = Literal["linear", "srgb"] | float | AbstractResponse
_NAMED = {"linear": PowerResponse(0.0), "srgb": PowerResponse(1.0)}


def find_response(given: ResponseLike | str) -> AbstractResponse:
    """The response that a user names. Raises InputError for a name or a bend that is none."""
    if isinstance(given, AbstractResponse):
        return given
    least, most = PowerResponse.LEAST, PowerResponse.MOST
    if isinstance(given, str):
        found = _NAMED.get(given)
    else:
        is_bend = isinstance(given, numbers.Real) and least <= given <= most
        found = PowerResponse(float(given)) if is_bend else None
    if found is None:
        raise InputError(
            f'response is {given!r}, but must be "linear", "srgb" or a number from '
            f"{least:g} to {most:g} (0 is linear, 1 is sRGB)."
        )
    return found
