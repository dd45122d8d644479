"""How much likelier two lines in space are pieces of one straight line than two lines.

Lines are compared at two places along them, at the ends of what both span. There they differ by
four numbers d, two offsets at each place, with the covariance S of both lines. H1, one line: d is
N(0, S). H0a, a parallel edge: the lateral offset is uniform with the local density of parallel
lines, the rest is N(0, S). H0b, an unrelated line: uniform with the density of all lines.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.evidence import EvidenceTuning
from trinoc.match.tuning.line_map import CollinearTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.vectors import complete_axes


class LineDensity(NamedTuple):
    """How dense lines are, in mm.

    density : lines of any direction, per area that they cross and per steradian.
    size, volume : the distance over which they are spread, and the box that holds them.
    """

    density: float
    size: float
    volume: float


class Difference(NamedTuple):
    """What tells two lines apart: `square` is d' S^-1 d.

    log_density, log_shift_density : logarithms of the density of d if the lines are one, per
        mm^4, and of their shift across, per mm^2; with heavy tails.
    shift, shift_sigma : its size, and its standard deviation where it is known worst, in mm.
    span : distance of the two places in mm.
    """

    square: Float[np.ndarray, "p"]
    log_density: Float[np.ndarray, "p"]
    log_shift_density: Float[np.ndarray, "p"]
    shift: Float[np.ndarray, "p"]
    shift_sigma: Float[np.ndarray, "p"]
    span: Float[np.ndarray, "p"]


def difference(
    first_mm: Float[np.ndarray, "p 2 3"],
    first_covariance: Float[np.ndarray, "p 6 6"],
    second_mm: Float[np.ndarray, "p 2 3"],
    second_covariance: Float[np.ndarray, "p 6 6"],
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Difference:
    """Compare lines two by two; it does not matter which comes first."""
    unit = _common_direction(first_mm, second_mm)
    extents = [_extent(unit, ends) for ends in (first_mm, second_mm)]
    low = np.minimum(extents[0][:, 0], extents[1][:, 0])
    high = np.maximum(extents[0][:, 1], extents[1][:, 1])
    axes = complete_axes(unit)
    place = np.stack([low, high], axis=1)
    (offset, spread), (other_offset, other_spread) = (
        _abreast(place, unit, axes, ends, covariance)
        for ends, covariance in ((first_mm, first_covariance), (second_mm, second_covariance))
    )
    apart, spread = other_offset - offset, spread + other_spread
    precision = np.linalg.inv(spread)
    both = np.tile(np.eye(2), (2, 1))
    of_shift = both.T @ precision @ both
    pull = (both.T @ precision @ apart[:, :, None])[..., 0]
    shift = np.linalg.solve(of_shift, pull[:, :, None])[..., 0]
    square = np.einsum("pi,pij,pj->p", apart, precision, apart)
    shift_square = (pull * shift).sum(axis=1)
    return Difference(
        square,
        _log_tailed(square, 4, tuning) - 0.5 * np.linalg.slogdet(spread)[1],
        _log_tailed(shift_square, 2, tuning) + 0.5 * np.linalg.slogdet(of_shift)[1],
        np.linalg.norm(shift, axis=1),
        _largest_sigma(of_shift),
        high - low,
    )


def gap_mm(
    first_mm: Float[np.ndarray, "p 2 3"], second_mm: Float[np.ndarray, "p 2 3"]
) -> Float[np.ndarray, "p"]:
    """Length between pieces, two by two: 0 where they touch or lie side by side."""
    unit = _common_direction(first_mm, second_mm)
    (low, high), (other_low, other_high) = (_extent(unit, ends).T for ends in (first_mm, second_mm))
    return np.maximum(np.maximum(low, other_low) - np.minimum(high, other_high), 0.0)


class CollinearEvidence(NamedTuple):
    """What tells whether lines, two by two, are pieces of one.

    parallel : how dense lines parallel to the two are, per mm^2 across. shared : whether a
        segment serves both: then both lie in its interpretation plane, as pieces of one line do,
        or by chance at any depth. gap_mm : between them, see `gap_mm`.
    px_per_mm : of the pictures.
    """

    apart: Difference
    parallel: Float[np.ndarray, "p"]
    shared: Bool[np.ndarray, "p"]
    gap_mm: Float[np.ndarray, "p"]
    px_per_mm: Float[np.ndarray, "p"]


def collinear_log_odds(
    evidence: CollinearEvidence, scene: LineDensity, tuning: MatchTuning = DEFAULT
) -> Float[np.ndarray, "p"]:
    """Log odds that each two are one line."""
    apart, parallel, shared, gap, px_per_mm = evidence
    rules, tail = tuning.collinear, tuning.evidence
    others = np.logaddexp(
        np.log(parallel) - apart.log_shift_density,
        np.log(scene.density) - 2 * np.log(apart.span) - apart.log_density,
    )
    in_plane = np.log(scene.size / (np.sqrt(2 * np.pi) * apart.shift_sigma))
    in_plane += _log_tailed(apart.square, 4, tail) - _log_tailed(np.zeros(1), 4, tail)
    breaks = np.exp(-gap * px_per_mm / rules.break_px) * px_per_mm / rules.break_px
    along = np.log((breaks * scene.size + 1) / 2)
    return along + np.where(shared, in_plane, np.log(rules.share) - others)


def _log_tailed(
    square: Float[np.ndarray, "p"], dimensions: int, tuning: EvidenceTuning
) -> Float[np.ndarray, "p"]:
    """Log density of that many standard normal numbers, a share of them wider."""
    sigmas, share = tuning.loose_sigmas, tuning.loose_share
    return np.logaddexp(
        np.log(1 - share) - square / 2,
        np.log(share) - dimensions * np.log(sigmas) - square / (2 * sigmas**2),
    ) - dimensions / 2 * np.log(2 * np.pi)


def _largest_sigma(precision: Float[np.ndarray, "p 2 2"]) -> Float[np.ndarray, "p"]:
    half, product = np.trace(precision, axis1=1, axis2=2) / 2, np.linalg.det(precision)
    return np.sqrt((half + np.sqrt(np.maximum(half**2 - product, 0.0))) / product)


def _common_direction(
    first_mm: Float[np.ndarray, "p 2 3"], second_mm: Float[np.ndarray, "p 2 3"]
) -> Float[np.ndarray, "p 3"]:
    """Unit vectors along both, the longer one counting for more."""
    way, other = first_mm[:, 1] - first_mm[:, 0], second_mm[:, 1] - second_mm[:, 0]
    both = way + np.where((way * other).sum(axis=1) < 0, -1.0, 1.0)[:, None] * other
    return both / np.linalg.norm(both, axis=1, keepdims=True)


def _extent(
    unit: Float[np.ndarray, "p 3"], ends_mm: Float[np.ndarray, "p 2 3"]
) -> Float[np.ndarray, "p 2"]:
    return np.sort((ends_mm @ unit[:, :, None])[..., 0], axis=1)


def _abreast(
    place: Float[np.ndarray, "p 2"],
    unit: Float[np.ndarray, "p 3"],
    axes: Float[np.ndarray, "p 2 3"],
    ends_mm: Float[np.ndarray, "p 2 3"],
    covariance_mm2: Float[np.ndarray, "p 6 6"],
) -> tuple[Float[np.ndarray, "p 4"], Float[np.ndarray, "p 4 4"]]:
    """Where lines pass the planes across `unit` at two places, along two axes; covariance."""
    at = (ends_mm @ unit[:, :, None])[..., 0]
    share = (place - at[:, :1]) / (at[:, 1:] - at[:, :1])
    weight = np.stack([1 - share, share], axis=2)
    way = ends_mm[:, 1] - ends_mm[:, 0]
    # An end that moves along its own line moves nothing.
    slope = (axes @ way[:, :, None])[..., 0] / (way * unit).sum(axis=1)[:, None]
    effective = axes - slope[:, :, None] * unit[:, None]
    offset = np.einsum("pse,pei,pai->psa", weight, ends_mm, axes).reshape(-1, 4)
    jacobian = np.einsum("pse,pai->psaei", weight, effective).reshape(-1, 4, 6)
    return offset, jacobian @ covariance_mm2 @ jacobian.mT


# numerical: lines compared with all others at once.
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

    pairs : (p, 2) the first less than the second. beside_mm : (t,) of the nearest parallel line
        that is not among the pairs, inf where there is none.
    """

    pairs: Int[np.ndarray, "p 2"]
    beside_mm: Float[np.ndarray, "t"]


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
    angle = np.minimum(tuning.gate_sigmas * sigma / length, np.radians(tuning.widest_deg))
    pairs, beside = [], np.full(count, np.inf)
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
        np.minimum.at(beside, i[~close], distance[~close])
    return NearbyLines(np.concatenate(pairs), beside)


def parallel_density(
    near: NearbyLines,
    apart: Difference,
    scene: LineDensity,
    tuning: CollinearTuning = DEFAULT.collinear,
) -> Float[np.ndarray, "t"]:
    """Lines parallel to each, per area across: as dense as about it, or as about most."""
    beside = near.beside_mm.copy()
    other = apart.square > tuning.gate_sigmas**2
    for side in (0, 1):
        np.minimum.at(beside, near.pairs[other, side], apart.shift[other])
    local = 1 / (np.pi * beside**2 + np.finfo(float).tiny)
    return np.maximum(local, max(float(np.median(local)), 1 / scene.size**2))


def _across_variance(
    unit: Float[np.ndarray, "t 3"], covariance_mm2: Float[np.ndarray, "t 6 6"]
) -> Float[np.ndarray, "t"]:
    """The larger of the two ends' variances across the line, in all directions together."""
    blocks_of_ends = np.stack([covariance_mm2[:, :3, :3], covariance_mm2[:, 3:, 3:]], axis=1)
    along = np.einsum("ti,teij,tj->te", unit, blocks_of_ends, unit)
    return np.maximum(np.trace(blocks_of_ends, axis1=2, axis2=3) - along, 0.0).max(axis=1)
