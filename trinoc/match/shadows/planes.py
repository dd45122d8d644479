"""Planes that lines of the scene lie in: what shadows fall on."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.tuning import ShadowTuning
from trinoc.numerics import cross_3d


class Plane(NamedTuple):
    """normal : unit, toward the cameras. members : the lines in it."""

    normal: Float[np.ndarray, "3"]
    members: Bool[np.ndarray, "e"]


def planes_of(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    cameras_mm: Float[np.ndarray, "3"],
    tuning: ShadowTuning,
) -> list[Plane]:
    """Planes that two lines that are not parallel suggest, those of the longest lines first.

    `cameras_mm` is the middle of the cameras. A line may lie in several planes.
    """
    length = np.linalg.norm(lines_mm[:, 1] - lines_mm[:, 0], axis=1)
    way = (lines_mm[:, 1] - lines_mm[:, 0]) / length[:, None]
    first, second = np.triu_indices(len(lines_mm), 1)
    normal = cross_3d(way[first], way[second])
    sine = np.linalg.norm(normal, axis=1)
    turned = sine > tuning.least_sine
    first, second, normal = first[turned], second[turned], normal[turned] / sine[turned, None]
    offset = 0.5 * np.einsum("pi,pi->p", normal, lines_mm[first, 0] + lines_mm[second, 0])
    near = _within(lines_mm, covariance_mm2, normal, offset, length, tuning)
    order = np.arange(len(first))
    good = near[order, first] & near[order, second]
    normal, offset, near = normal[good], offset[good], near[good]
    weight = near @ np.minimum(length, np.median(length) if len(length) else 0.0)
    left, found = np.ones(len(normal), dtype=bool), []
    while left.any():
        best = int(np.argmax(np.where(left, weight, -1.0)))
        members = near[best]
        if members.sum() < tuning.fewest_in_plane:
            break
        points = lines_mm[members].reshape(-1, 3)
        middle = points.mean(axis=0)
        across = np.linalg.svd(points - middle)[2][2]
        across = across if across @ (cameras_mm - middle) > 0 else -across
        fit = (across[None], (across @ middle)[None])
        own = _within(lines_mm, covariance_mm2, *fit, length, tuning)[0]
        if own.sum() >= tuning.fewest_in_plane:
            found.append(Plane(across, own))
        left &= (near & members).sum(axis=1) < 0.5 * near.sum(axis=1)
        left[best] = False
    return found


def _within(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    normal: Float[np.ndarray, "p 3"],
    offset: Float[np.ndarray, "p"],
    length: Float[np.ndarray, "e"],
    tuning: ShadowTuning,
) -> Bool[np.ndarray, "p e"]:
    """Which lines lie in which plane with both ends, and are known well enough to tell."""
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    own = np.stack([blocks[:, 0, :, 0], blocks[:, 1, :, 1]], axis=1)
    outer = normal[:, :, None] * normal[:, None]
    sigma = np.sqrt(np.maximum(np.tensordot(outer, own, axes=([1, 2], [2, 3])), 0.0))
    gap = np.abs(np.tensordot(normal, lines_mm, axes=(1, 2)) - offset[:, None, None])
    scale = tuning.flatness * np.median(length)
    near = (gap < tuning.plane_sigmas * sigma + scale) & (sigma < 5 * scale)
    return near.all(axis=2)
