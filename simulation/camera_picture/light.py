"""Light on the sheet, and its direct reflection toward the lens."""

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from simulation.camera_picture.sheet_view import pixel_grid_px
from trinoc.geometry.camera import Camera


class Shadow(eqx.Module):
    """Shade on one side of a straight edge, thrown by something outside the picture: a layer.

    Fields
    ------
    point_mm : (X, Y) of the edge.
    direction_deg : from the edge into the shade, from X toward Y.
    light_left : share of the light in the shade.
    penumbra_mm : sigma of the edge, a tenth of a millimetre at least.
    """

    point_mm: tuple[float, float]
    direction_deg: float
    light_left: float = 0.5
    penumbra_mm: float = 0.1

    @property
    def local(self) -> bool:
        """False: the shade reaches to the horizon."""
        return False

    def over(
        self,
        grey: Float[np.ndarray, "*n"],
        points_mm: Float[np.ndarray, "*n 2"],
        *,
        cells: bool = False,
    ) -> Float[np.ndarray, "*n"]:
        """The grey levels in light and shade."""
        depth = (points_mm - np.array(self.point_mm)) @ self._normal
        shaded = ndtr(depth / max(self.penumbra_mm, 0.1))
        return np.where(np.isfinite(shaded), grey * (1 - (1 - self.light_left) * shaded), grey)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """The edge, a metre to both sides, and parallel lines over the width of the penumbra."""
        along = np.array([-self._normal[1], self._normal[0]])
        line = np.array(self.point_mm) + np.arange(-1000.0, 1000.0, step_mm)[:, None] * along
        reach = min(3 * max(self.penumbra_mm, 0.1), 3.0)
        offsets_mm = np.arange(-reach, reach + step_mm / 2, step_mm)
        return np.concatenate([line + offset * self._normal for offset in offsets_mm])

    @property
    def _normal(self) -> Float[np.ndarray, "2"]:
        angle = np.radians(self.direction_deg)
        return np.array([np.cos(angle), np.sin(angle)])


class GlareLamp(eqx.Module):
    """A lamp that paper and ink reflect equally, as glare.

    Fields
    ------
    spot_mm : (X, Y) of a flat sheet where the camera would see the lamp in a mirror.
    distance_mm : from there to the lamp.
    roughness : rms slope of the sheet's facets: the spot's width.
    strength : reflected radiance at the spot's middle; a perfect diffuser gives back 1.
    """

    spot_mm: tuple[float, float]
    distance_mm: float = 800.0
    roughness: float = 0.05
    strength: float = 0.5


class Illumination(eqx.Module):
    """Variation of the light over the sheet and over the picture.

    Fields
    ------
    slope : change of the light along X and along Y, per 100 mm.
    curvature : of X^2, X Y and Y^2, per (100 mm)^2.
    vignetting : share of the light that the lens loses in the picture's corners.
    lamp : whose reflection is seen.
    shadows : hard edges of shade.
    """

    slope: tuple[float, float] = (0.0, 0.0)
    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)
    vignetting: float = 0.0
    lamp: GlareLamp | None = None
    shadows: tuple[Shadow, ...] = ()


def light_on_sheet(
    light: Illumination, points_mm: Float[np.ndarray, "*n 2"]
) -> Float[np.ndarray, "*n"]:
    """Light at points of the sheet over that at its middle, without shadows; 1 at NaN points."""
    x, y = points_mm[..., 0] / 100.0, points_mm[..., 1] / 100.0
    (a, b), (xx, xy, yy) = light.slope, light.curvature
    field = np.maximum(1 + a * x + b * y + xx * x**2 + xy * x * y + yy * y**2, 0.0)
    return np.where(np.isfinite(field), field, 1.0)


def passed_by_lens(
    light: Illumination, image_size_px: tuple[int, int], margin_px: int
) -> Float[np.ndarray, "h w"]:
    """Share of the light that the lens transmits to each pixel; it decreases with radius^2."""
    width, height = image_size_px
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    offset = pixel_grid_px(image_size_px, margin_px) - middle
    return 1 - light.vignetting * np.sum(offset**2, axis=-1) / (middle @ middle)


def reflection(
    lamp: GlareLamp, camera: Camera, points_world_mm: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w"]:
    """Radiance of the lamp's reflection at points of the world, toward a camera.

    The share of facets that stand as mirrors, exp(-tan^2 / roughness^2) of the angle between
    the half-way direction and the surface's normal (Beckmann and Spizzichino, 1963).
    """
    spot = np.array([*lamp.spot_mm, 0.0])
    centre = camera.centre_world_mm
    to_camera = _unit(centre - spot)
    position = spot + lamp.distance_mm * to_camera * np.array([-1.0, -1.0, 1.0])
    halfway = _unit(_unit(centre - points_world_mm) + _unit(position - points_world_mm))
    across, down = np.gradient(points_world_mm, axis=(1, 0))
    normal = _unit(np.cross(down, across))
    cosine_squared = np.einsum("...i,...i->...", halfway, normal) ** 2
    tangent_squared = 1 / np.maximum(cosine_squared, 1e-12) - 1
    return lamp.strength * np.nan_to_num(np.exp(-tangent_squared / lamp.roughness**2))


def _unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
