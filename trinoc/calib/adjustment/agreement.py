"""Do the grey levels of a picture and the centres of its circles tell of one camera?

Both are fitted to one picture, the grey levels better. If the model of the grey levels is right,
the circles' answer differs from theirs by no more than the circles' own noise; where they are
farther apart, the grey levels are of another picture than the model's: J. A. Hausman,
"Specification tests in econometrics", Econometrica 46(6), 1978. His covariance is the difference of
both, here with the sheet and the lens as the grey levels have them: the priors, which make both
answers nearly as uncertain as each other, then drop out.
"""

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.estimate import Adjustment
from trinoc.calib.problem.information import whiten_views
from trinoc.calib.tuning.every_group import TUNING
from trinoc.numerics.tails import chi_square_tail


def probability_of_agreement(circles: Adjustment, image: Adjustment, view: int) -> float:
    """Of so large a difference between the poses of one camera, were both models right.

    The sheet and the lens are as the grey levels have them.
    """
    pose = circles.free[circles.rows(view)]
    of_circles = whiten_views(circles.problem._replace(state=image.problem.state))
    by_pose, by_grey = (each.near.jacobian[view][:, pose] for each in (circles, image))
    squared = difference_of_answers(of_circles.residual[view], by_pose, by_grey)
    return float(chi_square_tail(squared, len(pose)))


def difference_of_answers(
    residual: Float[np.ndarray, "n"],
    by_circles: Float[np.ndarray, "n p"],
    by_grey: Float[np.ndarray, "m p"],
) -> float:
    """Chi-square, of p degrees of freedom, of the circles' answer less that of the grey levels.

    residual : of the circles in sigmas, where the grey levels have the pose. by_circles, by_grey :
    derivatives of both by the pose.
    """
    slope, information = by_circles.T @ residual, by_circles.T @ by_circles
    squared = float(slope @ np.linalg.solve(information, slope))
    kept = np.trace(np.linalg.solve(by_grey.T @ by_grey, information)) / len(slope)
    return squared / max(1 - kept, TUNING.adjustment.least_difference)
