"""Which lines in space may be one, and how dense those are that are not."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.line_map.collinearity import Difference, LineDensity
from trinoc.match.tuning import DEFAULT, CollinearTuning, EvidenceTuning
from trinoc.numerics import blocks

# Lines compared with all others at once.
ROWS_IN_BLOCK = 512


def line_density(
    ends_mm: Float[np.ndarray, "t 2 3"], tuning: EvidenceTuning = DEFAULT.evidence
) -> LineDensity:
    """How dense lines of any direction are: as if evenly in a box that has their spread."""
    middles, length = ends_mm.mean(axis=1), np.linalg.norm(ends_mm[:, 1] - ends_mm[:, 0], axis=1)
    longest = float(length.max())
    # A few lines do not tell where others might be.
    few = np.full(3, longest**2 / 12)
    variance = np.linalg.eigvalsh(np.cov(middles.T)) if len(middles) > 3 else few
    size = max(float(np.sqrt(12 * max(variance.max(), 0.0))), longest)
    sides = np.maximum(np.sqrt(12 * np.maximum(variance, 0.0)), tuning.thinnest * size)
    volume = float(np.prod(sides))
    return LineDensity(float(length.sum()) / (2 * np.pi * volume), size, volume)


class NearbyLines(NamedTuple):
    """Pairs of lines that may be one, and the distances of others that run beside each.

    pairs : (p, 2) the first less than the second. beside_mm : (t, k) of the nearest parallel
        lines that are not among the pairs, inf where there are fewer.
    """

    pairs: Int[np.ndarray, "p 2"]
    beside_mm: Float[np.ndarray, "t k"]


def nearby_lines(
    ends_mm: Float[np.ndarray, "t 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
    tuning: CollinearTuning = DEFAULT.collinear,
) -> NearbyLines:
    """Look through all lines for those nearly in a row, a block at a time."""
    count = len(ends_mm)
    middle, way = ends_mm.mean(axis=1), ends_mm[:, 1] - ends_mm[:, 0]
    length = np.linalg.norm(way, axis=1)
    unit = way / length[:, None]
    sigma = np.sqrt(_across_variance(unit, covariance_mm2))
    angle = np.radians(tuning.parallel_deg) + tuning.parallel_sigmas * sigma / length
    angle = np.minimum(angle, np.radians(tuning.widest_deg))
    pairs, beside = [], np.full((count, tuning.nearest), np.inf)
    for rows in blocks(count, ROWS_IN_BLOCK):
        cosine = np.minimum(np.abs(unit[rows] @ unit.T), 1.0)
        limit = np.maximum(angle[rows, None], angle)
        i, j = np.nonzero(cosine > np.cos(limit))
        i, j = i[i + rows.start != j] + rows.start, j[i + rows.start != j]
        apart = middle[j] - middle[i]
        square = (apart**2).sum(axis=1)
        along = np.stack([(apart * unit[i]).sum(axis=1), (apart * unit[j]).sum(axis=1)])
        distance = np.sqrt(np.maximum(square - along**2, 0.0)).min(axis=0)
        reach = np.abs(along).max(axis=0)
        # Each is known worse the further its line is carried.
        known = sigma[i] * (1 + 2 * reach / length[i]) + sigma[j] * (1 + 2 * reach / length[j])
        close = distance < tuning.gate_sigmas * known
        pairs.append(np.stack([i, j], axis=1)[close & (i < j)])
        _keep_nearest(beside, i[~close], distance[~close])
    return NearbyLines(np.concatenate(pairs), beside)


def parallel_density(
    near: NearbyLines,
    apart: Difference,
    scene: LineDensity,
    tuning: CollinearTuning = DEFAULT.collinear,
) -> Float[np.ndarray, "t"]:
    """Lines parallel to each, per area across: as dense as about it, or as about most."""
    beside = near.beside_mm.copy()
    other = apart.square > tuning.different
    for side in (0, 1):
        _keep_nearest(beside, near.pairs[other, side], apart.shift[other])
    local = tuning.nearest / (np.pi * beside[:, -1] ** 2 + np.finfo(float).tiny)
    return np.maximum(local, max(float(np.median(local)), 1 / scene.size**2))


def _keep_nearest(
    beside_mm: Float[np.ndarray, "t k"],
    row: Int[np.ndarray, "q"],
    distance: Float[np.ndarray, "q"],
) -> None:
    """Put into `beside_mm` what is nearer than what is there."""
    row = np.concatenate([np.repeat(np.arange(len(beside_mm)), beside_mm.shape[1]), row])
    distance = np.concatenate([beside_mm.reshape(-1), distance])
    order = np.lexsort((distance, row))
    row, distance = row[order], distance[order]
    rank = np.arange(len(row)) - np.searchsorted(row, row)
    keep = rank < beside_mm.shape[1]
    beside_mm[row[keep], rank[keep]] = distance[keep]


def _across_variance(
    unit: Float[np.ndarray, "t 3"], covariance_mm2: Float[np.ndarray, "t 6 6"]
) -> Float[np.ndarray, "t"]:
    """The larger of the two ends' variances across the line, in all directions together."""
    blocks_of_ends = np.stack([covariance_mm2[:, :3, :3], covariance_mm2[:, 3:, 3:]], axis=1)
    along = np.einsum("ti,teij,tj->te", unit, blocks_of_ends, unit)
    return np.maximum(np.trace(blocks_of_ends, axis1=2, axis2=3) - along, 0.0).max(axis=1)
