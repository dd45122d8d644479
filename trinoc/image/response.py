"""Response of a camera: grey level against light.

Levels and light run from 0, black, to 1, full white. Rooms use a response by its three functions
and its parameters. A new curve is a class in this file and a name in `_NAMED`.
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
    """Bounds and Gaussian prior of a response parameter that is fitted to an image.

    Attributes
    ----------
    lower, upper : float
        Bounds.
    prior_mean, sigma : float
        Mean and standard deviation of the prior.
    """

    lower: float
    upper: float
    prior_mean: float
    sigma: float


class AbstractResponse(eqx.Module):
    """Conversion between light and grey level. The fields of a response are its parameters.

    Light and level are 0 for black and 1 for full white.
    """

    PARAMETERS: ClassVar[dict[str, Parameter]]

    @abc.abstractmethod
    def level_of(self, light: Values | float) -> Values:
        """Grey level of a light value, elementwise."""

    @abc.abstractmethod
    def light_of(self, level: Values | float) -> Values:
        """Light of a grey level above black, elementwise; inverse of `level_of`."""

    @abc.abstractmethod
    def slope_at(self, light: Values | float) -> Values:
        """Derivative of the grey level with respect to the light, elementwise."""

    @property
    @abc.abstractmethod
    def is_linear(self) -> bool:
        """True if light and level are equal. The response must not be traced by JAX."""

    @property
    @abc.abstractmethod
    def description(self) -> str:
        """Short description of the response curve, used in messages."""


class PowerResponse(AbstractResponse):
    """Family of response curves from linear to sRGB and beyond.

    The level of the light x is ((x + t)^p - t^p) / ((1 + t)^p - t^p) with p = 2.4^-bend and t =
    0.001. With bend = 1, the curve differs by at most .0002 from that of sRGB (IEC 61966-2-1).

    Attributes
    ----------
    bend : float
        Curvature of the response: 0 is linear, 1 is sRGB.
    """

    bend: ScalarLike = 0.0

    PARAMETERS: ClassVar[dict[str, Parameter]] = {"bend": Parameter(-1.0, 3.0, 0.0, 1.0)}
    # Range of the bend as an argument.
    SMALLEST: ClassVar[float] = -1.0
    LARGEST: ClassVar[float] = 2.0
    _TOE: ClassVar[float] = 0.001
    _LOG_GAMMA: ClassVar[float] = float(np.log(2.4))
    # Light below black, for example by ringing, is extrapolated along the tangent.
    _LEAST_LIGHT: ClassVar[float] = -0.8 * _TOE
    _LEAST_LEVEL: ClassVar[float] = 1e-6

    def level_of(self, light: Values | float) -> Values:
        """Grey level of a light value, elementwise; equal to the light if `bend` is 0."""
        xp, power = self._namespace_and_power(light)
        base = xp.maximum(light, self._LEAST_LIGHT) + self._TOE
        level = (base**power - self._TOE**power) / self._range(power)
        slope = self._slope(self._LEAST_LIGHT + self._TOE, power)
        return level + slope * xp.minimum(light - self._LEAST_LIGHT, 0.0)

    def light_of(self, level: Values | float) -> Values:
        """Light of a grey level above black, elementwise."""
        xp, power = self._namespace_and_power(level)
        base = xp.maximum(level, self._LEAST_LEVEL) * self._range(power) + self._TOE**power
        return base ** (1 / power) - self._TOE

    def slope_at(self, light: Values | float) -> Values:
        """Derivative of the grey level with respect to the light, elementwise."""
        xp, power = self._namespace_and_power(light)
        return self._slope(xp.maximum(light, self._LEAST_LIGHT) + self._TOE, power)

    @property
    def is_linear(self) -> bool:
        """True if light and level are equal."""
        return not self.bend

    @property
    def description(self) -> str:
        """Short description of the response curve, used in messages."""
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


# Response as an argument: a name, a bend, or a response object.
ResponseLike = Literal["linear", "srgb"] | float | AbstractResponse
_NAMED = {"linear": PowerResponse(0.0), "srgb": PowerResponse(1.0)}


def find_response(value: ResponseLike | str) -> AbstractResponse:
    """Return the response for a name, a number or a response object.

    Parameters
    ----------
    value : str, float or AbstractResponse
        "linear", "srgb", a value of `PowerResponse.bend`, or a response, which is returned
        unchanged.

    Raises
    ------
    InputError
        If the value is none of these.
    """
    if isinstance(value, AbstractResponse):
        return value
    lower, upper = PowerResponse.SMALLEST, PowerResponse.LARGEST
    if isinstance(value, str):
        response = _NAMED.get(value)
    else:
        is_bend = isinstance(value, numbers.Real) and lower <= value <= upper
        response = PowerResponse(float(value)) if is_bend else None
    if response is None:
        raise InputError(
            f'response is {value!r}, but must be "linear", "srgb" or a number from '
            f"{lower:g} to {upper:g} (0 is linear, 1 is sRGB)."
        )
    return response
