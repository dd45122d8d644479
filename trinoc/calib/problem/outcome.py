"""Outcome of a fit: status, determined parameters, and covariance with the scatter of the shots.

At the end of a fit the gradients g_s of the shots' chi-squares, with the poses of the boards
eliminated, sum to zero. Each has the covariance H_s, the information of its shot. A board that
bends, a biased detector, or images of slightly different moments make these gradients larger. The
scatter of the points within an image does not show this.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.information import Information, compute_information
from trinoc.calib.problem.robust_fit import RobustFit
from trinoc.calib.problem.status import Status
from trinoc.calib.tuning.every_group import TUNING

# numerical: share of the information that remains in a direction that only one shot determines.
_LEAST_LEFT = 0.02


class FitOutcome(NamedTuple):
    """Status and covariance at the end of a fit.

    Attributes
    ----------
    status : how the fit ended.
    information : information of the shots.
    covariance : (f, f) of the free steps of the head; 0 for undetermined directions.
    variance_factor : variance factor of the shots' noise, which the covariance contains.
    """

    status: Status
    information: Information
    covariance: Float[np.ndarray, "f f"]
    variance_factor: float


def assess_fit(fit: RobustFit) -> FitOutcome:
    """Outcome of a fit; its covariance is enlarged if the shots disagree."""
    information = compute_information(fit.problem)
    if fit.lenses_fixed:
        information = with_gradients_after_step(information)
    observed = information.observability
    covariance = np.nan_to_num(observed.covariance)
    if observed.rank < len(information.free):
        return FitOutcome(Status.RANK_DEFICIENT, information, covariance, 1.0)
    factor = shot_scatter(information).variance_factor
    status = Status.CONVERGED if fit.converged else Status.NOT_CONVERGED
    exact_prior = exact_prior_information(information)
    enlarged = enlarge_covariance(covariance, factor, exact_prior)
    if factor > 1.0:
        enlarged = blend_with_jackknife(enlarged, covariance, information, factor)
    return FitOutcome(status, information, enlarged, factor)


def with_gradients_after_step(information: Information) -> Information:
    """Information with the gradients, to first order, after a fit of all free steps.

    If parameters were fixed, the gradients do not sum to zero. Their common part is no scatter.
    """
    free = information.free
    covariance = np.nan_to_num(information.observability.covariance)
    step = covariance @ information.gradients[:, free].sum(axis=0)
    gradients = information.gradients - information.shot_information[:, :, free] @ step
    return information._replace(gradients=gradients)


def exact_prior_information(information: Information) -> Float[np.ndarray, "f f"]:
    """Prior information without that on the board's shape.

    The prior of the shape was estimated from residuals and is enlarged with them.
    """
    is_exact = information.free < information.first_shape_step
    return information.prior * np.outer(is_exact, is_exact)


def blend_with_jackknife(
    enlarged: Float[np.ndarray, "f f"],
    covariance: Float[np.ndarray, "f f"],
    information: Information,
    factor: float,
) -> Float[np.ndarray, "f f"]:
    """Covariance of a fit whose shots disagree, by the disagreement in each direction.

    A factor F enlarges all sigmas equally. But a board that bends differently in every shot, for
    instance, moves focal lengths more than poses. The jackknife over shots J shows each direction
    separately, but with noise, since shots are few; it is singular for fewer shots S than
    parameters p of lenses and cameras. As in Bayes' theorem with an inverse Wishart prior, both are
    weighted by their degrees of freedom:

        (p F C + (S - 1) J) / (p + S - 1)

    enlarged : F C, except for the prior. covariance : C.
    """
    parameters = int(np.sum(information.free < information.first_shape_step))
    shots = int(np.sum(np.any(information.gradients != 0, axis=1)))
    if shots < 2:
        return enlarged
    weight = (shots - 1) / (parameters + shots - 1)
    scattered = jackknife_covariance(covariance, information, factor)
    return (1.0 - weight) * enlarged + weight * scattered


def jackknife_covariance(
    covariance: Float[np.ndarray, "f f"], information: Information, factor: float
) -> Float[np.ndarray, "f f"]:
    """Covariance of a fit by the changes d_s of the solution without one shot s.

        (S - 1) / S sum_s d_s d_s^T + C P C,    d_s = (H - H_s)^-1 g_s

    H is the information of everything, H_s and g_s are information and gradient of one shot. P is
    the prior information; the noise of its part on the board's shape is multiplied by `factor`.

    Source: Bell and McCaffrey, "Bias reduction in standard errors for linear regression with
    multi-stage samples" (2002), estimator CR3.
    """
    free, prior = information.free, information.prior
    used = np.flatnonzero(np.any(information.gradients != 0, axis=1))
    shot_information = information.shot_information[used][:, free[:, None], free[None, :]]
    gradients = information.gradients[used][:, free]
    total = shot_information.sum(axis=0) + prior
    scale = np.sqrt(np.diag(total))
    total, shot_information = (
        total / np.outer(scale, scale),
        shot_information / np.outer(scale, scale),
    )
    # A direction that only one shot determines has no gradient; the share avoids 0 / 0.
    without_shot = (1.0 + _LEAST_LEFT) * total - shot_information
    steps = np.linalg.solve(without_shot, (gradients / scale)[..., None])[..., 0] / scale
    shots = len(used)
    exact_prior = exact_prior_information(information)
    noise = exact_prior + factor * (prior - exact_prior)
    return (shots - 1) / shots * steps.T @ steps + covariance @ noise @ covariance


class ShotScatter(NamedTuple):
    """Scatter of the shots' gradients.

    factor : variance of the gradients over that expected from the sigmas of the board points.
    sigma : standard deviation of the factor for a true value of 1.
    largest_sigmas : deviation from 1, in sigmas, above which the shots contradict a factor of 1.
    """

    factor: float
    sigma: float
    largest_sigmas: float = TUNING.problem.shots_sigmas

    @property
    def variance_factor(self) -> float:
        """Factor of the covariance: `factor` if the shots contradict 1, else 1."""
        return self.factor if self.factor > 1.0 + self.largest_sigmas * self.sigma else 1.0


def shot_scatter(
    information: Information, fixed: Bool[np.ndarray, "f"] | None = None
) -> ShotScatter:
    """Variance factor of the shots, with the board's shape fixed.

    Free board points would follow the noise of each point and hide the scatter of lenses and
    cameras.

    fixed : (f,) mask of `information.free` that the fit fixed. The gradients are those
        after the step that frees them.

    sum_s g_s^T H^-1 g_s has the expectation sum_s tr H^-1 H_s - sum_s tr (H^-1 H_s)^2.
    """
    is_rig = information.free < information.first_shape_step
    free, shot_information = information.free[is_rig], information.shot_information
    covariance = np.nan_to_num(information.observability_of(is_rig).covariance)
    gradients, shot_information = (
        information.gradients[:, free],
        shot_information[:, free[:, None], free[None, :]],
    )
    if fixed is not None:
        # Fitted parameters have no gradient.
        gradients = gradients - shot_information @ (
            covariance @ (fixed[is_rig] * gradients.sum(axis=0))
        )
    products = shot_information @ covariance
    squares = float(np.einsum("sij,sji->", products, products))
    expected = float(np.einsum("sii->", products)) - squares
    if expected < 0.5:
        return ShotScatter(1.0, float("inf"), information.tuning.problem.shots_sigmas)
    observed = float(np.einsum("si,ij,sj->", gradients, covariance, gradients))
    sigma = float(np.sqrt(2.0 * squares) / expected)
    return ShotScatter(observed / expected, sigma, information.tuning.problem.shots_sigmas)


def enlarge_covariance(
    covariance: Float[np.ndarray, "f f"], factor: float, prior: Float[np.ndarray, "f f"]
) -> Float[np.ndarray, "f f"]:
    """Covariance of a fit with `factor` times the noise variance and an unchanged prior
    information.
    """
    return factor * covariance - (factor - 1.0) * covariance @ prior @ covariance
