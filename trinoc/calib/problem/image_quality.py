"""Quality of one image of the sheet, from the fit to its grey levels."""

import equinox as eqx

from trinoc.numerics.values import Value


class ImageQuality(Value):
    """Light, ink, blur and noise of one image of the sheet, from the fit to its grey levels.

    Attributes
    ----------
    noise : standard deviation of the residuals, grey levels.
    noise_floor : the same in flat parts of the image, which no fit can go below; equal to `noise`
        if the noise depends on the grey level.
    pixels : number of used pixels.
    pixels_cut : number of pixels near an edge of the sheet that show something else.
    blur_px : sigma of the lens's blur.
    ink_spread_mm : distance by which ink extends beyond the drawing.
    ink_over_paper : grey level of ink relative to that of paper.
    found : effects of camera and light that the fit includes, in words.
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
        """Variance of the residuals over that of the noise; 1 for a correct model."""
        return (self.noise / self.noise_floor) ** 2 if self.noise_floor > 0 else float("nan")
