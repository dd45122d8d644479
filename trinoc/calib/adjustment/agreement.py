"""Do the grey levels of a picture and the centres of its circles tell of one camera?

Both are fitted to one picture, the grey levels better. If the model of the grey levels is right,
the circles' answer differs from theirs by no more than the circles' own noise; where they are
farther apart, the grey levels are of another picture than the model's: J. A. Hausman,
"Specification tests in econometrics", Econometrica 46(6), 1978. His covariance is the difference of
both, here with the sheet and the lens as the grey levels have them: the priors, which make both
answers nearly as uncertain as each other, then drop out.
"""

import jax
import numpy as np

from trinoc.calib.adjustment.estimate import Adjustment
from trinoc.calib.adjustment.least_squares import residuals_px
from trinoc.calib.model import SheetPoints, bucket_size
from trinoc.numerics import chi_square_tail

# Of the circles' own covariance that the difference has at least.
_LEAST_SHARE = 0.1


def probability_of_agreement(
    circles: Adjustment, image: Adjustment, points: SheetPoints, view: int
) -> float:
    """Of so large a difference between the poses of one camera, were both models right.

    The sheet and the lens are as the grey levels have them. points : the circles of this camera.
    """
    found = image.adjusted
    pose, lens = jax.tree.map(lambda leaf: leaf[view], (found.pose, found.lens))
    count = bucket_size(len(points.place_mm))
    padded = points.padded(count)
    off_px = np.array(residuals_px(pose, lens, found.shape, padded, image.reach_mm))
    off_px[: len(points.place_mm)][~circles.used[view]] = 0.0
    whitened = padded.whitening @ off_px.reshape(-1) / circles.enlarged[view]
    by_pose = np.asarray(circles.jacobian[view])[: 2 * count, circles.rows(view)]
    slope, information = by_pose.T @ whitened, by_pose.T @ by_pose
    squared = float(slope @ np.linalg.solve(information, slope))
    by_grey = np.asarray(image.jacobian[view])[:, image.rows(view)]
    kept = np.trace(np.linalg.solve(by_grey.T @ by_grey, information)) / len(slope)
    return float(chi_square_tail(squared / max(1 - kept, _LEAST_SHARE), len(slope)))
