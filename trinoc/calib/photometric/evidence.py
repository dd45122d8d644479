"""Tests of the residuals: is a model sufficient, and which further unknowns does the image need?

Under a correct model, the mean residual is 0 everywhere. A dependence on the share of ink indicates
a response or another kernel, on the direction of the edge a motion, on the position on the sheet
uneven light. The variance does not depend on the grey level, and neighbours are uncorrelated.
`find_refuted_part` tests this for the ideal camera without a Jacobian. `find_evidence` computes
the score test of each group of fixed unknowns.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.photometric.fit_state import ImageFitState
from trinoc.calib.photometric.noise import PixelGrid, autocorrelation, inflation, saturation_level
from trinoc.calib.photometric.scene import PixelScene
from trinoc.calib.photometric.unknowns import FULL
from trinoc.calib.tuning.photometric import PhotometricTuning

# numerical: bins of a test by the share of ink, and bins along each side of the image.
_SHARE_BINS, _POSITION_BINS = 16, 6

# Groups of unknowns that are freed together. A group in `_NEEDS` requires other free unknowns.
GROUPS = {
    "bend": ("bend",),
    "contrast": ("contrast",),
    "lift": ("lift",),
    "kurtosis": ("kurtosis",),
    "sixth": ("sixth",),
    "motion": ("along_u", "diagonal"),
    "axes": ("along_axes",),
    "line": ("line",),
    "lobe": ("lobe",),
    "lobe shape": ("lobe_px", "lobe_mm"),
}
_NEEDS = {"line": ("along_u",), "lobe shape": ("lobe",)}
# Estimated from the first step on: without them, outliers are classified wrongly.
FIRST = ("bend", "kurtosis", "along_u", "diagonal", "lobe")
# Fixed if the response is known.
OF_RESPONSE = ("bend", "contrast", "lift")


def find_refuted_part(
    scene: PixelScene, fit_state: ImageFitState
) -> Literal["nothing", "noise", "model"]:
    """Test whether the ideal camera model describes an image, by the residuals of its fit.

    Parameters
    ----------
    scene : pixels and constants of the fit.
    fit_state : end of the fit of an ideal camera.

    Returns
    -------
    "nothing" if the ideal camera is sufficient, "noise" if the noise depends on the grey level,
    "model" if the camera needs further unknowns.
    """
    inliers, residual = fit_state.inliers, fit_state.level - scene.grey
    light = scene.polynomial_light(fit_state.state)
    share = (fit_state.level / light - 1) / float(fit_state.state["ratio"])
    position = np.stack([scene.pixels.column, scene.pixels.row], axis=1)[inliers]
    inlier_residual, share = residual[inliers], share[inliers]
    # Saturated pixels excluded by the gate belong to glare.
    tuning = scene.tuning
    if np.isfinite(saturation_level(scene.grey[inliers], tuning.piled_share)):
        return "model"
    variance = float(np.mean(inlier_residual**2))
    if 0 < tuning.largest_variance_ratio * scene.noise_floor**2 < variance:
        return "model"
    grid = scene.grid
    if _neighbours_are_correlated(grid, residual * inliers, inliers, tuning.largest_correlation):
        return "model"
    bins = np.clip((share * _SHARE_BINS).astype(int), 0, _SHARE_BINS - 1)
    near_line = (np.arange(len(inliers)) >= scene.counts[0])[inliers]
    by_share = bins + _SHARE_BINS * near_line
    if _has_bin_means(inlier_residual, by_share, tuning):
        return "model"
    size = np.ptp(position, axis=0) + 1
    column, row = ((position - position.min(axis=0)) * _POSITION_BINS // size).T
    paper = tuning.flat_share
    flat = np.where(share < paper, 0, np.where(share > 1 - paper, 1, 2))
    by_position = (column * _POSITION_BINS + row) * 3 + flat
    if _has_bin_means(inlier_residual[flat < 2], by_position[flat < 2], tuning):
        return "model"
    if _width_depends_on_direction(scene.grey, grid, share, inliers, inlier_residual, tuning):
        return "model"
    return "nothing" if _has_constant_variance(inlier_residual, bins, tuning) else "noise"


class ImageEvidence(NamedTuple):
    """Unknowns that must be estimated in addition to those of a fit; result of `find_evidence`.

    Attributes
    ----------
    free : (k,) mask of fixed unknowns that must be estimated.
    uneven_light : True if each block of the sheet needs its own light.
    """

    free: Bool[np.ndarray, "k"]
    uneven_light: bool


def find_evidence(scene: PixelScene, fit_state: ImageFitState) -> ImageEvidence:
    """Test by the residuals of a fit which of its fixed unknowns must be estimated.

    Each group of fixed unknowns has a score test. A further test detects uneven light. The variance
    of the scores includes the correlation of the residuals.

    Parameters
    ----------
    scene : pixels and constants of the fit.
    fit_state : fit with its normal equations.
    """
    size = scene.model.size
    residual, sigma = fit_state.residual(scene)
    standard = residual / sigma
    tuning = scene.tuning
    spread = inflation(
        autocorrelation(scene.grid, standard, fit_state.inliers, tuning.significant_sigmas)
    )
    needed = np.zeros(len(fit_state.free), dtype=bool)
    matrix, gradient, _ = fit_state.normal_equations()
    for name, members in GROUPS.items():
        if scene.response_bend is not None and name in OF_RESPONSE:
            continue
        group = size + np.array(FULL.indices(*members))
        required = size + np.array(FULL.indices(*_NEEDS.get(name, ())), dtype=int)
        if fit_state.free[required].all() and not fit_state.free[group].any():
            needed[group] = _has_score(
                matrix, gradient, fit_state.free, group, spread, tuning.evidence
            )
    spread = min(spread, tuning.largest_inflation)
    light = size + np.array(FULL.uneven_light_indices)
    is_uneven = not scene.has_local_light and (
        _has_score(matrix, gradient, fit_state.free, light, spread, tuning.evidence)
        or _has_block_means(scene, standard * fit_state.inliers, fit_state.inliers, spread)
    )
    return ImageEvidence(needed, is_uneven)


def _has_score(
    matrix: Float[np.ndarray, "k k"],
    gradient: Float[np.ndarray, "k"],
    free: Bool[np.ndarray, "k"],
    group: Int[np.ndarray, "m"],
    spread: float,
    evidence: float,
) -> bool:
    """True if the score test of a group of fixed unknowns is significant.

    group : indices of the group's unknowns.
    spread : variance of the scores divided by that for uncorrelated noise.
    evidence : required decrease of chi-square beyond the number of unknowns.
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    matrix, gradient = matrix * scale[:, None] * scale, gradient * scale
    across = matrix[np.ix_(free, group)]
    side = np.column_stack([across, gradient[free]])
    solved = np.linalg.lstsq(matrix[np.ix_(free, free)], side)[0]
    inner = matrix[np.ix_(group, group)] - across.T @ solved[:, :-1]
    score = gradient[group] - across.T @ solved[:, -1]
    inner = inner + 1e-7 * np.eye(len(group))
    statistic = float(score @ np.linalg.solve(inner, score)) / spread
    return statistic > 2 * len(group) + evidence


