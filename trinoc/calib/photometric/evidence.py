"""Do a picture's residuals call for more than an ideal camera, and for which unknowns?

Under a model, residuals have no mean anywhere: not by the share of ink (a response, another
kernel), not by the direction of the edge (motion), not by the place on the sheet (uneven light).
Nor do they have another variance by grey level, or neighbours in common. `find_refuted_part` looks
at that without a Jacobian; `find_evidence` tests the score of each group of unknowns that is held.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.photometric.fit_state import PictureFitState
from trinoc.calib.photometric.noise import OnGrid, autocorrelation, inflation, saturation_level
from trinoc.calib.photometric.scene import PixelScene
from trinoc.calib.photometric.unknowns import DELIVERED
from trinoc.calib.tuning.photometric import PhotometricTuning

# numerical: bins of a test, by the share of ink, and by place: squares of the picture, 6 a side.
_SHARE_BINS, _PLACE_BINS = 16, 6

# Unknowns that are freed together, by name; the first of the second pair must be free already.
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
# Free from the first step on: without them a picture's outliers are told wrongly.
FIRST = ("bend", "kurtosis", "along_u", "diagonal", "lobe")
# Held where the response is known.
OF_RESPONSE = ("bend", "contrast", "lift")


def find_refuted_part(
    scene: PixelScene, point: PictureFitState
) -> Literal["nothing", "noise", "model"]:
    """Whether the picture needs more than an ideal camera, or noise that depends on the level.

    point : where the fit of an ideal camera ended.
    """
    kept, residual = point.kept, point.level - scene.grey
    light = scene.polynomial_light(point.state)
    share = (point.level / light - 1) / float(point.state["ratio"])
    at = np.stack([scene.chosen.column, scene.chosen.row], axis=1)[kept]
    r, share = residual[kept], share[kept]
    # Saturated pixels that the gate has cut are a glare's.
    tuning = scene.tuning
    if np.isfinite(saturation_level(scene.grey[kept], tuning.piled_share)):
        return "model"
    variance = float(np.mean(r**2))
    if 0 < tuning.largest_variance_ratio * scene.noise_floor**2 < variance:
        return "model"
    grid = scene.grid
    if _neighbours_agree(grid, residual * kept, kept, tuning.largest_correlation):
        return "model"
    bins = np.clip((share * _SHARE_BINS).astype(int), 0, _SHARE_BINS - 1)
    near_line = (np.arange(len(kept)) >= scene.counts[0])[kept]
    by_share = bins + _SHARE_BINS * near_line
    if _have_means(r, by_share, tuning):
        return "model"
    size = np.ptp(at, axis=0) + 1
    column, row = ((at - at.min(axis=0)) * _PLACE_BINS // size).T
    paper = tuning.flat_share
    flat = np.where(share < paper, 0, np.where(share > 1 - paper, 1, 2))
    by_place = (column * _PLACE_BINS + row) * 3 + flat
    if _have_means(r[flat < 2], by_place[flat < 2], tuning):
        return "model"
    if _have_direction(scene.grey, grid, share, kept, r, tuning):
        return "model"
    return "nothing" if _have_one_variance(r, bins, tuning) else "noise"


class PictureEvidence(NamedTuple):
    """What residuals call for: unknowns to free, and whether light must be local."""

    free: Bool[np.ndarray, "k"]
    uneven_light: bool


def find_evidence(scene: PixelScene, point: PictureFitState) -> PictureEvidence:
    """Score tests of each group that is held.

    The scores' variance is that of correlated residuals.
    """
    size = scene.model.size
    residual, sigma = point.residual(scene)
    standard = residual / sigma
    tuning = scene.tuning
    spread = inflation(autocorrelation(scene.grid, standard, point.kept, tuning.significant_sigmas))
    more = np.zeros(len(point.free), dtype=bool)
    matrix, gradient, _ = point.normal_equations()
    for name, members in GROUPS.items():
        if scene.bend is not None and name in OF_RESPONSE:
            continue
        places = size + np.array(DELIVERED.places(*members))
        needed = size + np.array(DELIVERED.places(*_NEEDS.get(name, ())), dtype=int)
        if point.free[needed].all() and not point.free[places].any():
            more[places] = _has_score(matrix, gradient, point.free, places, spread, tuning.evidence)
    spread, of_light = (
        min(spread, tuning.largest_inflation),
        size + np.array(DELIVERED.of_uneven_light),
    )
    uneven = not scene.local and (
        _has_score(matrix, gradient, point.free, of_light, spread, tuning.evidence)
        or _has_block_means(scene, standard * point.kept, point.kept, spread)
    )
    return PictureEvidence(more, uneven)


def _has_score(
    matrix: Float[np.ndarray, "k k"],
    gradient: Float[np.ndarray, "k"],
    free: Bool[np.ndarray, "k"],
    places: Int[np.ndarray, "m"],
    spread: float,
    evidence: float,
) -> bool:
    """Whether the score of fixed unknowns is larger than chance."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    matrix, gradient = matrix * scale[:, None] * scale, gradient * scale
    across = matrix[np.ix_(free, places)]
    side = np.column_stack([across, gradient[free]])
    solved = np.linalg.lstsq(matrix[np.ix_(free, free)], side)[0]
    inner = matrix[np.ix_(places, places)] - across.T @ solved[:, :-1]
    score = gradient[places] - across.T @ solved[:, -1]
    inner = inner + 1e-7 * np.eye(len(places))
    statistic = float(score @ np.linalg.solve(inner, score)) / spread
    return statistic > 2 * len(places) + evidence


