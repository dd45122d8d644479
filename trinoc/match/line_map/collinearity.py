"""Likelihood ratio that two lines in space are pieces of one straight line.

The lines are compared at two positions along them: the ends of their union. They differ there by
four numbers d, two offsets at each position. S is the covariance of both lines. H1, one line: d
is N(0, S). H0a, a parallel edge: the lateral offset is uniform with the local density of
parallel lines, the rest is N(0, S). H0b, an unrelated line: uniform with the density of all
lines.
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
    """Density of the lines of a scene, for the chance that two lines are near each other.

    Attributes
    ----------
    density : float
        Number of lines that cross a plane, per mm^2 of the plane and per steradian of direction.
    size : float
        Largest extent of the lines, mm.
    volume : float
        Volume of the box of the lines, mm^3.
    """

    density: float
    size: float
    volume: float


class Difference(NamedTuple):
    """Difference d between two lines: two lateral offsets at each of two positions along the lines.

    S is the covariance of d.

    Attributes
    ----------
    square : (p,)
        d' S^-1 d.
    log_density : (p,)
        Log density of d under the hypothesis of one line, with a heavy tail, 1/mm^4.
    log_shift_density : (p,)
        Log density of the lateral shift alone under this hypothesis, with a heavy tail, 1/mm^2.
    shift, shift_sigma : (p,)
        Size of the lateral shift, and its largest standard deviation over all directions, mm.
    span : (p,)
        Distance of the two positions along the lines, mm.
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
    """Compute the difference between the two lines of each pair.

    The lines are given by their ends (p, 2, 3), mm, and the covariance of the ends, mm^2.
    Exchanging the two lines gives the same result.
    """
    direction = _common_direction(first_mm, second_mm)
    extents = [_extent(direction, ends) for ends in (first_mm, second_mm)]
    low = np.minimum(extents[0][:, 0], extents[1][:, 0])
    high = np.maximum(extents[0][:, 1], extents[1][:, 1])
    axes = complete_axes(direction)
    positions = np.stack([low, high], axis=1)
    (offset, spread), (other_offset, other_spread) = (
        _offsets_at_positions(positions, direction, axes, ends, covariance)
        for ends, covariance in ((first_mm, first_covariance), (second_mm, second_covariance))
    )
    offset_difference, spread = other_offset - offset, spread + other_spread
    precision = np.linalg.inv(spread)
    shift_axes = np.tile(np.eye(2), (2, 1))
    shift_precision = shift_axes.T @ precision @ shift_axes
    shift_gradient = (shift_axes.T @ precision @ offset_difference[:, :, None])[..., 0]
    shift = np.linalg.solve(shift_precision, shift_gradient[:, :, None])[..., 0]
    square = np.einsum("pi,pij,pj->p", offset_difference, precision, offset_difference)
    shift_square = (shift_gradient * shift).sum(axis=1)
    return Difference(
        square,
        _log_tailed(square, 4, tuning) - 0.5 * np.linalg.slogdet(spread)[1],
        _log_tailed(shift_square, 2, tuning) + 0.5 * np.linalg.slogdet(shift_precision)[1],
        np.linalg.norm(shift, axis=1),
        _largest_sigma(shift_precision),
        high - low,
    )


def gap_mm(
    first_mm: Float[np.ndarray, "p 2 3"], second_mm: Float[np.ndarray, "p 2 3"]
) -> Float[np.ndarray, "p"]:
    """Return the gap between two line pieces along their direction, (p,) mm; 0 if they overlap."""
    direction = _common_direction(first_mm, second_mm)
    (low, high), (other_low, other_high) = (
        _extent(direction, ends).T for ends in (first_mm, second_mm)
    )
    return np.maximum(np.maximum(low, other_low) - np.minimum(high, other_high), 0.0)


class CollinearEvidence(NamedTuple):
    """Evidence on p pairs of lines that may be pieces of one straight line.

    Attributes
    ----------
    difference : Difference
        Difference between the two lines.
    parallel_density : (p,)
        Number of lines parallel to the pair, per mm^2 across.
    shares_segment : (p,)
        True if one segment belongs to both lines. Both lines then lie in the interpretation plane
        of the segment, even if the lines are different and have different depths.
    gap_mm : (p,)
        Gap between the pieces along the line.
    px_per_mm : (p,)
        Image displacement per mm in space, mean over views and tracks.
    """

    difference: Difference
    parallel_density: Float[np.ndarray, "p"]
    shares_segment: Bool[np.ndarray, "p"]
    gap_mm: Float[np.ndarray, "p"]
    px_per_mm: Float[np.ndarray, "p"]


