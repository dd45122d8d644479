"""Outcome of a fit: status, and covariance that includes the scatter of the shots.

At the end of a fit the gradients g_s of the shots' chi-squares, with the board poses eliminated,
sum to zero. Each has the covariance H_s, the information of its shot. A board that bends, a biased
detector, or images of slightly different moments make these gradients larger. The scatter of the
points within an image does not show this.
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
    """Status and covariance of a finished fit.

    Attributes
    ----------
    status : how the fit ended.
    information : information of the shots about the shared parameters (lenses, cameras, board
        shape).
    covariance : (f, f) covariance of the f estimated shared parameters; 0 in undetermined
        directions. It contains `variance_factor`.
    variance_factor : noise variance estimated from the scatter between the shots, divided by the
        variance that the point sigmas state; 1 unless significantly larger.
    """

    status: Status
    information: Information
    covariance: Float[np.ndarray, "f f"]
    variance_factor: float


def assess_fit(fit: RobustFit) -> FitOutcome:
    """Determine status and covariance of a fit. The covariance is enlarged if the scatter between
    the shots exceeds the point sigmas.
    """
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
    """Information with the gradients that the shots have after one Gauss-Newton step of all
    estimated parameters.

    If a fit fixed some of these parameters, the gradients do not sum to zero before this step.
    Their sum shows the offset of the fixed parameters, not the scatter of the shots.
    """
    free = information.free
    covariance = np.nan_to_num(information.observability.covariance)
    step = covariance @ information.gradients[:, free].sum(axis=0)
    gradients = information.gradients - information.shot_information[:, :, free] @ step
    return information._replace(gradients=gradients)


def exact_prior_information(information: Information) -> Float[np.ndarray, "f f"]:
    """Information of the priors without that of the board point displacements, (f, f).

    Only these priors keep their variance if the noise variance is multiplied by a factor. The prior
    of the displacements was estimated from the residuals, so its variance changes with theirs.
    """
    is_exact = information.free < information.first_shape_step
    return information.prior * np.outer(is_exact, is_exact)


def blend_with_jackknife(
    enlarged: Float[np.ndarray, "f f"],
    covariance: Float[np.ndarray, "f f"],
    information: Information,
    factor: float,
) -> Float[np.ndarray, "f f"]:
    """Covariance of a fit whose shots scatter more than the point sigmas explain.

    It is a weighted mean of two estimates.

    The first estimate is F C: covariance C times variance factor F. F is the same in all
    directions. In reality, a board that bends differently in every shot, for instance, changes
    focal lengths more than poses. The second estimate is the jackknife over the shots, J. It shows
    each direction separately, but is noisy for few shots. J is singular if the number of shots S is
    below the number p of lens and camera parameters. The weights are degrees of freedom, as in
    Bayes' theorem with an inverse Wishart prior:

        (p F C + (S - 1) J) / (p + S - 1)

    enlarged : (f, f) F C, computed with unchanged priors (`enlarge_covariance`).
    covariance : (f, f) C.
    factor : F.
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
    """Jackknife covariance of a fit: scatter of the solutions that omit one shot each.

    d_s is the change of the solution without shot s:

        (S - 1) / S sum_s d_s d_s^T + C P C,    d_s = (H - H_s)^-1 g_s

    H is the total information, H_s and g_s are the information and gradient of shot s, S is the
    number of shots and C is `covariance`. P is the information of the priors; its part for board
    point displacements is multiplied by `factor`.

    References
    ----------
    Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage
    samples" (2002), estimator CR3.
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
    """Scatter of the chi-square gradients of the shots, compared with its expectation.

    Attributes
    ----------
    factor : observed variance of the gradients, divided by the variance expected from the point
        sigmas.
    sigma : standard deviation of `factor` if its true value is 1.
    largest_sigmas : deviation of `factor` from 1, in units of `sigma`, above which it is
        significant.
    """

    factor: float
    sigma: float
    largest_sigmas: float = TUNING.problem.shots_sigmas

    @property
    def variance_factor(self) -> float:
        """Factor by which to multiply a covariance: `factor` if it is significantly above 1, else
        1.
        """
        return self.factor if self.factor > 1.0 + self.largest_sigmas * self.sigma else 1.0


def shot_scatter(
    information: Information, fixed: Bool[np.ndarray, "f"] | None = None
) -> ShotScatter:
    """Test whether the shots scatter more than the point sigmas explain.

    The statistic compares the chi-square gradients of the shots with their expectation. Let g_s and
    H_s be the gradient and information of shot s, and H the total information:

        E(sum_s g_s^T H^-1 g_s) = sum_s tr(H^-1 H_s) - sum_s tr((H^-1 H_s)^2)

    The displacements of the board points are fixed in this test. They would follow the noise of
    each point and hide the scatter of lenses and cameras.

    fixed : (f,) mask of the parameters that the fit fixed. The gradients are then computed for the
        solution in which these parameters are free, to first order.
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
    """Covariance, (f, f), after the noise variance was multiplied by `factor`, with unchanged
    priors.

    covariance : (f, f) covariance for a factor of 1.
    prior : (f, f) information of the priors.
    """
    return factor * covariance - (factor - 1.0) * covariance @ prior @ covariance
