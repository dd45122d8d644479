"""The picture of a sheet under a condition, from the first ray of light to the last bit."""

import numpy as np
from jaxtyping import Float, Shaped

from trinoc.geometry import Camera
from trinoc.synth.camera_picture.condition import Condition
from trinoc.synth.camera_picture.delivery import Processing, delivered
from trinoc.synth.camera_picture.optics import irradiance
from trinoc.synth.camera_picture.scene import radiance
from trinoc.synth.camera_picture.sensor import Sensor, read_out
from trinoc.synth.sheet_image import PrintedSheet


def camera_picture(
    pattern: PrintedSheet, camera: Camera, condition: Condition, *, seed: int = 0
) -> Shaped[np.ndarray, "h w *channels"]:
    """The picture that a camera delivers: (h, w) grey or (h, w, 3) red, green, blue.

    The camera is the true one (`Condition.camera`). uint8, or uint16 for more than 8 bits.
    Radiance costs most and depends on pattern, camera and `condition.scene` alone; who wants
    many pictures of one scene calls the steps below and keeps it.
    """
    light = irradiance(radiance(pattern, camera, condition.scene), condition.optics)
    return delivered_picture(light, condition.sensor, condition.processing, seed=seed)


def delivered_picture(
    irradiance: Float[np.ndarray, "h w"], sensor: Sensor, processing: Processing, *, seed: int = 0
) -> Shaped[np.ndarray, "h w *channels"]:
    """What sensor and processing make of the light on each pixel; noise is drawn by `seed`."""
    signal = read_out(irradiance, sensor, seed=seed)
    return delivered(signal, sensor.mosaic, processing)