def _has_block_means(
    scene: PixelScene,
    residual: Float[np.ndarray, "n"],
    inliers: Bool[np.ndarray, "n"],
    spread: float,
) -> bool:
    """True if the mean residuals of the blocks of the sheet differ significantly from 0.

    residual : (n,) residuals divided by their standard deviations; 0 for outliers.
    spread : variance of a mean divided by that for uncorrelated noise.
    """
    blocks = scene.blocks
    assert blocks is not None
    count = np.bincount(blocks.of_pixel, inliers, minlength=blocks.count)
    total = np.bincount(blocks.of_pixel, residual, minlength=blocks.count)
    statistic = np.sum(total**2 / np.maximum(count, 1)) / spread
    return _is_large(float(statistic), int(np.sum(count > 0)), scene.tuning)


def _has_bin_means(
    residual: Float[np.ndarray, "n"], bin_index: Int[np.ndarray, "n"], tuning: PhotometricTuning
) -> bool:
    """True if the mean residuals of bins differ significantly from 0.

    bin_index : (n,) bin of each residual.
    """
    count = np.bincount(bin_index)
    mean = np.bincount(bin_index, residual) / np.maximum(count, 1)
    spread = np.bincount(bin_index, residual**2) / np.maximum(count, 1)
    enough = count >= tuning.fewest_pixels
    statistic = np.sum(count[enough] * mean[enough] ** 2 / np.maximum(spread[enough], 1e-12))
    return _is_large(statistic, int(enough.sum()), tuning)


