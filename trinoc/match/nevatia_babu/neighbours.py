"""The pull of neighbouring edges, taken out of the positions of edge points.

Two edges closer than a few widths of the profile overlap in the gradient, and each shifts
the other's peak. Once all lines are known, what each neighbour adds to the three samples of
a point's profile can be computed and subtracted, and the point located again.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from scipy.special import erf

from trinoc.match.nevatia_babu.ends import line_samples
from trinoc.match.nevatia_babu.line_fit import FittedLines
from trinoc.match.nevatia_babu.runs import members
from trinoc.match.nevatia_babu.edge_points import EdgePoints

REACH_PX = 6.0
# Fourth cumulant of the kernel's profile: its tails fall faster than a Gaussian's.
_TAIL = 2.6 / 24
_LEAST_SHARE = 0.3
_LEAST_PULL = 0.002
# In pixels of the level.
_FARTHEST = 1.5


def line_pairs_within(
    lines: FittedLines, reach_px: float
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """(one, other): all ordered pairs of different lines closer than about `reach_px`."""
    none = np.zeros(0, dtype=np.int64)
    if len(lines.support) < 2:
        return none, none
    spacing = 3.0
    owner, samples = line_samples(lines.centre_px, lines.direction, lines.extent_px, spacing)
    near = KDTree(samples).query_pairs(reach_px + spacing, output_type="ndarray")
    one, other = owner[near[:, 0]], owner[near[:, 1]]
    different = one != other
    one, other = one[different], other[different]
    key = np.unique(np.concatenate([one * len(owner) + other, other * len(owner) + one]))
    return np.divmod(key, len(owner))


def without_neighbours(
    points: EdgePoints,
    first: Int[np.ndarray, "r"],
    lines: FittedLines,
    blur_px2: Float[np.ndarray, "r"],
    pairs: tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]],
) -> EdgePoints:
    """The points, located again in profiles from which neighbouring lines are subtracted.

    `points` lie line after line, line k from first[k] on; `blur_px2` is the variance of each
    line's own blur, `pairs` come from `line_pairs_within`. Points of which a neighbour makes
    up most keep next to no weight.
    """
    one, other = pairs
    if len(one) == 0:
        return points
    stop = np.append(first[1:], len(points.pixel))
    point, pair, _ = members(first[one], stop[one])
    other = other[pair]
    direction = lines.direction[other]
    offset = points.sample_px[point] - lines.centre_px[other]
    along = (offset * direction).sum(axis=-1)
    # Toward the brighter side, which is on the left of the direction.
    across = offset[:, 0] * direction[:, 1] - offset[:, 1] * direction[:, 0]
    extent = lines.extent_px[other]
    near = np.flatnonzero(
        (np.abs(across) < REACH_PX)
        & (along > extent[:, 0] - REACH_PX)
        & (along < extent[:, 1] + REACH_PX)
    )
    point, other, along, across = point[near], other[near], along[near], across[near]
    direction, extent = direction[near], extent[near]
    normal = np.stack([direction[:, 1], -direction[:, 0]], axis=-1)
    cosine = (normal * points.normal[point]).sum(axis=-1)
    axis, spacing = points.along_u[point], points.spacing_px[point]
    step_along = np.where(axis, direction[:, 0], direction[:, 1]) * spacing
    step_across = np.where(axis, normal[:, 0], normal[:, 1]) * spacing
    variance = points.kernel_variance_px2[point] + blur_px2[other]
    height = lines.contrast[other] / np.sqrt(2 * np.pi * variance) * cosine
    added = np.zeros((len(points.pixel), 3))
    for sample, step in enumerate((-1, 0, 1)):
        t, d = along + step * step_along, across + step * step_across
        window = _step(t - extent[:, 0], variance) - _step(t - extent[:, 1], variance)
        shape = np.exp(-d * d / (2 * variance) - _TAIL * d**4 / variance**4)
        added[:, sample] = np.bincount(point, height * shape * window, len(points.pixel))
    return _located_again(points, added)


def _step(offset: Float[np.ndarray, "m"], variance: Float[np.ndarray, "m"]) -> np.ndarray:
    """Smoothed unit step."""
    return 0.5 * erf(offset / np.sqrt(2 * variance))


def _located_again(points: EdgePoints, added: Float[np.ndarray, "n 3"]) -> EdgePoints:
    touched = np.flatnonzero(np.abs(added).max(axis=1) > _LEAST_PULL * points.profile[:, 1])
    before = points.select(touched)
    profile = before.profile - added[touched]
    middle = profile[:, 1]
    located, variance = before.located(np.maximum(profile, 1e-3 * middle[:, None]))
    share = middle / before.profile[:, 1]
    usable = (
        (share > _LEAST_SHARE)
        & (profile > 0.02 * middle[:, None]).all(axis=1)
        & (np.abs(located - before.sample_px).max(axis=1) < _FARTHEST * before.spacing_px)
    )
    share = np.where(usable, share, 1e-3)
    uv_px, sharpness = points.uv_px.copy(), points.sharpness.copy()
    strength, information = points.strength.copy(), points.information.copy()
    uv_px[touched[usable]] = located[usable]
    sharpness[touched[usable]] = ((before.kernel_variance_px2 + 1) / variance)[usable]
    strength[touched] = before.profile[:, 1] * share
    # Relative to the profile as measured: the points may have been cleaned before.
    information[touched] = before.information * np.square(
        before.profile[:, 1] * share / before.strength
    )
    return points._replace(
        uv_px=uv_px, sharpness=sharpness, strength=strength, information=information
    )
