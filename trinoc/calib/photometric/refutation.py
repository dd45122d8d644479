"""Do a picture's residuals refute the model of an ideal camera? Cheap tests, without its Jacobian.

Under the model, residuals have no mean anywhere: not by the share of ink (a response, another
kernel), not by the direction of the edge (motion), not by the place on the sheet (uneven light).
Nor do they have another variance by grey level, or neighbours in common.
"""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.appearance import Appearance
from trinoc.calib.photometric.camera_scene import CameraScene
from trinoc.calib.photometric.clipped_noise import saturation_level

_SHARE_BINS = 16
# Squares of the picture, 6 a side.
_PLACE_BINS = 6
_PAPER, _INK = 0.1, 0.9
_FEWEST_PIXELS = 20
# Chi-square with n degrees of freedom passes n + 5 sqrt(2 n) + 12 by chance once in 10^7.
_SIGMAS, _OFFSET = 5.0, 12.0
_LARGEST_VARIANCE_RATIO = 1.4
_LARGEST_CORRELATION = 0.05
# Variance of the residuals over that of the flat parts.
_LARGEST_CHI_SQUARE = 1.3


def refuted_part(
    scene: CameraScene,
    appearance: Appearance,
    residual: Float[np.ndarray, "n"],
    kept: Bool[np.ndarray, "n"],
    noise_floor: float,
) -> Literal["nothing", "noise", "model"]:
    """Whether the picture needs more than an ideal camera, or noise that depends on the level.

    residual, kept : of the simple model's last step, predicted minus observed.
    """
    light = np.asarray(appearance.light) @ scene.terms[: len(appearance.light)]
    share = ((scene.grey + residual) / light - 1) / float(appearance.ratio)
    r, share, at = residual[kept].astype(np.float64), share[kept], scene.uv_px[kept]
    # Saturated pixels that the gate has cut are a glare's.
    if np.isfinite(saturation_level(scene.grey[kept])):
        return "model"
    variance = float(np.mean(r**2))
    if noise_floor > 0 and variance > _LARGEST_CHI_SQUARE * noise_floor**2:
        return "model"
    if _neighbours_agree(scene, residual * kept, kept):
        return "model"
    bins = np.clip((share * _SHARE_BINS).astype(int), 0, _SHARE_BINS - 1)
    near_line = (np.arange(len(kept)) >= scene.counts[0])[kept]
    by_share = bins + _SHARE_BINS * near_line
    if _have_means(r, by_share):
        return "model"
    size = np.ptp(at, axis=0) + 1
    column, row = ((at - at.min(axis=0)) * _PLACE_BINS // size).T
    flat = np.where(share < _PAPER, 0, np.where(share > _INK, 1, 2))
    by_place = (column * _PLACE_BINS + row) * 3 + flat
    if _have_means(r[flat < 2], by_place[flat < 2]):
        return "model"
    if _have_direction(scene, share, kept, r):
        return "model"
    return "nothing" if _have_one_variance(r, bins) else "noise"


def _have_means(r: Float[np.ndarray, "n"], label: np.ndarray) -> bool:
    count = np.bincount(label)
    mean = np.bincount(label, r) / np.maximum(count, 1)
    spread = np.bincount(label, r**2) / np.maximum(count, 1)
    seen = count >= _FEWEST_PIXELS
    statistic = np.sum(count[seen] * mean[seen] ** 2 / np.maximum(spread[seen], 1e-12))
    return _is_large(statistic, int(seen.sum()))


def _have_one_variance(r: Float[np.ndarray, "n"], bins: np.ndarray) -> bool:
    variance = [
        float(np.mean(r[chosen] ** 2))
        for chosen in (bins == 0, bins == _SHARE_BINS - 1, (bins > 3) & (bins < _SHARE_BINS - 4))
        if chosen.sum() >= 10 * _FEWEST_PIXELS
    ]
    return not variance or max(variance) <= _LARGEST_VARIANCE_RATIO * min(variance)


def _neighbours_agree(
    scene: CameraScene, r: Float[np.ndarray, "n"], kept: Bool[np.ndarray, "n"]
) -> bool:
    grid = scene.grid
    variance = np.sum(r**2) / max(kept.sum(), 1)
    for down, right in [(0, 1), (1, 0), (1, 1), (0, 2), (2, 0)]:
        here, there = grid.pairs(down, right)
        pairs = max(np.count_nonzero(kept[here] & kept[there]), 1)
        shared = float(r[here] @ r[there]) / pairs / max(variance, 1e-12)
        if abs(shared) > _LARGEST_CORRELATION + 3 / np.sqrt(pairs):
            return True
    return False


def _have_direction(
    scene: CameraScene,
    share: Float[np.ndarray, "m"],
    kept: Bool[np.ndarray, "n"],
    r: Float[np.ndarray, "m"],
) -> bool:
    """Whether edges of some direction are wider than others.

    What a wider edge adds on its one side it takes from the other: the sign of share - 1/2
    times cos and sin of twice the angle of the light's gradient.
    """
    around = [
        scene.grid.neighbours(down, right) for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0))
    ]
    right, left, below, above = (scene.grey[there][kept] for there in around)
    usable = np.all([there[kept] >= 0 for there in around], axis=0)
    u, v = 0.5 * (right - left), 0.5 * (below - above)
    usable &= (share > _PAPER) & (share < _INK)
    length = np.maximum(u * u + v * v, 1e-12)
    side = np.where(share > 0.5, 1.0, -1.0) * usable * (np.abs(share - 0.5) > _PAPER)
    even, odd = side * (u * u - v * v) / length, side * 2 * u * v / length
    statistic = sum(
        float(np.sum(r * wave)) ** 2 / max(float(np.sum((r * wave) ** 2)), 1e-12)
        for wave in (even, odd)
    )
    return _is_large(statistic, 2)


def _is_large(statistic: float, freedom: int) -> bool:
    return bool(statistic > freedom + _SIGMAS * np.sqrt(2 * max(freedom, 1)) + _OFFSET)
