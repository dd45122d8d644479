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
from jaxtyping import Bool, Float, Int
from scipy.special import fdtri, gammaln

from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.selection import NoiseTuning
from trinoc.numerics.joins import group_sums
from trinoc.numerics.tails import chi_square_limit, chi_square_quantile

# numerical: tails are looked for here. Below the least, errors are normal.
_LEAST_TAIL, _MOST_TAIL, _TAILS = 1e-3, 1.0, 40
# numerical: a line has four parameters, and its ellipsoid is to hold so often.
_PARAMETERS, _HELD = 4, 0.95


def fit_tail(
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
    one = np.zeros(len(misfit), dtype=np.int64)
    return float(fit_tails(misfit, degrees, one, np.array([of_pictures]), tuning)[0])


def fit_tails(
    misfit: Float[np.ndarray, "t"],
    degrees: Int[np.ndarray, "t"],
    frame: Int[np.ndarray, "t"],
    of_pictures: Bool[np.ndarray, "f"],
    tuning: NoiseTuning = DEFAULT.noise,
) -> Float[np.ndarray, "f"]:
    """`fit_tail` of the tracks of each frame."""
    known = np.where(of_pictures[:, None], tuning.tail_of_pictures, tuning.tail_otherwise)
    shape, mean = known[:, :1], known[:, 1:]
    tail = np.geomspace(_LEAST_TAIL, _MOST_TAIL, _TAILS)
    # Steps of the logarithm are even, so that each stands for as much as itself.
    log = shape * np.log(tail) - shape * tail / mean
    # Few degrees are different.
    freedom, (kinds, kind) = 1 / tail, np.unique(degrees, return_inverse=True)
    own = kinds[:, None]
    each = gammaln((freedom + own) / 2) - gammaln(freedom / 2) - own / 2 * np.log(freedom)
    each = each[kind] - ((freedom + own) / 2)[kind] * np.log1p(misfit[:, None] * tail)
    log = log + group_sums(each, frame, len(known))
    weight = np.exp(log - log.max(axis=1, keepdims=True))
    return np.asarray(weight @ tail / weight.sum(axis=1))


def degrees_of_misfit(index: Int[np.ndarray, "t v"]) -> Int[np.ndarray, "t"]:
    """Degrees of freedom of each track's misfit: two for each view beyond the second."""
    return 2 * np.maximum((index >= 0).sum(axis=1) - 2, 0)


def misfit_limit(
    probability: float, degrees: Int[np.ndarray, "*t"], tail: float
) -> Float[np.ndarray, "*t"]:
    """What a track's misfit exceeds with this probability: of chi-square where errors are equal."""
    if tail < _LEAST_TAIL:
        return np.asarray(chi_square_limit(probability, degrees))
    return np.asarray(degrees * fdtri(degrees, 1 / tail, 1 - probability))


def student_log_density(
    misfit: Float[np.ndarray, "*t"], noise_tail: float
) -> Float[np.ndarray, "*t"]:
    """Log density of a misfit of two degrees of freedom, of errors as unequal as `noise_tail`."""
    tail = max(noise_tail, _LEAST_TAIL)
    return -np.log(2) - (1 / (2 * tail) + 1) * np.log1p(misfit * tail)


def variance_factor(
    misfit: Float[np.ndarray, "t"],
    degrees: Int[np.ndarray, "t"],
    tail: Float[np.ndarray, "t"] | float,
) -> Float[np.ndarray, "t"]:
    """What to multiply a line's variance across by, so that its 95 % ellipsoid holds in 95 %.

    `degrees` is 0 where only two views show a line. The factor's posterior is an inverse gamma
    distribution; Student's distribution that follows is wider at 95 % than its scale says.
    """
    before = 1 / np.maximum(tail, _LEAST_TAIL)
    freedom = before + degrees
    posterior = (before + np.where(degrees > 0, misfit, 0.0)) / freedom
    factor = posterior * _student_limit(_HELD, freedom) / chi_square_quantile(_HELD, _PARAMETERS)
    return np.where(np.less(tail, _LEAST_TAIL), 1.0, factor)


def ellipsoid_limit(
    probability: float, degrees: Int[np.ndarray, "t"], tail: float
) -> Float[np.ndarray, "t"]:
    """Square of the Mahalanobis distance within which a line lies with this probability, under
    covariances that `variance_factor` has made right at 95 %."""
    held = chi_square_quantile(_HELD, _PARAMETERS)
    if tail < _LEAST_TAIL:
        return np.full(len(degrees), chi_square_quantile(probability, _PARAMETERS))
    freedom = 1 / tail + degrees
    return held * _student_limit(probability, freedom) / _student_limit(_HELD, freedom)


def _student_limit(probability: float, freedom: Float[np.ndarray, "t"]) -> Float[np.ndarray, "t"]:
    """Within which square of its distance a line of Student's distribution lies."""
    kinds, kind = np.unique(freedom, return_inverse=True)
    return _PARAMETERS * fdtri(_PARAMETERS, kinds, probability)[kind]


def scale_covariance_of_lines(
    ends_mm: Float[np.ndarray, "t 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
    factor: Float[np.ndarray, "t"],
) -> Float[np.ndarray, "t 6 6"]:
    """Covariances of ends with variances across their lines times a factor; along them as before:
    where a detector stops is no matter of noise."""
    way = ends_mm[:, 1] - ends_mm[:, 0]
    unit = way / np.linalg.norm(way, axis=1, keepdims=True)
    along = unit[:, :, None] * unit[:, None]
    stretch = np.zeros((len(ends_mm), 2, 3, 2, 3))
    for end in range(2):
        stretch[:, end, :, end] = along + np.sqrt(factor)[:, None, None] * (np.eye(3) - along)
    # Products of matrices: twelve times as fast as one sum over all indices.
    stretch = stretch.reshape(-1, 6, 6)
    return stretch @ covariance_mm2 @ stretch
