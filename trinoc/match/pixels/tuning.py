"""Tuned constants of `measure_lines`, as one frozen value.

All were chosen by hand on rendered scenes of blocks, seeds 0 to 11 and 200 to 205, unless a
comment states otherwise. `benchmarks/measured_lines.py` shows their effect.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class PixelTuning:
    """Selection, model and acceptance of the pixels beside an edge."""

    # Pixels so far from the line are looked at, px,
    reach_px: float = 8.0
    # from so many blur widths inside the ends of the segment on,
    end_widths: float = 1.5
    # and so many widths, and px, away from other segments.
    clear_widths: float = 2.0
    clear_px: float = 0.5
    # So many widths, and px, to both sides are fitted before anything is known of the levels;
    core_widths: float = 2.2
    core_px: float = 0.7
    # further out, columns of a block whose mean lies within so many standard deviations.
    ring_sigmas: float = 3.0
    # Standard deviation of the slope of the levels across the edge, and along it, per px.
    across_slope: float = 0.07
    along_slope: float = 0.1
    # Of the logarithm of a strip's blur about the picture's, in the fit.
    blur_sigma: float = 0.1
    # A block counts less the more standard deviations it lies off the line,
    block_sigmas: float = 3.0
    # and is left out if its chi-square is so many standard deviations too large.
    block_chi_sigmas: float = 4.0
    # A strip is no clean step if its chi-square is this many times that of usual strips, if its
    # blocks scatter so much more than noise explains, or if less than this share of them counts.
    most_chi: float = 2.0
    most_scatter: float = 3.0
    least_share: float = 0.4
    # Blocks that scatter as noise explains, in the estimate of a strip's scatter.
    prior_blocks: float = 4.0
    # What the model leaves out of the place of a clean step, px.
    floor_px: float = 0.01
    # A second edge that is too near to be seen by itself widens the profile and moves it: the
    # standard deviation of that, in blur widths per logarithm of the widening; at most so much
    # widening is measured at all.
    widening_moves: float = 2.5
    least_blur_spread: float = 0.02
    most_widening: float = 0.4
    # Where a strip's own blur is not known, it is widened as others of the picture are: that much
    # at least, and at most.
    hidden_widening: tuple[float, float] = (0.004, 0.05)
    # Where an end is not known to this many blur widths, the pixels show no edge.
    most_sigma_widths: float = 1.0
    # A place this many blur widths and standard deviations from the segment is another edge's.
    most_moved_widths: float = 1.0
    most_moved_sigmas: float = 4.0
    # Tail of the errors of lines before it is known, as in `NoiseTuning.tail_of_pictures`; lines as
    # likely as this tell.
    tail: tuple[float, float] = (3.0, 0.35)
    sure: float = 0.9
    # Probability of a larger difference between both answers, if both are right.
    least_probability: float = 0.001
    # The variance of their difference is at least this share of the smaller variance.
    least_difference: float = 0.5
    # Noise grows with the light, and before the place is found misfit counts as noise: a line's own
    # variance, over the picture's, is this at least.
    least_noise: float = 0.5
    # A blur known this well, in its logarithm, tells what is usual.
    known_blur: float = 0.15


DEFAULT = PixelTuning()
