"""The picture of a sheet, from the first ray of light to the last bit."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Shaped

from simulation.camera_picture.delivery import Processing, deliver_picture
from simulation.camera_picture.layers import Layer
from simulation.camera_picture.light import Illumination
from simulation.camera_picture.optics import Optics, irradiance
from simulation.camera_picture.paper import Paper, SheetFigures
from simulation.camera_picture.scene import SheetScene, radiance
from simulation.camera_picture.sensor import GREY_LEVELS, Sensor, read_out
from trinoc.geometry.camera import Camera

_EVEN = Illumination()


class Condition(eqx.Module):
    """Conditions under which a picture is taken: the scene and the camera's steps, in order."""

    scene: SheetScene = SheetScene()
    optics: Optics = Optics()
    sensor: Sensor = Sensor()
    processing: Processing = Processing()


def camera_picture(
    pattern: SheetFigures, camera: Camera, condition: Condition, *, seed: int = 0
) -> Shaped[np.ndarray, "h w *channels"]:
    """The picture that a camera delivers: (h, w) grey or (h, w, 3) red, green, blue.

    uint8, or uint16 for more than 8 bits. Radiance costs most and depends on pattern, camera and
    `condition.scene` alone; who wants many pictures of one scene calls the steps and keeps it.
    """
    optics = condition.optics
    fine = radiance(pattern, camera, condition.scene, margin_px=optics.reach_px)
    light = irradiance(fine, optics)
    return delivered_picture(light, condition.sensor, condition.processing, seed=seed)


def delivered_picture(
    irradiance: Float[np.ndarray, "h w"], sensor: Sensor, processing: Processing, *, seed: int = 0
) -> Shaped[np.ndarray, "h w *channels"]:
    """Picture of the light on each pixel after sensor and processing; `seed` draws the noise."""
    signal = read_out(irradiance, sensor, seed=seed)
    return deliver_picture(signal, sensor.mosaic, processing)


def render_sheet(
    pattern: SheetFigures,
    camera: Camera,
    *,
    paper: float = 230.0,
    ink: float = 25.0,
    table: float | None = None,
    light: Illumination = _EVEN,
    covers: tuple[Layer, ...] = (),
    blur_px: float = 0.7,
    noise_sigma: float = 0.0,
    supersampling: int = 8,
    seed: int = 0,
    bits: int | None = 8,
) -> Shaped[np.ndarray, "h w"]:
    """The plain picture of a flat sheet; all inputs are grey levels from 0 to 255.

    A linear camera with a Gaussian blur of `blur_px`, the pixel's box apart, and `noise_sigma`.
    Paper reaches to the horizon unless there is a `table`. Without `bits`, the light on the
    pixels as it is: float64, neither noise nor rounding.
    """
    scene = SheetScene(Paper(paper=paper, ink=ink, table=table), light, covers)
    optics = Optics(blur_px)
    fine = radiance(pattern, camera, scene, supersampling=supersampling, margin_px=optics.reach_px)
    levels = irradiance(fine, optics)
    if bits is None:
        return levels
    sensor = Sensor(exposure=1 / GREY_LEVELS, read_levels=noise_sigma)
    return delivered_picture(levels, sensor, Processing(bits=bits), seed=seed)
