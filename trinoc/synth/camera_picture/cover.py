"""What lies on the sheet and hides part of it: a finger, a card."""

from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np

from trinoc.synth.layers import Layer, Paint
from trinoc.synth.shapes import Capsule, ConvexPolygon


@runtime_checkable
class Cover(Protocol):
    """Something opaque that lies flat on the sheet."""

    @property
    def layer(self) -> Layer:
        """It, as a layer of reflectance in the sheet's millimetres."""
        ...


class Finger(eqx.Module):
    """A finger from its tip on into the hand, `direction_deg` from X toward Y."""

    tip_mm: tuple[float, float]
    direction_deg: float
    length_mm: float = 200.0
    width_mm: float = 17.0
    reflectance: float = 0.45

    @property
    def layer(self) -> Layer:
        """A capsule of skin."""
        angle = np.radians(self.direction_deg)
        along = np.array([np.cos(angle), np.sin(angle)])
        start = np.array(self.tip_mm) + self.width_mm / 2 * along
        ends = np.stack([start, start + self.length_mm * along])
        return Paint(Capsule(ends, self.width_mm / 2), self.reflectance)


class Card(eqx.Module):
    """A bank card, turned by `turn_deg` from X toward Y."""

    centre_mm: tuple[float, float]
    turn_deg: float = 0.0
    size_mm: tuple[float, float] = (85.6, 54.0)
    reflectance: float = 0.55

    @property
    def layer(self) -> Layer:
        """A rectangle of plastic."""
        shape = ConvexPolygon.rectangle(np.array(self.centre_mm), self.size_mm, self.turn_deg)
        return Paint(shape, self.reflectance)
