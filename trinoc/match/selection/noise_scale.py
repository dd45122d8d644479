"""How much larger the segments' errors are than they state, learned from three views.

The residual that three views leave has a chi-square of two degrees of freedom where errors are as
stated. Its median over the triples that are surely right is nothing to the few that are wrong, and
to heavy tails.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from trinoc.match.evidence import probability
from trinoc.match.selection.marginals import Selection
from trinoc.match.tuning import DEFAULT, NoiseTuning
from trinoc.numerics import group_medians


def residual_scale(
    selections: Sequence[Selection], frames: int = 1, tuning: NoiseTuning = DEFAULT.noise
) -> Float[np.ndarray, "f"]:
    """Standard deviation of segments across themselves, over what they state, of each frame.

    Few triples say little: as many as `prior_observations` that fit as stated count with them.
    """
    share = (np.arange(tuning.prior_observations) + 0.5) / tuning.prior_observations
    prior = -2 * np.log1p(-share)  # the quantiles of chi-square with two degrees of freedom
    chi_square, frame = [np.tile(prior, frames)], [np.repeat(np.arange(frames), len(prior))]
    for selection in selections:
        sure = selection.taken & (probability(selection.posterior_log_odds) > tuning.sure)
        chi_square.append(selection.candidates.chi_square[sure])
        every = np.zeros(len(sure), int) if selection.frame is None else selection.frame
        frame.append(every[sure])
    typical = group_medians(np.concatenate(chi_square), np.concatenate(frame), frames)
    scale = np.sqrt(typical / (2 * np.log(2)))
    return np.clip(scale, 1 / tuning.largest, tuning.largest)
