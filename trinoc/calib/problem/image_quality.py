"""What the fit to the grey levels of one image of the sheet has estimated of the image."""

import equinox as eqx

from trinoc.numerics.values import Value


class ImageQuality(Value):
    """Light, ink, blur and noise of one image of the sheet, from the fit to its grey levels.

    Fields
    ------
    noise : standard deviation of the residuals, grey levels.
    noise_floor : the same of the picture's flat parts, which no fit can go below; `noise` itself
        where it depends on the grey level, so that flat parts do not tell.
    pixels : number of pixels that took part.
    pixels_cut : number of pixels near an edge of the sheet that show something else.
    blur_px : sigma of the lens's blur.
    ink_spread_mm : by which ink reaches beyond the drawing.
    ink_over_paper : grey level of ink over that of paper.
    found : what the picture shows of its camera and its light, in words.
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
        """Variance of the residuals over that of the noise: 1 for a model that is right."""
        return (self.noise / self.noise_floor) ** 2 if self.noise_floor > 0 else float("nan")
