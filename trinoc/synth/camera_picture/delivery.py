"""From the sensor's signal to the picture that is handed over."""

import cv2
import equinox as eqx
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.synth.camera_picture.demosaic import Interpolation, demosaiced
from trinoc.synth.camera_picture.denoise import Denoiser, denoised
from trinoc.synth.camera_picture.response import Linear, Response
from trinoc.synth.camera_picture.sensor import Mosaic


class Sharpening(eqx.Module):
    """Unsharp masking: `amount` times what a Gaussian of `radius_px` takes away is added."""

    radius_px: float = 1.0
    amount: float = 0.5


class Processing(eqx.Module):
    """What a camera does to its signal, in this order.

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


def delivered(
    signal: Float[np.ndarray, "h w"], mosaic: Mosaic | None, processing: Processing
) -> Shaped[np.ndarray, "h w *channels"]:
    """The picture, (h, w) grey or (h, w, 3) red, green, blue, of 8 bits or in 16."""
    colour = signal
    if mosaic is not None and processing.interpolation is not None:
        colour = demosaiced(signal, mosaic, processing.interpolation)
    linear = np.clip(denoised(colour, processing.denoiser), 0.0, 1.0)
    grey = sharpened(processing.response.encoded(linear), processing.sharpening)
    image = quantised(grey, processing.bits)
    return image if processing.jpeg_quality is None else jpeg(image, processing.jpeg_quality)


def sharpened(
    grey: Float[np.ndarray, "h w *channels"], sharpening: Sharpening | None
) -> Float[np.ndarray, "h w *channels"]:
    """The picture with its edges lifted; as it is without sharpening."""
    if sharpening is None:
        return grey
    soft = cv2.GaussianBlur(grey, (0, 0), sharpening.radius_px)
    return grey + sharpening.amount * (grey - soft)


def quantised(
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
