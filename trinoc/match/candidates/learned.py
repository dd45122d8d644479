"""What a sample of the segments tells of all: where lines lie, and which candidates are likely.

Where lines lie: a box in space that is learned from a sample of them.

Most pairs of segments of two views would lie before or behind the scene, if they were one line. In
a pencil of epipolar planes the box is a range of disparities, so that such pairs are never made.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates.third_view import PredictionInput
from trinoc.match.evidence.endpoints import end_evidence
from trinoc.match.evidence.mixture import MixtureParameters
from trinoc.match.evidence.triple_position import triple_evidence
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.observations.table import (
    PAIRS_IN_BLOCK,
    TRIPLES_IN_BLOCK,
    SegmentTable,
    block_size,
)
from trinoc.match.tuning.candidates import CandidateTuning, ScoutTuning
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.match.tuning.evidence import EndTuning, EvidenceTuning
from trinoc.match.two_view.epipolar_pencil import (
    Pencil,
    PencilSegments,
    common_ends_mm,
    cut_pair,
    take_segments,
)
from trinoc.match.two_view.planes import segment_planes
from trinoc.numerics.buckets import in_blocks
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.vectors import add3, times_matrix, vector3


class Region(NamedTuple):
    """A box: low_mm < axes @ point < high_mm, with unit rows of `axes`."""

    axes: Float[np.ndarray, "3 3"]
    low_mm: Float[np.ndarray, "3"]
    high_mm: Float[np.ndarray, "3"]


def bound_region(ends_mm: Float[np.ndarray, "m 2 3"], tuning: ScoutTuning) -> Region:
    """The box along the axes of their spread that holds nearly all ends of some lines, and more."""
    points = ends_mm.reshape(-1, 3)
    axes = np.linalg.eigh(np.cov(points.T))[1].T
    places = points @ axes.T
    low, high = np.quantile(places, [tuning.left_out, 1 - tuning.left_out], axis=0)
    # A scene of one plane has lines beside it.
    wider = np.maximum(tuning.margin * (high - low), tuning.thinnest * (high - low).max())
    return Region(axes, low - wider, high + wider)


class RegionOfPencil(NamedTuple):
    """A region as rays of a pencil meet it: of a point with homogeneous coordinates (slope, cos,
    sin, 1 / radius), `turned` @ ray lies between `low` / radius and `high` / radius."""

    turned: Float[ArrayLike, "3 3"]
    low: Float[ArrayLike, "3"]
    high: Float[ArrayLike, "3"]


def region_of_pencil(region: Region, planes: Pencil) -> RegionOfPencil:
    """The region in the frame of a pencil."""
    origin = region.axes @ np.asarray(planes.origin_mm)
    turned = region.axes @ np.asarray(planes.frame).T
    return RegionOfPencil(turned, region.low_mm - origin, region.high_mm - origin)


def select_pairs_in_region(
    lines: SegmentTable,
    inputs: PredictionInput,
    region: RegionOfPencil,
    i: Int[np.ndarray, "p"],
    j: Int[np.ndarray, "p"],
    tuning: CandidateTuning,
) -> tuple[Int[np.ndarray, "_p"], Int[np.ndarray, "_p"]]:
    """Those pairs that would be lines of which the common part lies in a region."""
    pair = inputs.view.baseline_mm, inputs.first, inputs.second

    def inside(i: np.ndarray, j: np.ndarray) -> ArrayLike:
        return _lies_in_region(region, *pair, i, j, tuning=tuning)

    keep = np.flatnonzero(in_blocks(inside, block_size(lines, PAIRS_IN_BLOCK), i, j))
    return i[keep], j[keep]


@partial(kept_jit, static_argnames=("tuning",))
def _lies_in_region(
    region: RegionOfPencil,
    baseline_mm: Float[ArrayLike, ""],
    first: PencilSegments,
    second: PencilSegments,
    i: Int[ArrayLike, "p"],
    j: Int[ArrayLike, "p"],
    tuning: CandidateTuning,
) -> Bool[ArrayLike, "p"]:
    """Whether pairs have a common part of which both ends lie in a region."""
    part = cut_pair(baseline_mm, take_segments(first, i), take_segments(second, j), tuning)
    inside = part.possible
    for at in (part.at_low, part.at_high):
        place = times_matrix(region.turned, at[:3])
        below, above = (add3(place, vector3(bound), -at[3]) for bound in (region.low, region.high))
        for k in range(3):
            inside &= (below[k] > 0) & (above[k] < 0)
    return jnp.asarray(inside)


class SearchPrior(NamedTuple):
    """Where to search, everywhere where None, and the parameters of the evidence.

    least_log_odds : what is less likely than this, about, is no candidate.
    ends_px : pairs of which no end agrees as nearly as this are left out; None leaves out none.
    """

    region: Region | None
    mixture: MixtureParameters
    least_log_odds: float
    ends_px: float | None = None


# The segments of one order of the views: their table, the order, its pencil, and the clutter.
Screen = tuple[SegmentTable, Int[ArrayLike, "3"], Pencil, ClutterModel]


def likely_triples(
    screen: Screen, triple: Int[np.ndarray, "h 3"], learned: SearchPrior, tuning: MatchTuning
) -> Int[np.ndarray, "_ 3"]:
    """Those triples of one frame that may be likely, wherever they lie.

    They are judged on the line of their pair, without the fit to all three, and as if darker sides
    agreed. Where side levels are known, all may be.
    """
    if np.isfinite(np.asarray(screen[0].sides)).any():
        return triple
    mixture = learned.mixture
    tail, ends = (np.log(share) for share in (mixture.tail, mixture.ends))
    prior = mixture.log_count - mixture.volume.log_size - np.log(2 * np.pi)
    prior += tuning.evidence.log_odds_offset
    if np.asarray(screen[0].polarity).any():
        prior += 2 * np.log(2)

    def odds(rows: np.ndarray) -> ArrayLike:
        groups = {"tuning": tuning.candidates, "of_ends": tuning.ends, "evidence": tuning.evidence}
        return _log_odds(*screen, rows, (tail, ends), **groups)

    found = in_blocks(odds, block_size(screen[0], TRIPLES_IN_BLOCK), triple)
    return triple[found + prior > learned.least_log_odds]


@partial(kept_jit, static_argnames=("tuning", "of_ends", "evidence"))
def _log_odds(
    lines: SegmentTable,
    order: Int[ArrayLike, "3"],
    planes: Pencil,
    clutter: ClutterModel,
    triple: Int[ArrayLike, "h 3"],
    log_shares: tuple[Float[ArrayLike, "k"], Float[ArrayLike, "c"]],
    tuning: CandidateTuning,
    of_ends: EndTuning,
    evidence: EvidenceTuning,
) -> Float[ArrayLike, "h"]:
    """Log odds of each apart from the prior, -inf where it cannot be one line."""
    segments = triple.T
    sight = segment_planes(lines, clutter, order, segments)
    rows = take_segments(planes.first, segments[0]), take_segments(planes.second, segments[1])
    near_mm = common_ends_mm(planes, cut_pair(planes.baseline_mm, *rows, tuning))
    found = triple_evidence(sight, near_mm, tuning)
    tail, shares = log_shares
    total = found.log_density + _log_tail(found.chi_square, tail, evidence)
    for terms in end_evidence(found.extent_px, of_ends):
        mixed = [share + term for share, term in zip(shares, terms, strict=True)]
        total += jax.nn.logsumexp(jnp.stack(mixed), axis=0)
    return jnp.where(found.possible, total, -jnp.inf)


def _log_tail(
    chi_square: Float[ArrayLike, "h"], log_shares: Float[ArrayLike, "k"], tuning: EvidenceTuning
) -> Float[ArrayLike, "h"]:
    terms = [
        log_share - float(np.log(2 * np.pi * scale**2)) - chi_square / (2 * scale**2)
        for log_share, scale in zip(log_shares, tuning.tail_scales, strict=True)
    ]
    return jax.nn.logsumexp(jnp.stack(terms), axis=0)