def collinear_log_odds(
    evidence: CollinearEvidence, scene: LineDensity, tuning: MatchTuning = DEFAULT
) -> Float[np.ndarray, "p"]:
    """Return the log odds that the two lines of each pair are pieces of one straight line, (p,)."""
    difference, parallel_density, shares_segment, gap, px_per_mm = evidence
    rules, tail = tuning.collinear, tuning.evidence
    log_other_lines = np.logaddexp(
        np.log(parallel_density) - difference.log_shift_density,
        np.log(scene.density) - 2 * np.log(difference.span) - difference.log_density,
    )
    log_shared_plane = np.log(scene.size / (np.sqrt(2 * np.pi) * difference.shift_sigma))
    log_shared_plane += _log_tailed(difference.square, 4, tail) - _log_tailed(np.zeros(1), 4, tail)
    break_density = np.exp(-gap * px_per_mm / rules.break_px) * px_per_mm / rules.break_px
    log_gap_ratio = np.log((break_density * scene.size + 1) / 2)
    return log_gap_ratio + np.where(
        shares_segment, log_shared_plane, np.log(rules.continuation_share) - log_other_lines
    )


def _log_tailed(
    square: Float[np.ndarray, "p"], dimensions: int, tuning: EvidenceTuning
) -> Float[np.ndarray, "p"]:
    """Log density of a heavy-tailed distribution: a standard normal mixed with a wider normal.

    `square` is the squared length of the vector, `dimensions` its number of coordinates.
    """
    sigmas, share = tuning.outlier_sigmas, tuning.outlier_share
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
    """Return the mean direction of the two lines of each pair, weighted by length, (p, 3)."""
    first_step, second_step = first_mm[:, 1] - first_mm[:, 0], second_mm[:, 1] - second_mm[:, 0]
    total = (
        first_step
        + np.where((first_step * second_step).sum(axis=1) < 0, -1.0, 1.0)[:, None] * second_step
    )
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def _extent(
    direction: Float[np.ndarray, "p 3"], ends_mm: Float[np.ndarray, "p 2 3"]
) -> Float[np.ndarray, "p 2"]:
    return np.sort((ends_mm @ direction[:, :, None])[..., 0], axis=1)


def _offsets_at_positions(
    positions: Float[np.ndarray, "p 2"],
    direction: Float[np.ndarray, "p 3"],
    axes: Float[np.ndarray, "p 2 3"],
    ends_mm: Float[np.ndarray, "p 2 3"],
    covariance_mm2: Float[np.ndarray, "p 6 6"],
) -> tuple[Float[np.ndarray, "p 4"], Float[np.ndarray, "p 4 4"]]:
    """Return lateral offsets of each line at two positions, (p, 4) mm, and their covariance.

    The offsets are coordinates along the two `axes`, in the planes perpendicular to `direction` at
    `positions`.
    """
    end_positions = (ends_mm @ direction[:, :, None])[..., 0]
    share = (positions - end_positions[:, :1]) / (end_positions[:, 1:] - end_positions[:, :1])
    weight = np.stack([1 - share, share], axis=2)
    step = ends_mm[:, 1] - ends_mm[:, 0]
    # A displacement of an end along its own line has no effect.
    slope = (axes @ step[:, :, None])[..., 0] / (step * direction).sum(axis=1)[:, None]
    effective = axes - slope[:, :, None] * direction[:, None]
    offset = np.einsum("pse,pei,pai->psa", weight, ends_mm, axes).reshape(-1, 4)
    jacobian = np.einsum("pse,pai->psaei", weight, effective).reshape(-1, 4, 6)
    return offset, jacobian @ covariance_mm2 @ jacobian.mT


# numerical: number of lines that are compared at once with all others.
ROWS_IN_BLOCK = 512


def line_density(
    ends_mm: Float[np.ndarray, "t 2 3"], tuning: EvidenceTuning = DEFAULT.evidence
) -> LineDensity:
    """Estimate the density of lines of any direction, in a box around the lines' midpoints."""
    middles, length = ends_mm.mean(axis=1), np.linalg.norm(ends_mm[:, 1] - ends_mm[:, 0], axis=1)
    longest = float(length.max())
    # The spread of few lines does not give the extent of the scene.
    default_variance = np.full(3, longest**2 / 12)
    variance = np.linalg.eigvalsh(np.cov(middles.T)) if len(middles) > 3 else default_variance
    size = max(float(np.sqrt(12 * max(variance.max(), 0.0))), longest)
    sides = np.maximum(np.sqrt(12 * np.maximum(variance, 0.0)), tuning.min_thickness_share * size)
    volume = float(np.prod(sides))
    return LineDensity(float(length.sum()) / (2 * np.pi * volume), size, volume)


