"""Do the circles of one picture agree, with each other and with its grey levels?

Errors that neighbouring circles share (glare, a bend of no known shape) make a pose err more than
circles that err one by one would. Leaving out whole blocks shows it: B. Efron and C. Stein, "The
jackknife estimate of variance", Annals of Statistics 9(3), 1981.

Both circles and grey levels are fitted to one picture, the grey levels better. If the model of
the grey levels is right, the circles' answer differs from theirs by no more than the circles' own
noise; where they are farther apart, one of both models is wrong, and the scatter of the grey
levels' own places says which (`choose_observations`): J. A. Hausman, "Specification tests in
econometrics", Econometrica 46(6), 1978. His covariance is the difference of both, whichever is the
larger, here with the sheet and the lens as the grey levels have them: the priors, which make both
answers nearly as uncertain as each other, then drop out.
"""

from collections.abc import Sequence
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
    candidates: Sequence[SheetCamera], by_circles: Adjustment, by_pixels: Adjustment
) -> tuple[SheetCamera, ...]:
    """Choose the observations of each camera: its grey levels, or its circles where those mislead.

    candidates : the cameras by their grey levels, where these could be fitted.
    by_circles, by_pixels : all cameras adjusted by their circles, and as `candidates`.
    """
    return tuple(
        _choose(view, camera, by_circles, by_pixels) for view, camera in enumerate(candidates)
    )


def _choose(
    view: int, camera: SheetCamera, by_circles: Adjustment, by_pixels: Adjustment
) -> SheetCamera:
    has_pixels, agreement = camera.method == "pixels", float("nan")
    if has_pixels:
        agreement = probability_of_agreement(by_circles, by_pixels, view)
    agrees = agreement >= TUNING.answer.chance_of_answers
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
    if not has_pixels and scatter <= TUNING.answer.largest_scatter:
        scatter = 1.0
    return replace(camera, shown=None, agreement=agreement, scatter=scatter)


def _has_open_model(adjustment: Adjustment) -> bool:
    """Whether lens or sheet are estimated along with the poses."""
    slices, weights = adjustment.problem.slices, prior_weights(adjustment.problem)
    return bool(weights[slices.lenses].any() or weights[slices.sheets].any())


def _are_displaced(by_circles: Adjustment, view: int) -> bool:
    """Whether neighbouring circles share errors, as under glare: their blocks scatter, or their
    residuals are correlated."""
    if scatter_of_blocks(by_circles, view) > TUNING.answer.largest_scatter:
        return True
    limit = float(normal_limit(TUNING.answer.chance_of_answers))
    return autocorrelation_of_circles(by_circles, view) > limit


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


def autocorrelation_of_circles(adjustment: Adjustment, view: int) -> float:
    """Of the residuals of neighbours, in its standard deviations were all errors independent.

    P. A. P. Moran, "Notes on continuous stochastic phenomena", Biometrika 37, 1950.
    """
    used = np.flatnonzero(adjustment.used[view])
    index = adjustment.problem.views[view].detection.circle_index[used]
    place_mm = adjustment.problem.target.centres_mm[index]
    residuals = adjustment.near.residual[view].reshape(-1, 2)[used]
    apart_mm = cdist(place_mm, place_mm)
    nearest_mm = np.partition(apart_mm, 1, axis=1)[:, 1]
    first, second = np.nonzero(np.triu(apart_mm < _NEIGHBOURS * np.median(nearest_mm), 1))
    products = np.sum(residuals[first] * residuals[second], axis=1)
    # Products of different pairs of independent errors are not correlated.
    sigma = np.mean(residuals**2) * np.sqrt(2 * len(products))
    return float(products.sum() / sigma)


def _blocks(place_mm: np.ndarray, used: np.ndarray) -> list[np.ndarray]:
    """Rows of `place_mm` that took part, by the block of the sheet that they lie in."""
    blocks, low, high = TUNING.adjustment.blocks, place_mm.min(axis=0), place_mm.max(axis=0)
    cell = np.floor((place_mm - low) / (high - low + 1e-9) * blocks).astype(int)
    number = np.where(used, cell[:, 0] * blocks + cell[:, 1], -1)
    return [np.flatnonzero(number == k) for k in range(blocks**2) if (number == k).any()]


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
    root = np.asarray(np.linalg.qr(by_circles, mode="r"))
    own = np.linalg.solve(root.T, by_circles.T @ residual)
    # The grey levels' covariance where that of the circles is one. Grey levels that leave more of
    # the light open know less than circles that take it for even.
    other = root @ np.linalg.solve(by_grey.T @ by_grey, root.T)
    shares, directions = np.linalg.eigh(0.5 * (other + other.T))
    variance = np.maximum(np.abs(1 - shares), TUNING.adjustment.least_difference)
    return float(np.sum((directions.T @ own) ** 2 / variance))
