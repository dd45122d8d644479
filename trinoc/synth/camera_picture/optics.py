"""From radiance to the light on each pixel: the lens's blur, motion, the pixel's box.

All three are convolutions, so that they are products of transfer functions; frequencies are
in cycles per pixel.
"""

import equinox as eqx
import numpy as np
import scipy.fft
from jaxtyping import Complex, Float
from scipy.special import j1

from trinoc.errors import InputError
from trinoc.synth.camera_picture.scene import CELLS, MARGIN_PX


class Optics(eqx.Module):
    """What blurs a picture.

    Fields
    ------
    blur_px : sigma of the lens's Gaussian.
    defocus_px : radius of the disc that an unfocused point becomes.
    motion_px : length of the path of the picture while it is exposed.
    motion_deg : its direction, from u toward v.
    """

    blur_px: float = 0.7
    defocus_px: float = 0.0
    motion_px: float = 0.0
    motion_deg: float = 0.0

    def __check_init__(self) -> None:
        if self.reach_px > MARGIN_PX:
            raise InputError(
                f"This blur reaches {self.reach_px:.0f} pixels, but at most {MARGIN_PX} are "
                "drawn round a picture: blur it less."
            )

    @property
    def reach_px(self) -> float:
        """How far away a point still counts."""
        return 5 * self.blur_px + self.defocus_px + self.motion_px / 2

    @property
    def rms_px(self) -> float:
        """Rms width along one axis, the mean over all directions: the Gaussian as wide."""
        variance = self.blur_px**2 + self.defocus_px**2 / 4 + self.motion_px**2 / 24
        return float(np.sqrt(variance))


def irradiance(
    radiance: Float[np.ndarray, "h_cells w_cells"], optics: Optics
) -> Float[np.ndarray, "h w"]:
    """Light on each pixel of the picture, in the unit of the radiance; the margin is cut off."""
    fu = scipy.fft.rfftfreq(radiance.shape[1], 1 / CELLS)[None, :]
    fv = scipy.fft.fftfreq(radiance.shape[0], 1 / CELLS)[:, None]
    spectrum = np.asarray(scipy.fft.rfft2(radiance))
    spectrum *= pixel_transfer(fu)
    spectrum *= pixel_transfer(fv)
    spectrum *= lens_transfer(optics, fu, fv)
    return _sampled(spectrum, radiance.shape[1])[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]


def lens_transfer(
    optics: Optics, fu: Float[np.ndarray, "*m"], fv: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "..."]:
    """Transfer function of lens and motion, for frequencies that broadcast together."""
    transfer = gaussian_transfer(fu, optics.blur_px) * gaussian_transfer(fv, optics.blur_px)
    if optics.defocus_px:
        transfer = transfer * disc_transfer(np.hypot(fu, fv), optics.defocus_px)
    if optics.motion_px:
        angle = np.radians(optics.motion_deg)
        along = np.cos(angle) * fu + np.sin(angle) * fv
        transfer = transfer * np.sinc(optics.motion_px * along)
    return transfer


def gaussian_transfer(
    frequency: Float[np.ndarray, "*n"], sigma_px: float
) -> Float[np.ndarray, "*n"]:
    """Of a Gaussian, along one axis."""
    return np.exp(-2 * (np.pi * sigma_px * frequency) ** 2)


def disc_transfer(frequency: Float[np.ndarray, "*n"], radius_px: float) -> Float[np.ndarray, "*n"]:
    """Of a disc of even light, by the length of the frequency: 2 J1(x) / x (Goodman, 2.1.6)."""
    x = np.maximum(2 * np.pi * radius_px * frequency, 1e-12)
    return 2 * j1(x) / x


def pixel_transfer(frequency: Float[np.ndarray, "*n"]) -> Complex[np.ndarray, "*n"]:
    """Of the mean over a pixel's cells along one axis, from its first cell on.

    The radiance is a mean over each cell already; the mean over cells makes that the pixel's.
    """
    offset = np.arange(CELLS) / CELLS
    return np.mean(np.exp(2j * np.pi * frequency[..., None] * offset), axis=-1)


def _sampled(spectrum: Complex[np.ndarray, "h_cells f"], width: int) -> Float[np.ndarray, "h w"]:
    """The picture at every CELLS-th cell: rows by folding their spectrum, columns by choice."""
    rows, frequencies = spectrum.shape
    folded = spectrum.reshape(CELLS, rows // CELLS, frequencies).mean(axis=0)
    half = scipy.fft.ifft(folded, axis=0)
    return np.asarray(scipy.fft.irfft(half, n=width, axis=1))[:, ::CELLS]
