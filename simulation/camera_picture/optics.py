"""From radiance to the light on each pixel: the lens's blur, motion, the pixel's box.

All three are convolutions, so that they are products of transfer functions; frequencies are
in cycles per pixel.
"""

import cv2
import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float
from scipy.special import j1

from simulation.camera_picture.scene import Radiance
from trinoc.errors import InputError


class Optics(eqx.Module):
    """Blur of a picture by lens, defocus and motion.

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

    @property
    def reach_px(self) -> int:
        """Distance in pixels to which light counts: six sigmas, and the pixel's half."""
        return int(np.ceil(6 * self.blur_px + self.defocus_px + self.motion_px / 2 + 0.5))

    @property
    def rms_px(self) -> float:
        """Rms width along one axis, the mean over all directions: the Gaussian as wide."""
        variance = self.blur_px**2 + self.defocus_px**2 / 4 + self.motion_px**2 / 24
        return float(np.sqrt(variance))


def irradiance(radiance: Radiance, optics: Optics) -> Float[np.ndarray, "h w"]:
    """Light on each pixel of the picture, in the unit of the radiance; the margin is cut off.

    Raises InputError for a radiance whose margin the blur reaches beyond.
    """
    reach, margin = optics.reach_px, radiance.margin_px
    if reach > margin:
        raise InputError(
            f"This blur reaches {reach} pixels, but {margin} are drawn round the picture: blur it "
            "less, or draw more."
        )
    height, width = radiance.by_pixel.shape
    row, column = radiance.divided.T
    cells = radiance.by_cell.shape[1]
    weights = spread_of_cells(optics, cells)
    # What a pixel sends to those about it, as if it were all one level; `filter2D` correlates.
    pixel_spread = np.ascontiguousarray(weights.sum(axis=(2, 3))[::-1, ::-1])
    light = np.zeros((height + 2 * reach, width + 2 * reach))
    light[reach : reach + height, reach : reach + width] = cv2.filter2D(
        radiance.by_pixel, -1, pixel_spread
    )
    # And what the cells of divided pixels send beyond that.
    excess = (radiance.by_cell - radiance.by_pixel[row, column, None, None]).reshape(len(row), -1)
    for down, of_row in enumerate(weights):
        sent = excess @ of_row.reshape(2 * reach + 1, -1).T
        for across in range(2 * reach + 1):
            # Each divided pixel is listed once, so that no sum of this line is lost.
            light[row + down, column + across] += sent[:, across]
    cut = reach + margin
    return light[cut : height + 2 * reach - cut, cut : width + 2 * reach - cut]


def spread_of_cells(optics: Optics, cells: int) -> Float[np.ndarray, "k k cells cells"]:
    """Light from each cell of a pixel to pixels up to `reach_px` rows and columns away."""
    reach = optics.reach_px
    side = (2 * reach + 1) * cells
    fu = np.fft.fftfreq(side, 1 / cells)[None, :]
    transfer = pixel_transfer(fu, cells) * pixel_transfer(fu.T, cells)
    kernel = np.fft.ifft2(transfer * lens_transfer(optics, fu, fu.T)).real
    # From cell a of a pixel to the first cell of one d pixels on there are d cells - a.
    away = (np.arange(-reach, reach + 1)[:, None] * cells - np.arange(cells)) % side
    return kernel[away[:, None, :, None], away[None, :, None, :]]


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
    """Transfer function of a Gaussian, along one axis."""
    return np.exp(-2 * (np.pi * sigma_px * frequency) ** 2)


def disc_transfer(frequency: Float[np.ndarray, "*n"], radius_px: float) -> Float[np.ndarray, "*n"]:
    """Transfer function of a disc of even light, by the length of the frequency.

    It is 2 J1(x) / x (Goodman, 2.1.6).
    """
    x = np.maximum(2 * np.pi * radius_px * frequency, 1e-12)
    return 2 * j1(x) / x


def pixel_transfer(frequency: Float[np.ndarray, "*n"], cells: int) -> Complex[np.ndarray, "*n"]:
    """Transfer function of the mean over a pixel's cells along one axis, from its first cell on.

    The radiance is a mean over each cell already; the mean over cells makes that the pixel's.
    """
    offset = np.arange(cells) / cells
    return np.mean(np.exp(2j * np.pi * frequency[..., None] * offset), axis=-1)
