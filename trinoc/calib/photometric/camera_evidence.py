"""Which of a camera's ways a picture shows: score tests of the unknowns that are held."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.camera_scene import CameraScene
from trinoc.calib.photometric.camera_steps import Equations
from trinoc.calib.photometric.correlated_noise import autocorrelation, inflation
from trinoc.calib.photometric.local_light import Blocks

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
_NEEDS = {"line": "along_u", "lobe shape": "lobe"}
# Free from the first step on: without them a picture's outliers are told wrongly.
FIRST = ("bend", "kurtosis", "along_u", "diagonal", "lobe")
# Held where the response is known.
OF_RESPONSE = ("bend", "contrast", "lift")
# Chi-square above twice its degrees of freedom (Akaike) by this much frees a group.
_EVIDENCE = 12.0
# Uneven light itself makes neighbours agree; noise does no more than this.
_LARGEST_SPREAD = 5.0


class Evidence(NamedTuple):
    """What the residuals ask for: unknowns to free, and whether light must be local."""

    free: list[int]
    uneven_light: bool


def evidence_for_more(
    scene: CameraScene, sums: Equations, active: list[int], blocks: Blocks
) -> Evidence:
    """Score tests of each group that is held.

    The scores' variance is that of correlated residuals.
    """
    layout = scene.layout
    residual = sums.residual / sums.sigma
    spread = inflation(autocorrelation(scene.grid, residual, sums.weight > 0))
    held, free = set(range(layout.size)) - set(active), []
    for name, members in GROUPS.items():
        if scene.bend is not None and name in OF_RESPONSE:
            continue
        places = layout.look(*members)
        needed = _NEEDS.get(name)
        ready = needed is None or layout.look(needed)[0] in active
        if ready and held.issuperset(places) and _asked_for(sums, active, places, spread):
            free += places
    spread = min(spread, _LARGEST_SPREAD)
    uneven = scene.blocks is None and (
        _asked_for(sums, active, layout.uneven_light, spread)
        or _has_block_means(blocks, residual, sums.weight > 0, spread)
    )
    return Evidence(free, uneven)


def _has_block_means(
    blocks: Blocks, residual: Float[np.ndarray, "n"], kept: Bool[np.ndarray, "n"], spread: float
) -> bool:
    count = np.bincount(blocks.of_pixel, kept, minlength=blocks.count)
    total = np.bincount(blocks.of_pixel, residual * kept, minlength=blocks.count)
    statistic = np.sum(total**2 / np.maximum(count, 1)) / spread
    freedom = np.sum(count > 0)
    return bool(statistic > freedom + 5 * np.sqrt(2 * freedom) + _EVIDENCE)


def _asked_for(sums: Equations, active: list[int], places: list[int], spread: float) -> bool:
    matrix, gradient = sums.matrix, sums.gradient
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    matrix, gradient = matrix * scale[:, None] * scale, gradient * scale
    across = matrix[np.ix_(active, places)]
    side = np.column_stack([across, gradient[active]])
    solved = np.linalg.lstsq(matrix[np.ix_(active, active)], side)[0]
    inner = matrix[np.ix_(places, places)] - across.T @ solved[:, :-1]
    score = gradient[places] - across.T @ solved[:, -1]
    inner = inner + 1e-7 * np.eye(len(places))
    statistic = float(score @ np.linalg.solve(inner, score)) / spread
    return statistic > 2 * len(places) + _EVIDENCE
