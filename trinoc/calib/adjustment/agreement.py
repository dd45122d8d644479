"""Tests whether a camera's circles agree with each other and with its grey levels.

Errors that neighbouring circles have in common (glare, a bend that is not modelled) change a pose
more than independent errors would. A block jackknife shows this: B. Efron and C. Stein, "The
jackknife estimate of variance", Annals of Statistics 9(3), 1981.

Circles and grey levels come from one image, and grey levels are more precise. If the model of the
grey levels is right, both poses differ only by the noise of the circles. A larger difference shows
that one model is wrong. The residuals of the grey-level points then decide which one
(`choose_observations`): J. A. Hausman, "Specification tests in econometrics", Econometrica 46(6),
1978. The covariance of the difference is the absolute difference of both covariances. Sheet and
lens are fixed at the values of the grey-level adjustment. Otherwise their priors would make both
poses nearly equally uncertain.
"""

from dataclasses import replace

import numpy as np
import scipy
from jaxtyping import Float

from trinoc.calib.adjustment.adjustment import Adjustment, prior_weights
from trinoc.calib.problem.information import whiten_views
from trinoc.calib.problem.sheet_problem import SheetCamera
from trinoc.calib.tuning.every_group import TUNING
from trinoc.numerics.tails import chi_square_tail, normal_limit

# numerical: largest distance of neighbours on a lattice; diagonals are 1.41.
_NEIGHBOURS = 1.2


def choose_observations(
    view: int, camera: SheetCamera, by_circles: Adjustment, by_pixels: Adjustment
) -> SheetCamera:
    """Choose whether a camera uses its grey levels or its circle centres.

    Grey levels are used if they give the same pose as the circles, or if their residuals agree with
    their sigmas. Images that software has sharpened must fulfil both conditions in some cases.

    Parameters
    ----------
    view : index of the camera.
    camera : the camera with its grey-level points, or with its circles if the grey levels had no
        fit.
    by_circles : adjustment that uses the circle centres of all cameras.
    by_pixels : adjustment that uses the grey levels of all cameras.

    Returns
    -------
    The camera with the chosen observations, the p-value of the comparison, and the factor of its
    sigmas.
    """
    has_pixels, agreement = camera.method == "pixels", float("nan")
    if has_pixels:
        agreement = probability_of_agreement(by_circles, by_pixels, view)
    tuning = by_circles.problem.tuning.answer
    agrees = agreement >= tuning.chance_of_answers
    is_consistent = has_pixels and by_pixels.sigma_factors[view] == 1.0
    # Shadows, uneven light and blur displace all circles similarly, so that these agree with each
    # other. Effects that the grey levels do not model make their points scatter. Filters of phones
    # move whole edges, which an uncertain lens or sheet absorbs. Then the circles are used, unless
    # neighbouring circles are displaced similarly, as by glare.
    is_processed = camera.grey_level_fit is not None and camera.grey_level_fit.is_processed
    if is_processed and _has_open_model(by_circles) and not _are_displaced(by_circles, view):
        uses_pixels = agrees and is_consistent
    else:
        uses_pixels = agrees or is_consistent
    if uses_pixels:
        return replace(camera, agreement_p_value=agreement)
    scatter = scatter_of_blocks(by_circles, view)
    # If the model of the grey levels is wrong, the circles may be wrong, too.
    if not has_pixels and scatter <= tuning.largest_scatter:
        scatter = 1.0
    return replace(
        camera, grey_level_points=None, agreement_p_value=agreement, sigma_factor=scatter
    )


def _has_open_model(adjustment: Adjustment) -> bool:
    """True if lenses or sheet are estimated together with the poses."""
    slices, weights = adjustment.problem.slices, prior_weights(adjustment.problem)
    return bool(weights[slices.lenses].any() or weights[slices.sheets].any())


def _are_displaced(by_circles: Adjustment, view: int) -> bool:
    """True if neighbouring circles have similar errors, for instance because of glare.

    The test uses `scatter_of_blocks` and `autocorrelation_of_circles`.
    """
    tuning = by_circles.problem.tuning.answer
    if scatter_of_blocks(by_circles, view) > tuning.largest_scatter:
        return True
    limit = float(normal_limit(tuning.chance_of_answers))
    return autocorrelation_of_circles(by_circles, view) > limit


