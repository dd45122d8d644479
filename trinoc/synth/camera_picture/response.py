"""Grey levels against light: what a camera makes of its linear signal. Both run from 0 to 1."""

from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Float


@runtime_checkable
class Response(Protocol):
    """A monotone curve through (0, 0) and (1, 1)."""

    def encoded(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The grey level of a signal from 0 to 1."""
        ...


class Linear(eqx.Module):
    """An industrial camera."""

    def encoded(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The signal."""
        return signal


class Gamma(eqx.Module):
    """A power of the signal: 1 / `gamma`."""

    gamma: float

    def encoded(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The power."""
        return signal ** (1 / self.gamma)


class SRGB(eqx.Module):
    """IEC 61966-2-1: a power of 1 / 2.4 with a straight start."""

    def encoded(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The standard's curve."""
        power = 1.055 * np.maximum(signal, 0.0031308) ** (1 / 2.4) - 0.055
        return np.where(signal <= 0.0031308, 12.92 * signal, power)


class SCurve(eqx.Module):
    """A response with more contrast in the middle and less at both ends.

    A share `contrast` of smoothstep, 3 x^2 - 2 x^3, over the response below.
    """

    below: Response = SRGB()
    contrast: float = 0.4

    def encoded(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The response below, bent."""
        x = self.below.encoded(signal)
        return (1 - self.contrast) * x + self.contrast * x * x * (3 - 2 * x)
