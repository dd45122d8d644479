"""What a fit came to: whether it determines all that is free, and how well.

At the end of a fit the pulls of all shots, the gradients g_s of their chi-squares with each board
eliminated, cancel; one by one each has the covariance H_s, its own information. A board that
bends, a detector with a bias, or pictures that are not quite of one moment make whole shots pull
more, which no scatter of places within a picture tells.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.information import Information, compute_information
from trinoc.calib.problem.robust_fit import RobustFit
from trinoc.calib.problem.status import Status
from trinoc.calib.tuning.every_group import TUNING

# numerical: share of the information that stays in a direction which one shot alone determines.
_LEAST_LEFT = 0.02


class FitOutcome(NamedTuple):
    """How well the end of a fit is known.

    Fields
    ------
    status : how the fit ended.
    information : of the shots.
    covariance : (f, f) of the free steps of the head; 0 where they are not determined.
    variance_factor : of the shots' noise, which is in the covariance.
    """

    status: Status
    information: Information
    covariance: Float[np.ndarray, "f f"]
    variance_factor: float


def assess_fit(fit: RobustFit) -> FitOutcome:
    """The outcome of a fit; its covariance is enlarged where the shots disagree."""
    information = compute_information(fit.problem)
    if fit.is_held:
        information = with_pulls_after_step(information)
    observed = information.observability
    covariance = np.nan_to_num(observed.covariance)
    if observed.rank < len(information.free):
        return FitOutcome(Status.RANK_DEFICIENT, information, covariance, 1.0)
    factor = shot_scatter(information).variance_factor
    status = Status.CONVERGED if fit.converged else Status.NOT_CONVERGED
    known = known_information(information)
    enlarged = enlarge_covariance(covariance, factor, known)
    if factor > 1.0:
        enlarged = blend_with_jackknife(enlarged, covariance, information, factor)
    return FitOutcome(status, information, enlarged, factor)


def with_pulls_after_step(information: Information) -> Information:
    """The information with the pulls, to first order, at the end of a fit of all that is free.

    Where something was held, the pulls do not cancel: what they have in common is no scatter.
    """
    free = information.free
    covariance = np.nan_to_num(information.observability.covariance)
    step = covariance @ information.pulls[:, free].sum(axis=0)
    pulls = information.pulls - information.of_shot[:, :, free] @ step
    return information._replace(pulls=pulls)


def known_information(information: Information) -> Float[np.ndarray, "f f"]:
    """The prior's information without that on the board's shape, whose prior was estimated from
    residuals and is enlarged with them."""
    is_known = information.free < information.shape_first
    return information.prior * np.outer(is_known, is_known)


def blend_with_jackknife(
    enlarged: Float[np.ndarray, "f f"],
    covariance: Float[np.ndarray, "f f"],
    information: Information,
    factor: float,
) -> Float[np.ndarray, "f f"]:
    """Covariance of a fit whose shots disagree, in each direction as much as they do there.

    A factor F enlarges all sigmas alike, but a board that bends differently in every shot, say,
    moves focal lengths more than poses. The jackknife over shots J shows each direction by itself,
    from few shots and thus with noise; and it is singular where there are fewer shots S than
    parameters p of lenses and cameras. As estimates of covariances are in Bayes' theorem for an
    inverse Wishart prior, both are weighted by their degrees of freedom:

        (p F C + (S - 1) J) / (p + S - 1)

    enlarged : F C, apart from what was known. covariance : C.
    """
    parameters = int(np.sum(information.free < information.shape_first))
    shots = int(np.sum(np.any(information.pulls != 0, axis=1)))
    if shots < 2:
        return enlarged
    weight = (shots - 1) / (parameters + shots - 1)
    scattered = jackknife_covariance(covariance, information, factor)
    return (1.0 - weight) * enlarged + weight * scattered


def jackknife_covariance(
    covariance: Float[np.ndarray, "f f"], information: Information, factor: float
) -> Float[np.ndarray, "f f"]:
    """Covariance of a fit by the changes d_s that leaving out one shot s each makes.

        (S - 1) / S sum_s d_s d_s^T + C P C,    d_s = (H - H_s)^-1 g_s

    with the information H of everything, H_s and the gradient g_s of one shot, and the information
    P of what was known, on the board's shape `factor` times as much noise.

    Source: Bell and McCaffrey, "Bias reduction in standard errors for linear regression with
    multi-stage samples" (2002), estimator CR3.
    """
    free, prior = information.free, information.prior
    used = np.flatnonzero(np.any(information.pulls != 0, axis=1))
    of_shot = information.of_shot[used][:, free[:, None], free[None, :]]
    pulls = information.pulls[used][:, free]
    whole = of_shot.sum(axis=0) + prior
    scale = np.sqrt(np.diag(whole))
    whole, of_shot = whole / np.outer(scale, scale), of_shot / np.outer(scale, scale)
    # A direction that one shot alone determines has no gradient; the share keeps it from 0 / 0.
    without = (1.0 + _LEAST_LEFT) * whole - of_shot
    steps = np.linalg.solve(without, (pulls / scale)[..., None])[..., 0] / scale
    shots = len(used)
    known = known_information(information)
    noise = known + factor * (prior - known)
    return (shots - 1) / shots * steps.T @ steps + covariance @ noise @ covariance


class ShotScatter(NamedTuple):
    """factor : variance of the shots' pulls over what their places' sigmas say.
    sigma : of that factor, where it is 1.
    largest_sigmas : beyond so many sigmas of it the shots refute a factor of 1."""

    factor: float
    sigma: float
    largest_sigmas: float = TUNING.problem.shots_sigmas

    @property
    def variance_factor(self) -> float:
        """What the covariance is to be multiplied by: 1 unless the shots refute it."""
        return self.factor if self.factor > 1.0 + self.largest_sigmas * self.sigma else 1.0


def shot_scatter(
    information: Information, held: Bool[np.ndarray, "f"] | None = None
) -> ShotScatter:
    """The variance factor of the shots, the places of the board taken as they were found.

    held : which of `information.free` were held in the fit; the pulls are those after the step
        that sets them free.

    Free places would follow the noise of each, and many of them would hide what the shots' pulls
    at lenses and cameras say.

    sum_s g_s^T H^-1 g_s has the expectation sum_s tr H^-1 H_s - sum_s tr (H^-1 H_s)^2.
    """
    is_rig = information.free < information.shape_first
    free, of_shot = information.free[is_rig], information.of_shot
    covariance = np.nan_to_num(information.observability_of(is_rig).covariance)
    pulls, of_shot = information.pulls[:, free], of_shot[:, free[:, None], free[None, :]]
    if held is not None:
        # What was fitted does not pull.
        pulls = pulls - of_shot @ (covariance @ (held[is_rig] * pulls.sum(axis=0)))
    products = of_shot @ covariance
    squares = float(np.einsum("sij,sji->", products, products))
    expected = float(np.einsum("sii->", products)) - squares
    if expected < 0.5:
        return ShotScatter(1.0, float("inf"), information.tuning.problem.shots_sigmas)
    found = float(np.einsum("si,ij,sj->", pulls, covariance, pulls))
    sigma = float(np.sqrt(2.0 * squares) / expected)
    return ShotScatter(found / expected, sigma, information.tuning.problem.shots_sigmas)


def enlarge_covariance(
    covariance: Float[np.ndarray, "f f"], factor: float, prior: Float[np.ndarray, "f f"]
) -> Float[np.ndarray, "f f"]:
    """The covariance of a fit whose shots' noise has `factor` times its variance, and whose prior
    of information `prior` is what it is said to be."""
    return factor * covariance - (factor - 1.0) * covariance @ prior @ covariance
