"""How much larger the segments' errors are than they state, learned from three views.

The residual that three views leave has a chi-square of two degrees of freedom where errors are as
stated. Its median over the triples that are surely right is nothing to the few that are wrong, and
to heavy tails.
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from trinoc.match.evidence import probability
from trinoc.match.selection.marginals import Selection
from trinoc.match.tuning import DEFAULT, NoiseTuning


def residual_scale(selections: Sequence[Selection], tuning: NoiseTuning = DEFAULT.noise) -> float:
    """Standard deviation of segments across themselves, over what they state.

    Few triples say little: as many as `prior_observations` that fit as stated count with them.
    """
    chi_square = np.concatenate([_confident(selection, tuning) for selection in selections])
    prior = chi2.ppf((np.arange(tuning.prior_observations) + 0.5) / tuning.prior_observations, 2)
    typical = np.median(np.concatenate([chi_square, prior])) / chi2.median(2)
    return float(np.clip(np.sqrt(typical), 1 / tuning.largest, tuning.largest))


def _confident(selection: Selection, tuning: NoiseTuning) -> np.ndarray:
    sure = probability(selection.posterior_log_odds) > tuning.sure
    return selection.candidates.chi_square[selection.taken & sure]
