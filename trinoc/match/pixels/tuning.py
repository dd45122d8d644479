"""Tuned constants of `measure_lines`, as one frozen value.

All were chosen by hand on rendered scenes of blocks, seeds 0 to 11 and 200 to 205, unless a comment
states otherwise. `benchmarks/measured_lines.py` shows their effect.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class PixelTuning:
    """Tuned constants of `measure_lines`: choice of the pixels, model of the edge, acceptance of a
    fit.
    """

    # Largest distance of a pixel from the line, px.
    search_radius_px: float = 8.0
    # Smallest distance of a pixel from the ends of the segment, in blur widths.
    end_widths: float = 1.5
    # Smallest distance of a pixel from other segments, in blur widths plus px.
    clear_widths: float = 2.0
    clear_px: float = 0.5
    # Half width of the core, in blur widths plus px. It is fitted before the levels are known.
    core_widths: float = 2.2
    core_px: float = 0.7
    # Columns outside the core are used if their mean is within this number of standard deviations.
    ring_sigmas: float = 3.0
    # Prior standard deviation of the slope of the levels across the edge, and along it, per px.
    across_slope: float = 0.07
    along_slope: float = 0.1
    # Prior standard deviation of the logarithm of a strip's blur about that of the image.
    blur_sigma: float = 0.1
    # Scale of the robust weight of a block, in standard deviations of its distance from the line.
    block_sigmas: float = 3.0
    # A block is excluded if its chi-square is too large by this number of standard deviations.
    block_chi_sigmas: float = 4.0
    # A strip is no clean step if its chi-square exceeds this factor of the typical one, if the
    # scatter of its blocks exceeds this factor of the noise, or if fewer of its blocks are accepted
    # than this share.
    max_chi: float = 2.0
    max_scatter: float = 3.0
    min_share: float = 0.4
    # Number of prior blocks without excess scatter in the estimate of a strip's scatter.
    prior_blocks: float = 4.0
    # Model error of the position of a clean step, px.
    floor_px: float = 0.01
    # A second edge too near to be resolved widens the profile and shifts it. `shift_per_widening`
    # is the standard deviation of the shift, in blur widths per logarithm of the widening. Strips
    # with a larger widening than `max_widening` are rejected.
    shift_per_widening: float = 2.5
    min_blur_spread: float = 0.02
    max_widening: float = 0.4
    # If a strip does not determine its blur, the widening of other strips of the image is assumed,
    # within these limits.
    hidden_widening: tuple[float, float] = (0.004, 0.05)
    # Largest standard deviation of an end, in blur widths. Above it, the edge is too faint.
    max_sigma_widths: float = 1.0
    # Largest displacement from the segment, in blur widths plus standard deviations. Above it, the
    # pixels show another edge.
    max_displacement_widths: float = 1.0
    max_displacement_sigmas: float = 4.0
    # Prior of the tail of the lines' errors, as `NoiseTuning.tail_of_images`, and smallest
    # posterior of the lines that estimate it.
    tail: tuple[float, float] = (3.0, 0.35)
    sure_posterior: float = 0.9
    # Significance of the test whether both estimates of a line agree.
    min_probability: float = 0.001
    # Smallest variance of their difference, as a share of the smaller variance.
    min_difference_share: float = 0.5
    # Smallest variance of a line's noise over that of the image. Noise grows with the light, and
    # before the position is known, misfit counts as noise.
    min_noise: float = 0.5
    # Largest standard deviation of the logarithm of the blur in strips that give the typical blur.
    precise_blur_sigma: float = 0.15


DEFAULT = PixelTuning()