def scatter_of_blocks(adjustment: Adjustment, view: int) -> float:
    """Factor by which errors of neighbouring circles enlarge the pose error of a camera; at least
    1.

    It is estimated by a block jackknife. The sheet is divided into blocks, and the pose is
    estimated without each block in turn. The factor is the root mean square of these pose changes,
    divided by its expectation for independent circle errors with the detected sigmas.
    """
    pose_steps, problem = adjustment.rows(view), adjustment.problem
    jacobian = adjustment.whitened.jacobian[view][:, adjustment.free]
    residuals, covariance = adjustment.whitened.residual[view], adjustment.covariance
    circle_mm = problem.target.centres_mm[problem.views[view].detection.circle_index]
    steps, expected = [], []
    tuning = problem.tuning.adjustment
    for block in _blocks(circle_mm, adjustment.used[view], tuning.blocks):
        rows = np.concatenate([2 * block, 2 * block + 1])
        # The estimate without the block, from its rows alone (M. A. Woodbury), with their leverage.
        gain = jacobian[rows] @ covariance
        remainder = np.eye(len(rows)) - gain @ jacobian[rows].T
        steps.append(np.linalg.solve(remainder, residuals[rows]) @ gain[:, pose_steps])
        # Covariance of this step by independent noise; residuals are smaller than the noise.
        expected.append(gain[:, pose_steps].T @ np.linalg.solve(remainder, gain[:, pose_steps]))
    if len(steps) < tuning.fewest_blocks:
        return 1.0
    spread = np.stack(steps)
    ratio = np.linalg.solve(np.sum(expected, axis=0), spread.T @ spread)
    return float(np.sqrt(max(1.0, np.trace(ratio) / len(pose_steps))))


def autocorrelation_of_circles(adjustment: Adjustment, view: int) -> float:
    """Correlation between the residuals of neighbouring circles, divided by its sigma (Moran's
    statistic).

    It is a standard normal variable if the circles have independent errors.

    References
    ----------
    P. A. P. Moran, "Notes on continuous stochastic phenomena", Biometrika 37, 1950.
    """
    used = np.flatnonzero(adjustment.used[view])
    index = adjustment.problem.views[view].detection.circle_index[used]
    circle_mm = adjustment.problem.target.centres_mm[index]
    residuals = adjustment.whitened.residual[view].reshape(-1, 2)[used]
    separation_mm = scipy.spatial.distance.cdist(circle_mm, circle_mm)
    nearest_mm = np.partition(separation_mm, 1, axis=1)[:, 1]
    are_neighbours = separation_mm < _NEIGHBOURS * np.median(nearest_mm)
    first, second = np.nonzero(np.triu(are_neighbours, 1))
    products = np.sum(residuals[first] * residuals[second], axis=1)
    # Products of different pairs of independent errors are not correlated.
    sigma = np.mean(residuals**2) * np.sqrt(2 * len(products))
    return float(products.sum() / sigma)


def _blocks(circle_mm: np.ndarray, used: np.ndarray, blocks: int) -> list[np.ndarray]:
    """Indices of the used circles in each rectangular block of the sheet.

    blocks : number of blocks along each side of the sheet. Blocks without a used circle are
        omitted.
    """
    low, high = circle_mm.min(axis=0), circle_mm.max(axis=0)
    cell = np.floor((circle_mm - low) / (high - low + 1e-9) * blocks).astype(int)
    block_index = np.where(used, cell[:, 0] * blocks + cell[:, 1], -1)
    return [np.flatnonzero(block_index == k) for k in range(blocks**2) if (block_index == k).any()]


def probability_of_agreement(by_circles: Adjustment, by_pixels: Adjustment, view: int) -> float:
    """p-value of the test that circles and grey levels give the same pose of one camera (Hausman
    test).

    Sheet and lens are fixed at the values of the grey-level adjustment. A small value means that
    one of both models is wrong.

    by_circles, by_pixels : adjustments of all cameras that use circle centres and grey levels.
    view : index of the camera.
    """
    pose_steps = by_circles.free[by_circles.rows(view)]
    circles_at_pixels = whiten_views(by_circles.problem._replace(state=by_pixels.problem.state))
    circles, pixels = (
        adjustment.whitened.jacobian[view][:, pose_steps] for adjustment in (by_circles, by_pixels)
    )
    least_difference = by_circles.problem.tuning.adjustment.least_difference
    squared = difference_of_estimates(
        circles_at_pixels.residual[view], circles, pixels, least_difference
    )
    return float(chi_square_tail(squared, len(pose_steps)))


def difference_of_estimates(
    residual: Float[np.ndarray, "n"],
    by_circles: Float[np.ndarray, "n p"],
    by_pixels: Float[np.ndarray, "m p"],
    least_difference: float = TUNING.adjustment.least_difference,
) -> float:
    """Squared Mahalanobis distance between the pose from circles and the pose from grey levels.

    If both models are right, it has a chi-square distribution with p degrees of freedom.

    Parameters
    ----------
    residual : (n,) residuals of the circles at the pose from grey levels, in sigmas.
    by_circles : (n, p) derivative of the circles' residuals with respect to the pose.
    by_pixels : (m, p) derivative of the grey-level residuals with respect to the pose.
    least_difference : smallest variance of the difference, in units of the variance from circles.
    """
    root = np.asarray(np.linalg.qr(by_circles, mode="r"))
    step = np.linalg.solve(root.T, by_circles.T @ residual)
    # The grey levels' covariance in units of the circles'. Grey levels with a fitted gradient of
    # the light determine less than circles, which assume even light.
    covariance = root @ np.linalg.solve(by_pixels.T @ by_pixels, root.T)
    shares, directions = np.linalg.eigh(0.5 * (covariance + covariance.T))
    variance = np.maximum(np.abs(1 - shares), least_difference)
    return float(np.sum((directions.T @ step) ** 2 / variance))
