"""Quality of one image of the sheet, from the fit to its grey levels."""

import equinox as eqx

from trinoc.numerics.values import Value


class ImageQuality(Value):
    """Light, ink, blur and noise of one image of the sheet, estimated from its grey levels.

    Attributes
    ----------
    noise : standard deviation of the residuals, in grey levels.
    noise_floor : standard deviation of the noise in flat parts of the image, in grey levels. No fit
        can have smaller residuals. Equal to `noise` if the noise depends on the grey level.
    pixels : number of pixels used in the fit.
    pixels_cut : number of pixels near printed edges that were excluded, because they show something
        else.
    blur_px : sigma of the Gaussian blur of the lens.
    ink_spread_mm : distance by which the ink extends beyond the drawn edge.
    ink_over_paper : grey level of ink divided by the grey level of paper.
    found : descriptions of the effects of camera and light that the fit includes.
    """

    noise: float = eqx.field(static=True)
    noise_floor: float = eqx.field(static=True)
    pixels: int = eqx.field(static=True)
    pixels_cut: int = eqx.field(static=True)
    blur_px: float = eqx.field(static=True)
    ink_spread_mm: float = eqx.field(static=True)
    ink_over_paper: float = eqx.field(static=True)
    found: tuple[str, ...] = eqx.field(static=True)

    @property
    def reduced_chi_square(self) -> float:
        """Variance of the residuals divided by the variance of the image noise; 1 for a correct
        model.
        """
        return (self.noise / self.noise_floor) ** 2 if self.noise_floor > 0 else float("nan")
