"""What blocks of the sheet say of each other: the scatter of the answers without one of them.

Errors that neighbouring circles share (glare, a bend of no known shape) make a pose err more than
circles that err one by one would. Leaving out whole blocks shows it: B. Efron and C. Stein, "The
jackknife estimate of variance", Annals of Statistics 9(3), 1981.
"""

import numpy as np

from trinoc.calib.adjustment.estimate import Adjustment
from trinoc.calib.tuning.every_group import TUNING


def scatter_of_blocks(adjustment: Adjustment, view: int) -> float:
    """By how much blocks scatter beyond the noise that the circles of a camera claim; at least 1.

    The circles of the camera's detection err one by one as far as they claim.
    """
    own, problem = adjustment.rows(view), adjustment.problem
    jacobian = adjustment.near.jacobian[view][:, adjustment.free]
    residuals, covariance = adjustment.near.residual[view], adjustment.covariance
    place_mm = problem.target.centres_mm[problem.views[view].detection.circle_index]
    steps, expected = [], []
    for block in _blocks(place_mm, adjustment.used[view]):
        rows = np.concatenate([2 * block, 2 * block + 1])
        # The answer without the block, by its rows alone (M. A. Woodbury): what they fit of
        # themselves is the leverage.
        taken = jacobian[rows] @ covariance
        left = np.eye(len(rows)) - taken @ jacobian[rows].T
        steps.append(np.linalg.solve(left, residuals[rows]) @ taken[:, own])
        # What independent noise makes of such a step, the residuals being less than the noise.
        expected.append(taken[:, own].T @ np.linalg.solve(left, taken[:, own]))
    if len(steps) < TUNING.adjustment.fewest_blocks:
        return 1.0
    spread = np.stack(steps)
    ratio = np.linalg.solve(np.sum(expected, axis=0), spread.T @ spread)
    return float(np.sqrt(max(1.0, np.trace(ratio) / len(own))))


def _blocks(place_mm: np.ndarray, used: np.ndarray) -> list[np.ndarray]:
    """Rows of `place_mm` that took part, by the block of the sheet that they lie in."""
    blocks, low, high = TUNING.adjustment.blocks, place_mm.min(axis=0), place_mm.max(axis=0)
    cell = np.floor((place_mm - low) / (high - low + 1e-9) * blocks).astype(int)
    number = np.where(used, cell[:, 0] * blocks + cell[:, 1], -1)
    return [np.flatnonzero(number == k) for k in range(blocks**2) if (number == k).any()]
