"""How probable cameras and matches are together, so that one matching can be held against another.

Of a line's n fragments any two agree, whatever the cameras: they place the line. Each further
one is either of this line, with the normal density of its squared distance s, or clutter that
chance put there, whose density is that of a right one c sigma off (c^2 is the ceiling of the
robust loss rho). Against the same fragments all being clutter the line gains, in log likelihood,

    1/2 max(0, (n - 2) c^2 - sum over its fragments of rho(s)),

nothing in two views and nothing where a fragment is wrong, and the sheet takes half the squared
distance by which the cameras left its estimate. What is common to all matchings of one set of
segments is left out. Sigmas are those claimed, the same for all that are compared.
"""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.numerics import AbstractBoundedLoss


def log_posterior(
    squared: Float[np.ndarray, "t v"],
    seen: Bool[np.ndarray, "t v"],
    sheet_chi_square: float,
    loss: AbstractBoundedLoss,
) -> float:
    """Log posterior of cameras and tracks against cameras at the sheet's estimate and no track.

    `squared` are the fragments' squared distances from their lines in sigmas, which `loss` bounds.
    """
    costs = np.where(seen, loss.rho(squared), 0.0).sum(axis=1)
    gains = (seen.sum(axis=1) - 2) * loss.ceiling - costs
    return 0.5 * (float(np.maximum(gains, 0.0).sum()) - sheet_chi_square)
