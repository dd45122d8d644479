"""How unequal the errors of lines are: a variance factor of each track, learned from all of them.

Segments state a variance each, and `noise_scale` says how large errors are for most of them. Some
are larger all the same, as where a shadow lies beside the edge. So the variance of a track is what
is stated times a factor of its own, whose inverse has a gamma distribution with mean 1. Errors
then have Student's distribution, and the misfit of a track in n views that of Fisher and Snedecor,
with 2 (n - 2) and with so many degrees of freedom as the factors leave: few where they differ much,
infinitely many where all errors are normal. One over these degrees of freedom is the tail. Its
posterior mean over all tracks that are surely right is taken (empirical Bayes).

Given its own misfit, the error of a track has Student's distribution, too: where the views agree
narrower, where they disagree wider, and of two views nobody knows.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.special import fdtri, gammaln

from trinoc.match.tuning import DEFAULT, NoiseTuning
from trinoc.numerics import chi_square_quantile

# Tails are looked for here. Below the least, errors are normal.
_LEAST_TAIL, _MOST_TAIL, _TAILS = 1e-3, 1.0, 40
# A line has four parameters, and its ellipsoid is to hold so often.
_PARAMETERS, _HELD = 4, 0.95


def learned_tail(
    misfit: Float[np.ndarray, "t"],
    degrees: Int[np.ndarray, "t"],
    *,
    of_pictures: bool,
    tuning: NoiseTuning = DEFAULT.noise,
) -> float:
    """One over the degrees of freedom of the errors' distribution: 0 where they are normal.

    Parameters
    ----------
    misfit : chi-square by which the views of each track disagree, of errors as most have them.
    degrees : of freedom of it, 1 or more.
    of_pictures : whether a detector found the segments in pictures: their errors are known to be
        unequal. Of others it is to be shown.
    """
    shape, mean = tuning.tail_of_pictures if of_pictures else tuning.tail_otherwise
    tail = np.geomspace(_LEAST_TAIL, _MOST_TAIL, _TAILS)
    # Steps of the logarithm are even, so that each stands for as much as itself.
    log = shape * np.log(tail) - shape * tail / mean
    freedom, own = 1 / tail, np.asarray(degrees)[:, None]
    each = gammaln((freedom + own) / 2) - gammaln(freedom / 2) - own / 2 * np.log(freedom)
    each = each - (freedom + own) / 2 * np.log1p(misfit[:, None] * tail)
    log = log + each.sum(axis=0)
    weight = np.exp(log - log.max())
    return float(weight @ tail / weight.sum())


def degrees_of_misfit(index: Int[np.ndarray, "t v"]) -> Int[np.ndarray, "t"]:
    """Degrees of freedom of each track's misfit: two for each view beyond the second."""
    return 2 * np.maximum((index >= 0).sum(axis=1) - 2, 0)


def variance_factor(
    misfit: Float[np.ndarray, "t"], degrees: Int[np.ndarray, "t"], tail: float
) -> Float[np.ndarray, "t"]:
    """What to multiply a line's variance across by, so that its 95 % ellipsoid holds in 95 %.

    `degrees` is 0 where only two views show a line. The factor's posterior is an inverse gamma
    distribution; Student's distribution that follows is wider at 95 % than its scale says.
    """
    if tail < _LEAST_TAIL:
        return np.ones(len(misfit))
    freedom = 1 / tail + degrees
    posterior = (1 / tail + np.where(degrees > 0, misfit, 0.0)) / freedom
    largest = _PARAMETERS * fdtri(_PARAMETERS, freedom, _HELD)
    return posterior * largest / chi_square_quantile(_HELD, _PARAMETERS)


def scaled_across(
    ends_mm: Float[np.ndarray, "t 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
    factor: Float[np.ndarray, "t"],
) -> Float[np.ndarray, "t 6 6"]:
    """Covariances of ends with variances across their lines times a factor; along them as before:
    where a detector stops is no matter of noise."""
    way = ends_mm[:, 1] - ends_mm[:, 0]
    unit = way / np.linalg.norm(way, axis=1, keepdims=True)
    along = unit[:, :, None] * unit[:, None]
    stretch = along + np.sqrt(factor)[:, None, None] * (np.eye(3) - along)
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    blocks = np.einsum("tij,tejfk,tlk->teifl", stretch, blocks, stretch)
    return blocks.reshape(-1, 6, 6)
