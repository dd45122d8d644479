"""The darker side of a line in space is on one side in all pictures: evidence, never a gate."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.tuning import DEFAULT, EvidenceTuning


def polarity_evidence(
    polarity: Float[np.ndarray, "v n"],
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Float[np.ndarray, "m"]:
    """Log likelihood ratio of the members' darker sides, as of one line over clutter's.

    `polarity` is +1 or -1 along the way from a segment's first end, 0 where not known.
    """
    views = np.arange(polarity.shape[0])
    along = np.where(interval[..., 1] > interval[..., 0], 1.0, -1.0)
    side = np.where(index >= 0, polarity[views, index] * along, 0.0)
    right, left = (side > 0).sum(axis=1), (side < 0).sum(axis=1)
    turned, straight = tuning.turned_share, 1 - tuning.turned_share
    as_one = straight**right * turned**left + straight**left * turned**right
    return np.log(as_one) + (right + left - 1) * np.log(2)
