"""Inequality of the tracks' errors: each track has a variance factor, with a distribution estimated
from all.

Each segment states a variance, and `noise_scale` corrects it for most segments. Some errors are
larger nevertheless, such as that of an edge beside a shadow. So the variance of a track is the
stated one times a factor of its own. The inverse of the factor has a gamma distribution with mean
1. Errors then have a Student distribution with nu degrees of freedom. The misfit of a track in n
views has a Fisher-Snedecor distribution with 2 (n - 2) and nu degrees of freedom. The tail is 1 /
nu: 0 for normal errors, larger for unequal ones. The estimate is its posterior mean over all sure
tracks (empirical Bayes).

Given its own misfit, the error of a track again has a Student distribution. It is narrower if
the views agree and wider if they disagree. The misfit of two views gives no information.
"""

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.selection import NoiseTuning
from trinoc.numerics.joins import group_sums
from trinoc.numerics.tails import chi_square_limit, chi_square_quantile

# numerical: grid of the tail. Below its smallest value, errors count as normal.
_SMALLEST_TAIL, _LARGEST_TAIL, _TAILS = 1e-3, 1.0, 40
# numerical: parameters of a line, and probability at which its ellipsoid is exact.
_PARAMETERS, _COVERAGE = 4, 0.95


def fit_tail(
    misfit: Float[np.ndarray, "t"],
    degrees: Int[np.ndarray, "t"],
    *,
    has_images: bool,
    tuning: NoiseTuning = DEFAULT.noise,
) -> float:
    """Estimate how unequal the tracks' errors are: the tail of a Student distribution.

    The tail is 1 / degrees of freedom of the distribution, 0 for normal errors.

    Parameters
    ----------
    misfit : (t,)
        Chi-square of the residuals of each track, for errors of the stated size.
    degrees : (t,)
        Degrees of freedom of each misfit, at least 1.
    has_images : bool
        True if the segments were detected in images. The prior then expects more unequal errors.
    tuning : NoiseTuning
        Tuned constants.
    """
    single_frame = np.zeros(len(misfit), dtype=np.int64)
    return float(fit_tails(misfit, degrees, single_frame, np.array([has_images]), tuning)[0])


def fit_tails(
    misfit: Float[np.ndarray, "t"],
    degrees: Int[np.ndarray, "t"],
    frame: Int[np.ndarray, "t"],
    has_images: Bool[np.ndarray, "f"],
    tuning: NoiseTuning = DEFAULT.noise,
) -> Float[np.ndarray, "f"]:
    """Estimate how unequal the tracks' errors are in each frame, (f,), as `fit_tail` does.

    The result is 1 / degrees of freedom of the errors' Student distribution, 0 for normal errors.
    """
    prior = np.where(has_images[:, None], tuning.tail_of_images, tuning.tail_otherwise)
    shape, mean = prior[:, :1], prior[:, 1:]
    tail = np.geomspace(_SMALLEST_TAIL, _LARGEST_TAIL, _TAILS)
    # The grid is uniform in log(tail), so all nodes have the same weight.
    log_posterior = shape * np.log(tail) - shape * tail / mean
    # Few values of `degrees` are different: each is evaluated once.
    freedom, (kinds, kind) = 1 / tail, np.unique(degrees, return_inverse=True)
    degrees_of_kind = kinds[:, None]
    log_likelihood = (
        scipy.special.gammaln((freedom + degrees_of_kind) / 2)
        - scipy.special.gammaln(freedom / 2)
        - degrees_of_kind / 2 * np.log(freedom)
    )
    log_likelihood = log_likelihood[kind] - ((freedom + degrees_of_kind) / 2)[kind] * np.log1p(
        misfit[:, None] * tail
    )
    log_posterior = log_posterior + group_sums(log_likelihood, frame, len(prior))
    weight = np.exp(log_posterior - log_posterior.max(axis=1, keepdims=True))
    return np.asarray(weight @ tail / weight.sum(axis=1))


def degrees_of_misfit(index: Int[np.ndarray, "t v"]) -> Int[np.ndarray, "t"]:
    """Return the degrees of freedom of each misfit: 2 for each view beyond the second, (t,)."""
    return 2 * np.maximum((index >= 0).sum(axis=1) - 2, 0)


