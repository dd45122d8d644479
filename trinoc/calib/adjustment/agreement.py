"""Agreement of a camera's circles, with each other and with its grey levels, and which are used.

Errors that neighbouring circles share (glare, a bend of no known shape) make a pose err more than
independent errors of circles would. Estimates without whole blocks of circles show this: B. Efron
and C. Stein, "The jackknife estimate of variance", Annals of Statistics 9(3), 1981.

Both circles and grey levels are fitted to one image, the grey levels better. If the model of
the grey levels is right, the circles' estimate differs from theirs by no more than the circles' own
noise. If they differ by more, one of both models is wrong, and the scatter of the grey levels' own
places shows which (`choose_observations`): J. A. Hausman, "Specification tests in econometrics",
Econometrica 46(6), 1978. His covariance is the difference of both, whichever is the larger, here
with the sheet and the lens as the grey levels have them. The priors, which make both estimates
nearly as uncertain as each other, then drop out.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from trinoc.calib.adjustment.adjustment import Adjustment, prior_weights
from trinoc.calib.problem.information import whiten_views
from trinoc.calib.problem.sheet_problem import SheetCamera
from trinoc.calib.tuning.every_group import TUNING
from trinoc.numerics.tails import chi_square_tail, normal_limit

# numerical: neighbours on a lattice, whose diagonals are 1.41 as long.
_NEIGHBOURS = 1.2


def choose_observations(
    view: int, camera: SheetCamera, by_circles: Adjustment, by_pixels: Adjustment
) -> SheetCamera:
    """Choose the observations of one camera: its grey levels, or its circles where those mislead.

    camera : with its grey levels, where these could be fitted.
    by_circles, by_pixels : all cameras adjusted by their circles, and by such grey levels.
    """
    has_pixels, agreement = camera.method == "pixels", float("nan")
    if has_pixels:
        agreement = probability_of_agreement(by_circles, by_pixels, view)
    tuning = by_circles.problem.tuning.answer
    agrees = agreement >= tuning.chance_of_answers
    is_consistent = has_pixels and by_pixels.enlarged[view] == 1.0
    # Shadows, uneven light and blur move circles alike, so that these agree among themselves; what
    # the grey levels do not model makes their places scatter. Filters of phones move whole edges,
    # which an uncertain lens or sheet absorbs: there the circles count, unless neighbouring ones
    # are displaced alike, as by glare.
    is_processed = camera.picture is not None and camera.picture.is_processed
    if is_processed and _has_open_model(by_circles) and not _are_displaced(by_circles, view):
        uses_pixels = agrees and is_consistent
    else:
        uses_pixels = agrees or is_consistent
    if uses_pixels:
        return replace(camera, agreement=agreement)
    scatter = scatter_of_blocks(by_circles, view)
    # A model of the grey levels that is wrong casts doubt on the circles, too.
    if not has_pixels and scatter <= tuning.largest_scatter:
        scatter = 1.0
    return replace(camera, shown=None, agreement=agreement, scatter=scatter)


def _has_open_model(adjustment: Adjustment) -> bool:
    """Return True if lens or sheet are estimated along with the poses."""
    slices, weights = adjustment.problem.slices, prior_weights(adjustment.problem)
    return bool(weights[slices.lenses].any() or weights[slices.sheets].any())


def _are_displaced(by_circles: Adjustment, view: int) -> bool:
    """Return True if neighbouring circles share errors, as under glare.

    Then their blocks scatter, or their residuals are correlated.
    """
    tuning = by_circles.problem.tuning.answer
    if scatter_of_blocks(by_circles, view) > tuning.largest_scatter:
        return True
    limit = float(normal_limit(tuning.chance_of_answers))
    return autocorrelation_of_circles(by_circles, view) > limit


def scatter_of_blocks(adjustment: Adjustment, view: int) -> float:
    """Scatter of the blocks of a camera's circles over that of independent errors; at least 1.

    Independent errors have the sigmas of the camera's detection.
    """
    pose_steps, problem = adjustment.rows(view), adjustment.problem
    jacobian = adjustment.whitened.jacobian[view][:, adjustment.free]
    residuals, covariance = adjustment.whitened.residual[view], adjustment.covariance
    place_mm = problem.target.centres_mm[problem.views[view].detection.circle_index]
    steps, expected = [], []
    tuning = problem.tuning.adjustment
    for block in _blocks(place_mm, adjustment.used[view], tuning.blocks):
        rows = np.concatenate([2 * block, 2 * block + 1])
        # The estimate without the block, by its rows alone (M. A. Woodbury): what they fit of
        # themselves is the leverage.
        gain = jacobian[rows] @ covariance
        remainder = np.eye(len(rows)) - gain @ jacobian[rows].T
        steps.append(np.linalg.solve(remainder, residuals[rows]) @ gain[:, pose_steps])
        # What independent noise makes of such a step, the residuals being less than the noise.
        expected.append(gain[:, pose_steps].T @ np.linalg.solve(remainder, gain[:, pose_steps]))
    if len(steps) < tuning.fewest_blocks:
        return 1.0
    spread = np.stack(steps)
    ratio = np.linalg.solve(np.sum(expected, axis=0), spread.T @ spread)
    return float(np.sqrt(max(1.0, np.trace(ratio) / len(pose_steps))))


def autocorrelation_of_circles(adjustment: Adjustment, view: int) -> float:
    """Correlation of the residuals of neighbouring circles, over its sigma for independent errors.

    P. A. P. Moran, "Notes on continuous stochastic phenomena", Biometrika 37, 1950.
    """
    used = np.flatnonzero(adjustment.used[view])
    index = adjustment.problem.views[view].detection.circle_index[used]
    place_mm = adjustment.problem.target.centres_mm[index]
    residuals = adjustment.whitened.residual[view].reshape(-1, 2)[used]
    separation_mm = cdist(place_mm, place_mm)
    nearest_mm = np.partition(separation_mm, 1, axis=1)[:, 1]
    are_neighbours = separation_mm < _NEIGHBOURS * np.median(nearest_mm)
    first, second = np.nonzero(np.triu(are_neighbours, 1))
    products = np.sum(residuals[first] * residuals[second], axis=1)
    # Products of different pairs of independent errors are not correlated.
    sigma = np.mean(residuals**2) * np.sqrt(2 * len(products))
    return float(products.sum() / sigma)


def _blocks(place_mm: np.ndarray, used: np.ndarray, blocks: int) -> list[np.ndarray]:
    """Rows of `place_mm` that are used, by the block of the sheet; `blocks` along each side."""
    low, high = place_mm.min(axis=0), place_mm.max(axis=0)
    cell = np.floor((place_mm - low) / (high - low + 1e-9) * blocks).astype(int)
    number = np.where(used, cell[:, 0] * blocks + cell[:, 1], -1)
    return [np.flatnonzero(number == k) for k in range(blocks**2) if (number == k).any()]


def probability_of_agreement(by_circles: Adjustment, by_pixels: Adjustment, view: int) -> float:
    """Probability of so large a difference between both poses of one camera, were both models
    right.

    The sheet and the lens are as the grey levels have them.
    """
    pose = by_circles.free[by_circles.rows(view)]
    moved = whiten_views(by_circles.problem._replace(state=by_pixels.problem.state))
    circles, pixels = (each.whitened.jacobian[view][:, pose] for each in (by_circles, by_pixels))
    least = by_circles.problem.tuning.adjustment.least_difference
    squared = difference_of_estimates(moved.residual[view], circles, pixels, least)
    return float(chi_square_tail(squared, len(pose)))


def difference_of_estimates(
    residual: Float[np.ndarray, "n"],
    by_circles: Float[np.ndarray, "n p"],
    by_pixels: Float[np.ndarray, "m p"],
    least_difference: float = TUNING.adjustment.least_difference,
) -> float:
    """Chi-square, of p degrees of freedom, of the circles' estimate less that of the grey levels.

    residual : of the circles in sigmas, at the pose of the grey levels. by_circles, by_pixels :
    derivatives of both by the pose.
    """
    root = np.asarray(np.linalg.qr(by_circles, mode="r"))
    step = np.linalg.solve(root.T, by_circles.T @ residual)
    # The grey levels' covariance where that of the circles is one. Grey levels with a fitted
    # gradient of the light determine less than circles, which assume even light.
    covariance = root @ np.linalg.solve(by_pixels.T @ by_pixels, root.T)
    shares, directions = np.linalg.eigh(0.5 * (covariance + covariance.T))
    variance = np.maximum(np.abs(1 - shares), least_difference)
    return float(np.sum((directions.T @ step) ** 2 / variance))
