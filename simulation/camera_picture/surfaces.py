"""Surfaces of a sheet of paper, which touch Z = 0 at the origin of the world.

A place (X, Y) in mm on the paper, measured along it, goes to a point of the world. Paper bends
and does not stretch, so that `RolledPaper` and `ConePaper` keep the length of every curve drawn on
it.
"""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar

from trinoc.numerics.precision import ArrayLike, ScalarLike


@runtime_checkable
class Surface(Protocol):
    """Interface of the surface on which a sheet lies."""

    def point_world_mm(self, place_mm: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """World point, in mm, of a point of the paper."""
        ...


class RolledPaper(eqx.Module):
    """Paper bent like a sheet that was rolled up; flat with a curvature of zero.

    Fields
    ------
    curvature_per_mm : along the direction of the bend, positive where the ends rise.
    direction_rad : of the bend, from X toward Y; the sheet stays straight across it.
    """

    curvature_per_mm: ScalarLike = 0.0
    direction_rad: ScalarLike = 0.0

    @classmethod
    def from_sagitta(
        cls, sagitta_mm: float, *, direction_deg: float = 0.0, reach_mm: float = 75.0
    ) -> "RolledPaper":
        """The bend that lifts what lies `reach_mm` along the paper from its middle."""

        def excess(angle: float) -> float:
            return reach_mm * np.tan(angle / 2) * np.sinc(angle / np.pi) - abs(sagitta_mm)

        # Up to half a right angle at the reach the rise grows with the angle.
        angle = _root(excess, 0.0, np.pi / 2)
        curvature = float(np.sign(sagitta_mm)) * angle / reach_mm
        return cls(curvature, float(np.radians(direction_deg)))

    def point_world_mm(self, place_mm: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """The arc of a circle along the bend, a straight line across it."""
        across, along = _across_and_along(place_mm, self.direction_rad)
        turn = self.curvature_per_mm * along / jnp.pi
        # sin(a)/a and (1 - cos(a))/a^2 in forms that hold at a = 0.
        forward = along * jnp.sinc(turn)
        height = 0.5 * self.curvature_per_mm * along**2 * jnp.sinc(turn / 2) ** 2
        return _in_world(across, forward, height, self.direction_rad)


class ConePaper(eqx.Module):
    """Paper bent like a cornet: more strongly towards the apex, whose rulings meet there.

    Fields
    ------
    curvature_per_mm : along the bend at the middle, positive where the ends rise.
    apex_mm : distance along the paper from the middle to the apex, across the bend.
    direction_rad : of the bend at the middle, from X toward Y.
    """

    curvature_per_mm: ScalarLike
    apex_mm: ScalarLike
    direction_rad: ScalarLike = 0.0

    @classmethod
    def from_sagitta(
        cls,
        sagitta_mm: float,
        *,
        apex_mm: float = 300.0,
        direction_deg: float = 0.0,
        reach_mm: float = 75.0,
    ) -> "ConePaper":
        """The bend that lifts what lies `reach_mm` along the paper from its middle."""
        from_apex, angle = np.hypot(apex_mm, reach_mm), np.arctan2(reach_mm, apex_mm)

        def excess(curvature: float) -> float:
            cotangent = curvature * apex_mm
            sine = 1 / np.sqrt(1 + cotangent**2)
            rise = 2 * np.sin(angle / sine / 2) ** 2
            return from_apex * sine**2 * cotangent * rise - sagitta_mm

        curvature = _root(excess, -1 / reach_mm, 1 / reach_mm)
        return cls(curvature, apex_mm, float(np.radians(direction_deg)))

    def point_world_mm(self, place_mm: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """The flat sector about the apex, wound round the cone.

        `cotangent` and `sine` are of the cone's half angle; a flat sheet has a right one.
        """
        across, along = _across_and_along(place_mm, self.direction_rad)
        cotangent = self.curvature_per_mm * self.apex_mm
        sine = 1 / jnp.sqrt(1 + jnp.asarray(cotangent) ** 2)
        from_apex = jnp.hypot(self.apex_mm + across, along)
        turn = jnp.arctan2(along, self.apex_mm + across) / sine
        rise = 2 * jnp.sin(turn / 2) ** 2
        # Along the middle ruling, along the bend, and up; 1 - rise is the cosine of the turn.
        ruling = from_apex * (1 - sine**2 * rise) - self.apex_mm
        forward = from_apex * sine * jnp.sin(turn)
        height = from_apex * sine**2 * cotangent * rise
        return _in_world(ruling, forward, height, self.direction_rad)


class TwistedPaper(eqx.Module):
    """A surface with two opposite corners raised and two lowered, by rise X Y / reach^2.

    No bending of paper does that without stretching it: by a share of (rise / reach)^2 at the
    corners, two millionths where the rise is a tenth of a millimetre.
    """

    surface: Surface
    rise_mm: ScalarLike
    reach_mm: ScalarLike = 75.0

    def point_world_mm(self, place_mm: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """The surface below, with the twist's rise added."""
        rise = self.rise_mm * place_mm[0] * place_mm[1] / self.reach_mm**2
        return self.surface.point_world_mm(place_mm) + rise * jnp.array([0.0, 0.0, 1.0])


def _across_and_along(
    place_mm: Float[ArrayLike, "2"], direction_rad: ScalarLike
) -> tuple[Float[ArrayLike, ""], Float[ArrayLike, ""]]:
    cos, sin = jnp.cos(direction_rad), jnp.sin(direction_rad)
    return sin * place_mm[0] - cos * place_mm[1], cos * place_mm[0] + sin * place_mm[1]


def _in_world(
    across: ArrayLike, along: ArrayLike, height: ArrayLike, direction_rad: ScalarLike
) -> Float[ArrayLike, "3"]:
    cos, sin = jnp.cos(direction_rad), jnp.sin(direction_rad)
    return jnp.stack([sin * across + cos * along, -cos * across + sin * along, height])


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    return float(root_scalar(function, bracket=(low, high), xtol=1e-17).root)
