"""The sensor: exposure, colour mosaic, noise, saturation. Signals are linear, 1 is saturation.

Noise is told in grey levels of 8 bits of the linear signal, 1/255 of saturation.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

GREY_LEVELS = 255.0
# Read-outs reach this far below black, so that noise in the dark is not cut off.
BLACK = 1 / 16


class Mosaic(eqx.Module):
    """A colour filter over the pixels, rows R G R G ... and G B G B ..., from the top left.

    Fields
    ------
    gains : signal of a red, green and blue pixel in light that is white to the camera.
    """

    gains: tuple[float, float, float] = (0.55, 1.0, 0.65)


class Sensor(eqx.Module):
    """Conversion of light into grey levels.

    Fields
    ------
    exposure : signal of a perfect diffuser in full light.
    read_levels : sigma of the read-out's noise, in grey levels of 8 bits.
    electrons_per_level : for shot noise, whose variance in grey levels is the level over this;
        None leaves it out.
    correlation_px : sigma of a Gaussian that the noise was smoothed with, its variance kept.
    mosaic : the colour filter, or None for a sensor without.
    """

    exposure: float = 0.9 / 0.85
    read_levels: float = 2.0
    electrons_per_level: float | None = None
    correlation_px: float = 0.0
    mosaic: Mosaic | None = None

    def noise_levels(self, signal: float) -> float:
        """Standard deviation of the noise at a signal, in grey levels of 8 bits."""
        shot = 0.0 if self.electrons_per_level is None else 1 / self.electrons_per_level
        return float(np.sqrt(self.read_levels**2 + shot * GREY_LEVELS * max(signal, 0.0)))


def read_out(
    irradiance: Float[np.ndarray, "h w"], sensor: Sensor, *, seed: int
) -> Float[np.ndarray, "h w"]:
    """The linear signal of each pixel with noise, cut off at saturation and below black."""
    signal = sensor.exposure * irradiance
    if sensor.mosaic is not None:
        signal = signal * gain_of_pixels(sensor.mosaic, signal.shape)
    generator = np.random.default_rng(seed)
    levels = GREY_LEVELS * signal
    if sensor.electrons_per_level is not None:
        electrons = sensor.electrons_per_level
        levels = generator.poisson(np.maximum(levels, 0.0) * electrons) / electrons
    noise = generator.normal(size=signal.shape)
    if sensor.correlation_px:
        noise = _smooth_noise(noise, sensor.correlation_px)
    levels = levels + sensor.read_levels * noise
    return np.clip(levels / GREY_LEVELS, -BLACK, 1.0)


def gain_of_pixels(mosaic: Mosaic, shape: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """The gain of each pixel's colour."""
    red, green, blue = mosaic.gains
    tile = np.array([[red, green], [green, blue]])
    rows, columns = np.indices(shape) % 2
    return tile[rows, columns]


def _smooth_noise(noise: Float[np.ndarray, "h w"], sigma_px: float) -> Float[np.ndarray, "h w"]:
    """White noise through a Gaussian, scaled back to a variance of one."""
    reach = int(np.ceil(4 * sigma_px))
    impulse = np.zeros(2 * reach + 1)
    impulse[reach] = 1.0
    weights = gaussian_filter(impulse, sigma_px, mode="constant")
    # The filter is the product of one along each axis; so is the sum of its squares.
    return gaussian_filter(noise, sigma_px, mode="wrap") / np.sum(weights**2)