class NearbyLines(NamedTuple):
    """Pairs of lines that are nearly collinear.

    Attributes
    ----------
    pairs : (p, 2)
        Indices of both lines, the smaller index first.
    nearest_parallel_mm : (t,)
        Distance of each line from the nearest parallel line that is too far away for a pair; inf if
        there is none.
    """

    pairs: Int[np.ndarray, "p 2"]
    nearest_parallel_mm: Float[np.ndarray, "t"]


def nearby_lines(
    ends_mm: Float[np.ndarray, "t 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
    tuning: CollinearTuning = DEFAULT.collinear,
) -> NearbyLines:
    """List all pairs of nearly collinear lines, and the nearest other parallel line of each line.

    `ends_mm` are the ends of the lines, `covariance_mm2` their covariances.
    """
    count = len(ends_mm)
    middle, step = ends_mm.mean(axis=1), ends_mm[:, 1] - ends_mm[:, 0]
    length = np.linalg.norm(step, axis=1)
    direction = step / length[:, None]
    sigma = np.sqrt(_across_variance(direction, covariance_mm2))
    angle = np.minimum(tuning.gate_sigmas * sigma / length, np.radians(tuning.max_angle_deg))
    pairs, nearest_parallel = [], np.full(count, np.inf)
    for rows in blocks(count, ROWS_IN_BLOCK):
        cosine = np.minimum(np.abs(direction[rows] @ direction.T), 1.0)
        limit = np.maximum(angle[rows, None], angle)
        i, j = np.nonzero(cosine > np.cos(limit))
        i, j = i[i + rows.start != j] + rows.start, j[i + rows.start != j]
        offset = middle[j] - middle[i]
        square = (offset**2).sum(axis=1)
        along_mm = np.stack(
            [(offset * direction[i]).sum(axis=1), (offset * direction[j]).sum(axis=1)]
        )
        distance = np.sqrt(np.maximum(square - along_mm**2, 0.0)).min(axis=0)
        farthest = np.abs(along_mm).max(axis=0)
        # The sigma of a line grows with the distance of extrapolation.
        sigma_at_distance = sigma[i] * (1 + 2 * farthest / length[i]) + sigma[j] * (
            1 + 2 * farthest / length[j]
        )
        is_close = distance < tuning.gate_sigmas * sigma_at_distance
        pairs.append(np.stack([i, j], axis=1)[is_close & (i < j)])
        np.minimum.at(nearest_parallel, i[~is_close], distance[~is_close])
    return NearbyLines(np.concatenate(pairs), nearest_parallel)


def parallel_density(
    nearby: NearbyLines,
    difference: Difference,
    scene: LineDensity,
    tuning: CollinearTuning = DEFAULT.collinear,
) -> Float[np.ndarray, "t"]:
    """Return the number of lines parallel to each line, per mm^2 across the line, (t,).

    The result is the local density from the nearest parallel line, or the median of all lines if
    that is larger.
    """
    nearest_parallel = nearby.nearest_parallel_mm.copy()
    is_other = difference.square > tuning.gate_sigmas**2
    for side in (0, 1):
        np.minimum.at(nearest_parallel, nearby.pairs[is_other, side], difference.shift[is_other])
    local = 1 / (np.pi * nearest_parallel**2 + np.finfo(float).tiny)
    return np.maximum(local, max(float(np.median(local)), 1 / scene.size**2))


def _across_variance(
    direction: Float[np.ndarray, "t 3"], covariance_mm2: Float[np.ndarray, "t 6 6"]
) -> Float[np.ndarray, "t"]:
    """Return the variance of the less precise end across each line, (t,) mm^2.

    The variances in both directions across the line are added.
    """
    blocks_of_ends = np.stack([covariance_mm2[:, :3, :3], covariance_mm2[:, 3:, 3:]], axis=1)
    variance_along = np.einsum("ti,teij,tj->te", direction, blocks_of_ends, direction)
    return np.maximum(np.trace(blocks_of_ends, axis1=2, axis2=3) - variance_along, 0.0).max(axis=1)
