"""Tuned constants of the fit to the grey levels of pictures."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PhotometricTuning:
    """From the pose that circles gave to the one that explains the picture. Shown by
    benchmarks/real_pictures.py: errors over claimed and over least sigmas of each condition, and
    pictures that are silently wrong. By hand on these, where nothing else is said."""

    # Grey levels between paper and ink below which a picture shows nothing.
    least_contrast: float = 4.0
    # Pixels are looked at within so many sigmas of the blur from an edge, and so many px for an
    # error of the start.
    reach_sigmas: float = 3.0
    reach_px: float = 0.4
    # A picture moves its circles by hundredths of a px; further than this is another minimum.
    largest_move_px: float = 0.5

    # Shares of the contrast at which a residual loses its influence, step by step while the fit
    # finds its way: of an ideal camera, and of one that delivers something else.
    ideal_scales: tuple[float, ...] = (0.12, 0.07, 0.05)
    scales: tuple[float, ...] = (0.1, 0.07, 0.05, 0.05, 0.05)
    # Before these, where paper saturates: without them two of six pictures of a phone, 1.6 and 2.2
    # times overexposed, end nowhere or 60 sigmas off.
    blinded_scales: tuple[float, ...] = (0.15, 0.15, 0.15)

    # A residual beyond so many robust sigmas is no noise of a pixel that fits; a neighbourhood, a
    # square of this side in px, with a larger share of these shows an edge, a thumb, a glare.
    outlier_sigmas: float = 4.5
    outlier_share: float = 0.15
    neighbourhood_px: int = 7
    # Alone, a pixel must be farther off: one in 10^9 is lost for nothing.
    lone_sigmas: float = 6.0
    # Sum of a neighbourhood's residuals over its sigma for white noise, squared: noise that
    # neighbours share reaches a fifth of it, smooth light that is not the model's passes it.
    largest_common: float = 45.0

    # The largest grey level is where saturation cuts if this share of the pixels holds it; below
    # it by so many sigmas, saturation leaves the noise as it is.
    piled_share: float = 0.002
    clear_sigmas: float = 2.0
    # Standard deviation of a level that is always cut off, grey levels: of the model, as noise has
    # none.
    cut_off_levels: float = 0.2
    # Pixels that tell a mean or a variance.
    fewest_pixels: int = 30
    # A picture with a larger overshoot beside its edges (amplitude of the sharpening) is processed:
    # rendered phones have .44 to 3.5, webcams .2 to .5, cameras without software less than .03.
    # Correlated noise does not separate them: glare leaves as much of it as filters of phones do.
    processed_overshoot: float = 0.3
    # Neighbours share noise no further than this, px; a correlation below so many of its standard
    # deviations is none.
    shared_reach_px: int = 4
    significant_sigmas: float = 3.0
    # Least variance of what an edge says over that of white noise: sharpening lowers it to a half.
    least_spread: float = 0.4

    # Paper up to this share of ink, and ink from as much short of all on, are flat.
    flat_share: float = 0.1
    # Chi-square with n degrees of freedom is too large above n + 5 sqrt(2 n) + 12, once in 10^7 by
    # chance: these two. A group of unknowns is freed above 2 n (Akaike) and the second.
    chi_square_sigmas: float = 5.0
    evidence: float = 12.0
    # An ideal camera is refuted by more than this variance of residuals over that of flat parts, or
    # of one grey level over another's, and by this correlation of neighbours.
    largest_variance_ratio: float = 1.3
    largest_correlation: float = 0.05
    # Uneven light makes neighbours agree; noise raises the variance of their mean by no more than
    # this factor. Without it "faint glare" is not seen to be uneven light.
    largest_inflation: float = 5.0

    # Widths of priors on each block's light (a share of the polynomial's) and veil (grey levels),
    # (1, x, y) each; several times what benches have. The fourth is also a polynomial term's.
    local_widths: tuple[float, ...] = (0.5, 0.1, 0.1, 40.0, 20.0, 20.0)
    # Of the excess kurtosis of the blur and its sixth cumulant, over powers of its width.
    kurtosis_width: float = 0.5
    sixth_width: float = 2.0
    # Of the blur's variance along a direction, and along the picture's axes over diagonals, px^2;
    # of how straight a motion is, 1 or 0.
    motion_width_px2: float = 2.0
    axes_width_px2: float = 0.3
    line_width: float = 0.7
    # Of sharpening: the weight of its lobe, the lobe's additional blur (middle and width, px), and
    # how much further its ink reaches, mm.
    lobe_width: float = 1.0
    lobe_px: tuple[float, float] = (1.0, 0.5)
    lobe_width_mm: float = 0.15
    # Of the terms of a response beyond its bend.
    lift_width: float = 0.15
    contrast_width: float = 0.3