def _has_constant_variance(
    residual: Float[np.ndarray, "n"], bins: Int[np.ndarray, "n"], tuning: PhotometricTuning
) -> bool:
    """True if the residuals on paper, on ink and on edges have nearly the same variance.

    bins : (n,) bin of each residual by the share of ink in the pixel.
    """
    variance = [
        float(np.mean(residual[mask] ** 2))
        for mask in (bins == 0, bins == _SHARE_BINS - 1, (bins > 3) & (bins < _SHARE_BINS - 4))
        if mask.sum() >= 10 * tuning.fewest_pixels
    ]
    return not variance or max(variance) <= tuning.largest_variance_ratio * min(variance)


def _neighbours_are_correlated(
    grid: PixelGrid,
    residual: Float[np.ndarray, "n"],
    inliers: Bool[np.ndarray, "n"],
    largest_correlation: float,
) -> bool:
    """True if the correlation of neighbouring residuals exceeds `largest_correlation`."""
    variance = np.sum(residual**2) / max(inliers.sum(), 1)
    for down, right in [(0, 1), (1, 0), (1, 1), (0, 2), (2, 0)]:
        here, there = grid.pairs(down, right)
        pairs = max(np.count_nonzero(inliers[here] & inliers[there]), 1)
        covariance = float(residual[here] @ residual[there]) / pairs / max(variance, 1e-12)
        if abs(covariance) > largest_correlation + 3 / np.sqrt(pairs):
            return True
    return False


def _width_depends_on_direction(
    grey: Float[np.ndarray, "n"],
    grid: PixelGrid,
    share: Float[np.ndarray, "m"],
    inliers: Bool[np.ndarray, "n"],
    residual: Float[np.ndarray, "m"],
    tuning: PhotometricTuning,
) -> bool:
    """True if the blur of edges depends significantly on the direction of the edges.

    At an edge that is wider than predicted, the residuals have opposite signs on the two sides. The
    test correlates the residuals with this sign times cosine and sine of twice the angle of the
    gradient.

    grey : (n,) grey levels of all pixels.
    share : (m,) share of ink in each inlier pixel.
    residual : (m,) residuals of the inlier pixels.
    """
    sides = (0, 1), (0, -1), (1, 0), (-1, 0)
    neighbours = [grid.neighbours(down, right) for down, right in sides]
    right, minus_u, below, above = (grey[index[inliers]] for index in neighbours)
    usable = np.all([index[inliers] >= 0 for index in neighbours], axis=0)
    u, v = 0.5 * (right - minus_u), 0.5 * (below - above)
    usable &= (share > tuning.flat_share) & (share < 1 - tuning.flat_share)
    length = np.maximum(u * u + v * v, 1e-12)
    side = np.where(share > 0.5, 1.0, -1.0) * usable * (np.abs(share - 0.5) > tuning.flat_share)
    even, odd = side * (u * u - v * v) / length, side * 2 * u * v / length
    statistic = sum(
        float(np.sum(residual * wave)) ** 2 / max(float(np.sum((residual * wave) ** 2)), 1e-12)
        for wave in (even, odd)
    )
    return _is_large(statistic, 2, tuning)


def _is_large(statistic: float, freedom: int, tuning: PhotometricTuning) -> bool:
    """True if a chi-square statistic is so large that chance explains it once in 10^7 tests only.

    freedom : degrees of freedom.
    """
    limit = freedom + tuning.chi_square_sigmas * np.sqrt(2 * max(freedom, 1)) + tuning.evidence
    return bool(statistic > limit)
