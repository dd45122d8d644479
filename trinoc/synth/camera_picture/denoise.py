"""How cameras smooth noise away, on the linear signal; each channel by itself."""

from typing import Protocol, runtime_checkable

import cv2
import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.synth.camera_picture.sensor import BLACK, GREY_LEVELS

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
    """Pixels that look alike averaged (Buades, Coll and Morel, doi 10.5201/ipol.2011.bcm_nlm).

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


def denoised(
    signal: Float[np.ndarray, "h w *channels"], denoiser: Denoiser | None
) -> Float[np.ndarray, "h w *channels"]:
    """The signal with less noise; as it is without a denoiser."""
    if denoiser is None:
        return signal
    if signal.ndim == 2:
        return denoiser.channel(signal)
    channels = [denoiser.channel(signal[..., k]) for k in range(signal.shape[2])]
    return np.stack(channels, axis=-1)
