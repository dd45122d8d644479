"""From the sensor's signal to the picture that is handed over."""

from typing import Literal, Protocol, runtime_checkable

import cv2
import equinox as eqx
import numpy as np
from jaxtyping import Float, Shaped

from simulation.camera_picture.sensor import BLACK, GREY_LEVELS, Mosaic, gain_of_pixels


@runtime_checkable
class Response(Protocol):
    """A monotone curve through (0, 0) and (1, 1)."""

    def encode(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The grey level of a signal from 0 to 1."""
        ...


class Linear(eqx.Module):
    """An industrial camera."""

    def encode(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The signal."""
        return signal


class Gamma(eqx.Module):
    """A power of the signal: 1 / `gamma`."""

    gamma: float

    def encode(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The power."""
        return signal ** (1 / self.gamma)


class SRGB(eqx.Module):
    """IEC 61966-2-1: a power of 1 / 2.4 with a straight start."""

    def encode(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The standard's curve."""
        power = 1.055 * np.maximum(signal, 0.0031308) ** (1 / 2.4) - 0.055
        return np.where(signal <= 0.0031308, 12.92 * signal, power)


class SCurve(eqx.Module):
    """A response with more contrast in the middle and less at both ends.

    A share `contrast` of smoothstep, 3 x^2 - 2 x^3, over the response below.
    """

    below: Response = SRGB()
    contrast: float = 0.4

    def encode(self, signal: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The response with an S-shaped curve on top."""
        x = self.below.encode(signal)
        return (1 - self.contrast) * x + self.contrast * x * x * (3 - 2 * x)


_FULL = 65535.0


@runtime_checkable
class Denoiser(Protocol):
    """A filter of one channel."""

    def channel(self, signal: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """The channel with less noise."""
        ...


class Median(eqx.Module):
    """The median of `size` x `size` pixels, 3 or 5."""

    size: int = 3

    def channel(self, signal: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """See the class."""
        return cv2.medianBlur(signal.astype(np.float32), self.size).astype(np.float64)


class Bilateral(eqx.Module):
    """Neighbours by Gaussian weights in distance and in grey level."""

    distance_px: float = 1.5
    levels: float = 12.0

    def channel(self, signal: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """See the class."""
        single = signal.astype(np.float32)
        sigma = self.levels / GREY_LEVELS
        return cv2.bilateralFilter(single, -1, sigma, self.distance_px).astype(np.float64)


class NonLocalMeans(eqx.Module):
    """Mean of similar pixels (Buades, Coll and Morel, doi 10.5201/ipol.2011.bcm_nlm).

    Patches of 3 x 3 pixels within 11 x 11; `levels` is the mean absolute difference, in grey
    levels of 8 bits, at which a patch counts little.
    """

    levels: float = 4.0

    def channel(self, signal: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """See the class."""
        # Balanced colours may lie below the read-out's black, where nothing is to be seen.
        raw = np.rint(np.clip((signal + BLACK) / (1 + BLACK), 0.0, 1.0) * _FULL).astype(np.uint16)
        strength = self.levels / GREY_LEVELS / (1 + BLACK) * _FULL
        smooth = cv2.fastNlMeansDenoising(raw, [strength], None, 3, 11, cv2.NORM_L1)
        return smooth.astype(np.float64) / _FULL * (1 + BLACK) - BLACK


def remove_noise(
    signal: Float[np.ndarray, "h w *channels"], denoiser: Denoiser | None
) -> Float[np.ndarray, "h w *channels"]:
    """The signal after the denoiser; unchanged if that is None."""
    if denoiser is None:
        return signal
    if signal.ndim == 2:
        return denoiser.channel(signal)
    channels = [denoiser.channel(signal[..., k]) for k in range(signal.shape[2])]
    return np.stack(channels, axis=-1)


Interpolation = Literal["bilinear", "edge-aware"]

_CODES = {
    "bilinear": cv2.COLOR_BayerRGGB2RGB,
    "edge-aware": cv2.COLOR_BayerRGGB2RGB_EA,
}


def demosaic(
    signal: Float[np.ndarray, "h w"], mosaic: Mosaic, interpolation: Interpolation
) -> Float[np.ndarray, "h w 3"]:
    """Red, green and blue of each pixel, balanced so that white has equal parts.

    Balanced pixels are saturated where they pass 1. OpenCV interpolates 16-bit numbers.
    """
    balanced = np.minimum(signal / gain_of_pixels(mosaic, signal.shape), 1.0)
    # Where a gain is small, noise reaches further below black than the read-out does.
    black = BLACK / min(mosaic.gains)
    raw = np.rint((balanced + black) / (1 + black) * _FULL).astype(np.uint16)
    colour = cv2.cvtColor(raw, _CODES[interpolation]).astype(np.float64) / _FULL
    return colour * (1 + black) - black


class Sharpening(eqx.Module):
    """Unsharp masking: adds `amount` times the detail that a Gaussian of `radius_px` removes."""

    radius_px: float = 1.0
    amount: float = 0.5


class Processing(eqx.Module):
    """Steps that a camera applies to its signal, in this order.

    Fields
    ------
    interpolation : of a mosaic's colours; None hands the mosaic over as it is.
    denoiser : on the linear signal.
    response : grey levels against light.
    sharpening : of the grey levels.
    bits : 8, or up to 16.
    jpeg_quality : 1 to 100; None for a format without loss.
    """

    interpolation: Interpolation | None = "bilinear"
    denoiser: Denoiser | None = None
    response: Response = Linear()
    sharpening: Sharpening | None = None
    bits: int = 8
    jpeg_quality: int | None = None


def deliver_picture(
    signal: Float[np.ndarray, "h w"], mosaic: Mosaic | None, processing: Processing
) -> Shaped[np.ndarray, "h w *channels"]:
    """The picture, (h, w) grey or (h, w, 3) red, green, blue, of 8 bits or in 16."""
    colour = signal
    if mosaic is not None and processing.interpolation is not None:
        colour = demosaic(signal, mosaic, processing.interpolation)
    linear = np.clip(remove_noise(colour, processing.denoiser), 0.0, 1.0)
    grey = sharpen(processing.response.encode(linear), processing.sharpening)
    image = quantise(grey, processing.bits)
    return image if processing.jpeg_quality is None else jpeg(image, processing.jpeg_quality)


def sharpen(
    grey: Float[np.ndarray, "h w *channels"], sharpening: Sharpening | None
) -> Float[np.ndarray, "h w *channels"]:
    """The sharpened picture; unchanged if `sharpening` is None."""
    if sharpening is None:
        return grey
    soft = cv2.GaussianBlur(grey, (0, 0), sharpening.radius_px)
    return grey + sharpening.amount * (grey - soft)


def quantise(
    grey: Float[np.ndarray, "h w *channels"], bits: int
) -> Shaped[np.ndarray, "h w *channels"]:
    """Grey levels from 0 to 1 as whole numbers from 0 to 2^bits - 1, uint8 or uint16."""
    levels = np.rint(np.clip(grey, 0.0, 1.0) * (2**bits - 1))
    return levels.astype(np.uint8 if bits <= 8 else np.uint16)


def jpeg(
    image: Shaped[np.ndarray, "h w *channels"], quality: int
) -> Shaped[np.ndarray, "h w *channels"]:
    """The picture after JPEG, colours at half the resolution as cameras store them."""
    # OpenCV orders colours the other way round.
    encoded = cv2.imencode(".jpg", image[..., ::-1] if image.ndim == 3 else image,
                           [cv2.IMWRITE_JPEG_QUALITY, quality])[1]  # fmt: skip
    decoded = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED))
    return decoded[..., ::-1] if image.ndim == 3 else decoded