def _has_block_means(
    scene: PixelScene, residual: Float[np.ndarray, "n"], kept: Bool[np.ndarray, "n"], spread: float
) -> bool:
    blocks = scene.blocks
    assert blocks is not None
    count = np.bincount(blocks.of_pixel, kept, minlength=blocks.count)
    total = np.bincount(blocks.of_pixel, residual, minlength=blocks.count)
    statistic = np.sum(total**2 / np.maximum(count, 1)) / spread
    return _is_large(float(statistic), int(np.sum(count > 0)), scene.tuning)


def _have_means(
    r: Float[np.ndarray, "n"], label: Int[np.ndarray, "n"], tuning: PhotometricTuning
) -> bool:
    count = np.bincount(label)
    mean = np.bincount(label, r) / np.maximum(count, 1)
    spread = np.bincount(label, r**2) / np.maximum(count, 1)
    enough = count >= tuning.fewest_pixels
    statistic = np.sum(count[enough] * mean[enough] ** 2 / np.maximum(spread[enough], 1e-12))
    return _is_large(statistic, int(enough.sum()), tuning)


def _have_one_variance(
    r: Float[np.ndarray, "n"], bins: Int[np.ndarray, "n"], tuning: PhotometricTuning
) -> bool:
    variance = [
        float(np.mean(r[chosen] ** 2))
        for chosen in (bins == 0, bins == _SHARE_BINS - 1, (bins > 3) & (bins < _SHARE_BINS - 4))
        if chosen.sum() >= 10 * tuning.fewest_pixels
    ]
    return not variance or max(variance) <= tuning.largest_variance_ratio * min(variance)


def _neighbours_agree(
    grid: OnGrid,
    r: Float[np.ndarray, "n"],
    kept: Bool[np.ndarray, "n"],
    largest_correlation: float,
) -> bool:
    variance = np.sum(r**2) / max(kept.sum(), 1)
    for down, right in [(0, 1), (1, 0), (1, 1), (0, 2), (2, 0)]:
        here, there = grid.pairs(down, right)
        pairs = max(np.count_nonzero(kept[here] & kept[there]), 1)
        shared = float(r[here] @ r[there]) / pairs / max(variance, 1e-12)
        if abs(shared) > largest_correlation + 3 / np.sqrt(pairs):
            return True
    return False


def _have_direction(
    grey: Float[np.ndarray, "n"],
    grid: OnGrid,
    share: Float[np.ndarray, "m"],
    kept: Bool[np.ndarray, "n"],
    r: Float[np.ndarray, "m"],
    tuning: PhotometricTuning,
) -> bool:
    """Whether edges of some direction are wider than others.

    What a wider edge adds on its one side it takes from the other: the sign of share - 1/2
    times cos and sin of twice the angle of the light's gradient.
    """
    sides = (0, 1), (0, -1), (1, 0), (-1, 0)
    around = [grid.neighbours(down, right) for down, right in sides]
    right, left, below, above = (grey[there[kept]] for there in around)
    usable = np.all([there[kept] >= 0 for there in around], axis=0)
    u, v = 0.5 * (right - left), 0.5 * (below - above)
    usable &= (share > tuning.flat_share) & (share < 1 - tuning.flat_share)
    length = np.maximum(u * u + v * v, 1e-12)
    side = np.where(share > 0.5, 1.0, -1.0) * usable * (np.abs(share - 0.5) > tuning.flat_share)
    even, odd = side * (u * u - v * v) / length, side * 2 * u * v / length
    statistic = sum(
        float(np.sum(r * wave)) ** 2 / max(float(np.sum((r * wave) ** 2)), 1e-12)
        for wave in (even, odd)
    )
    return _is_large(statistic, 2, tuning)


def _is_large(statistic: float, freedom: int, tuning: PhotometricTuning) -> bool:
    usual = freedom + tuning.chi_square_sigmas * np.sqrt(2 * max(freedom, 1))
    return bool(statistic > usual + tuning.evidence)