def misfit_limit(
    probability: float, degrees: Int[np.ndarray, "*t"], tail: float
) -> Float[np.ndarray, "*t"]:
    """Return the value that a misfit exceeds with the given probability.

    `tail` is 1 / degrees of freedom of the errors' Student distribution. For tail 0, the result is
    the chi-square limit.
    """
    if tail < _SMALLEST_TAIL:
        return np.asarray(chi_square_limit(probability, degrees))
    return np.asarray(degrees * scipy.special.fdtri(degrees, 1 / tail, 1 - probability))


def student_log_density(
    misfit: Float[np.ndarray, "*t"], noise_tail: float
) -> Float[np.ndarray, "*t"]:
    """Log density of a misfit with two degrees of freedom, for Student-distributed errors.

    `noise_tail` is 1 / degrees of freedom of the Student distribution, 0 for normal errors.
    """
    tail = max(noise_tail, _SMALLEST_TAIL)
    return -np.log(2) - (1 / (2 * tail) + 1) * np.log1p(misfit * tail)


def variance_factor(
    misfit: Float[np.ndarray, "t"],
    degrees: Int[np.ndarray, "t"],
    tail: Float[np.ndarray, "t"] | float,
) -> Float[np.ndarray, "t"]:
    """Return the factor for the variance across each line that makes its 95 % ellipsoid valid,
    (t,).

    `degrees` are those of the misfit, 0 for two views. `tail` is the result of `fit_tail`. Given
    its misfit, the variance of a track has an inverse gamma distribution, and its error has a
    Student distribution. The factor is the squared 95 % limit of that distribution over that of the
    stated normal distribution.
    """
    prior_freedom = 1 / np.maximum(tail, _SMALLEST_TAIL)
    freedom = prior_freedom + degrees
    posterior = (prior_freedom + np.where(degrees > 0, misfit, 0.0)) / freedom
    factor = (
        posterior * _student_limit(_COVERAGE, freedom) / chi_square_quantile(_COVERAGE, _PARAMETERS)
    )
    return np.where(np.less(tail, _SMALLEST_TAIL), 1.0, factor)


def ellipsoid_limit(
    probability: float, degrees: Int[np.ndarray, "t"], tail: float
) -> Float[np.ndarray, "t"]:
    """Return the limit of each line's squared Mahalanobis distance from the true line, (t,).

    The distance is below the limit with the given probability. It refers to covariances multiplied
    by `variance_factor`, which makes them valid at 95 %.
    """
    limit_at_coverage = chi_square_quantile(_COVERAGE, _PARAMETERS)
    if tail < _SMALLEST_TAIL:
        return np.full(len(degrees), chi_square_quantile(probability, _PARAMETERS))
    freedom = 1 / tail + degrees
    return (
        limit_at_coverage
        * _student_limit(probability, freedom)
        / _student_limit(_COVERAGE, freedom)
    )


def _student_limit(probability: float, freedom: Float[np.ndarray, "t"]) -> Float[np.ndarray, "t"]:
    """Return the limit of each line's squared Mahalanobis distance for a probability, (t,).

    The errors have a Student distribution with `freedom` degrees of freedom.
    """
    kinds, kind = np.unique(freedom, return_inverse=True)
    return _PARAMETERS * scipy.special.fdtri(_PARAMETERS, kinds, probability)[kind]


def scale_covariance_of_lines(
    ends_mm: Float[np.ndarray, "t 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
    factor: Float[np.ndarray, "t"],
) -> Float[np.ndarray, "t 6 6"]:
    """Multiply the variances across each line by a factor, (t, 6, 6).

    The variances along the line stay, because they depend on where the detector ends a segment, not
    on noise.
    """
    step = ends_mm[:, 1] - ends_mm[:, 0]
    unit = step / np.linalg.norm(step, axis=1, keepdims=True)
    along = unit[:, :, None] * unit[:, None]
    stretch = np.zeros((len(ends_mm), 2, 3, 2, 3))
    for end in range(2):
        stretch[:, end, :, end] = along + np.sqrt(factor)[:, None, None] * (np.eye(3) - along)
    # Matrix products are twelve times as fast as one einsum over all indices.
    stretch = stretch.reshape(-1, 6, 6)
    return stretch @ covariance_mm2 @ stretch
