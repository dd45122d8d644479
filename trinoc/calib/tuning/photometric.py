"""Tuned constants of the fit to the grey levels of images."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PhotometricTuning:
    """Tuned constants of the fit to grey levels, which refines a pose from circles.

    Check with benchmarks/real_pictures.py: errors divided by reported sigmas and by smallest
    possible sigmas, by condition, and the number of images with a wrong result and no warning.
    Unless a comment gives another source, values were chosen by hand on this benchmark.
    """

    # Smallest contrast between paper and ink, grey levels.
    least_contrast: float = 4.0
    # Half the width of the band of pixels along an edge: in sigmas of the blur, plus px for errors
    # of the initial pose.
    reach_sigmas: float = 3.0
    reach_px: float = 0.4
    # Largest change of a circle's position by the fit, px. Usual changes are some hundredths; a
    # larger one indicates another minimum.
    largest_move_px: float = 0.5

    # Scale of the robust loss in each round, as a share of the contrast: for an ideal camera, and
    # for a camera whose software changes the image.
    ideal_scales: tuple[float, ...] = (0.12, 0.07, 0.05)
    scales: tuple[float, ...] = (0.1, 0.07, 0.05, 0.05, 0.05)
    # Additional first rounds if the paper saturates. Without them, two of six images of a phone,
    # overexposed 1.6 and 2.2 times, fail or are wrong by 60 sigmas.
    saturated_scales: tuple[float, ...] = (0.15, 0.15, 0.15)

    # A residual above this many robust sigmas is an outlier.
    outlier_sigmas: float = 4.5
    # Largest share of outliers in a neighbourhood. Above it, the neighbourhood shows something
    # else, such as a thumb, an edge of an object or glare.
    outlier_share: float = 0.15
    # Side of a square neighbourhood, px.
    neighbourhood_px: int = 7
    # Limit for a single pixel, in robust sigmas: noise exceeds it once in 10^9 pixels.
    lone_sigmas: float = 6.0
    # Largest squared sum of a neighbourhood's residuals over its sigma for white noise. Correlated
    # noise reaches a fifth of it. Smooth light outside the model exceeds it.
    largest_common: float = 45.0

    # Share of the pixels at the largest grey level above which this level is the saturation limit.
    piled_share: float = 0.002
    # Distance below saturation, in sigmas of the noise, at which saturation no longer changes the
    # noise.
    clear_sigmas: float = 2.0
    # Standard deviation assumed for a fully saturated level, grey levels: an error of the model,
    # because the noise is cut off.
    cut_off_levels: float = 0.2
    # Fewest pixels from which a mean or a variance is estimated.
    fewest_pixels: int = 30
    # Amplitude of the overshoot beside edges above which the camera's software has sharpened the
    # image. Rendered phones have .44 to 3.5, webcams .2 to .5, cameras without software below .03.
    # Correlated noise does not separate them: glare causes as much as a phone's filters.
    processed_overshoot: float = 0.3
    # Largest distance at which neighbouring pixels have correlated noise, px.
    shared_reach_px: int = 4
    # A correlation below this many of its standard deviations is set to 0.
    significant_sigmas: float = 3.0
    # Smallest variance of an edge's position over that for white noise. Sharpening lowers it to a
    # half.
    least_spread: float = 0.4

    # Regions whose share of ink is below this, or above one minus this, are flat.
    flat_share: float = 0.1
    # A chi-square with n degrees of freedom is too large above n + 5 sqrt(2 n) + 12: once in 10^7
    # by chance. A group of unknowns is freed if chi-square improves by over 2 n (Akaike) + 12.
    chi_square_sigmas: float = 5.0
    evidence: float = 12.0
    # The ideal camera model is rejected above this ratio of the variance of residuals to that of
    # flat regions, or of one grey level to another, or above this correlation of neighbours.
    largest_variance_ratio: float = 1.3
    largest_correlation: float = 0.05
    # Uneven light correlates neighbouring residuals. Noise raises the variance of their mean by
    # this factor at most. Without it, the condition "faint glare" is not recognised as uneven
    # light.
    largest_inflation: float = 5.0

    # Prior standard deviations of each block's light (relative to the polynomial) and veil (grey
    # levels), terms (1, x, y) of each: several times the usual values of laboratory set-ups. The
    # fourth also applies to a term of the polynomial.
    local_widths: tuple[float, ...] = (0.5, 0.1, 0.1, 40.0, 20.0, 20.0)
    # Prior standard deviations of the blur's excess kurtosis, and of its sixth cumulant, over
    # powers of its width.
    kurtosis_width: float = 0.5
    sixth_width: float = 2.0
    # Prior standard deviations of the blur's additional variance along one direction, and along
    # the image's axes compared with the diagonals, px^2.
    motion_width_px2: float = 2.0
    axes_width_px2: float = 0.3
    # Prior standard deviation of the straightness of a motion, which is 0 or 1.
    line_width: float = 0.7
    # Priors of sharpening: standard deviation of its amplitude; mean and standard deviation of the
    # additional blur of its lobe, px; standard deviation of the lobe's additional spread of ink,
    # mm.
    lobe_width: float = 1.0
    lobe_px: tuple[float, float] = (1.0, 0.5)
    lobe_width_mm: float = 0.15
    # Prior standard deviations of the response's lift and contrast terms.
    lift_width: float = 0.15
    contrast_width: float = 0.3
