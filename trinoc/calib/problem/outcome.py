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
from trinoc.calib.result.calibration import Status
from trinoc.calib.tuning.every_group import TUNING


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
    observed = information.observability
    covariance = np.nan_to_num(observed.covariance)
    if observed.rank < len(information.free):
        return FitOutcome(Status.RANK_DEFICIENT, information, covariance, 1.0)
    factor = shot_scatter(information).variance_factor
    status = Status.CONVERGED if fit.converged else Status.NOT_CONVERGED
    enlarged = enlarge_covariance(covariance, factor, information.prior)
    return FitOutcome(status, information, enlarged, factor)


class ShotScatter(NamedTuple):
    """factor : variance of the shots' pulls over what their places' sigmas say.
    sigma : of that factor, where it is 1."""

    factor: float
    sigma: float

    @property
    def variance_factor(self) -> float:
        """What the covariance is to be multiplied by: 1 unless the shots refute it."""
        return self.factor if self.factor > 1.0 + TUNING.problem.shots_sigmas * self.sigma else 1.0


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
        return ShotScatter(1.0, float("inf"))
    found = float(np.einsum("si,ij,sj->", pulls, covariance, pulls))
    return ShotScatter(found / expected, float(np.sqrt(2.0 * squares) / expected))


def enlarge_covariance(
    covariance: Float[np.ndarray, "f f"], factor: float, prior: Float[np.ndarray, "f f"]
) -> Float[np.ndarray, "f f"]:
    """The covariance of a fit whose shots' noise has `factor` times its variance, and whose prior
    of information `prior` is what it is said to be."""
    return factor * covariance - (factor - 1.0) * covariance @ prior @ covariance
