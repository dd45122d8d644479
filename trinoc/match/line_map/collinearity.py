"""How much likelier two lines in space are pieces of one straight line than two lines.

Lines are compared at two places along them, at the ends of what both span. There they differ by
four numbers d, two offsets at each place, with the covariance S of both lines. H1, one line: d is
N(0, S). H0a, a parallel edge: the lateral offset is uniform with the local density of parallel
lines, the rest is N(0, S). H0b, an unrelated line: uniform with the density of all lines.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.tuning import DEFAULT, CollinearTuning, EvidenceTuning, MatchTuning
from trinoc.numerics import axes_across


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
    axes = axes_across(unit)
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
    first_mm: Float[np.ndarray, "p 2 3"],
    second_mm: Float[np.ndarray, "p 2 3"],
    tuning: CollinearTuning = DEFAULT.collinear,
) -> Float[np.ndarray, "p"]:
    """Length between pieces, two by two: 0 where they touch, -1 where they lie side by side."""
    unit = _common_direction(first_mm, second_mm)
    (low, high), (other_low, other_high) = (_extent(unit, ends).T for ends in (first_mm, second_mm))
    gap = np.maximum(low, other_low) - np.minimum(high, other_high)
    shorter = np.minimum(high - low, other_high - other_low)
    beside = -gap > tuning.beside_overlap * shorter
    return np.where(beside, -1.0, np.maximum(gap, 0.0))


class Evidence(NamedTuple):
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


def log_odds(
    evidence: Evidence, scene: LineDensity, share: float, tuning: MatchTuning = DEFAULT
) -> Float[np.ndarray, "p"]:
    """Log odds that each two are one line; `share` is how often a line has another piece."""
    apart, parallel, shared, gap, px_per_mm = evidence
    rules, tail = tuning.collinear, tuning.evidence
    others = np.logaddexp(
        np.log(parallel) - apart.log_shift_density,
        np.log(scene.density) - 2 * np.log(apart.span) - apart.log_density,
    )
    in_plane = np.log(scene.size / (np.sqrt(2 * np.pi) * apart.shift_sigma))
    in_plane += _log_tailed(apart.square, 4, tail) - _log_tailed(np.zeros(1), 4, tail)
    break_px, broken = rules.break_px, rules.broken_share
    breaks = np.exp(-np.maximum(gap, 0) * px_per_mm / break_px) * px_per_mm / break_px
    gaps = broken * breaks * scene.size + 1 - broken
    along = np.log(np.where(gap >= 0, gaps, rules.beside_share))
    return along + np.where(shared, in_plane, np.log(share) - others)


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
