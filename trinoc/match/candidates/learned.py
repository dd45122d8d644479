"""Search prior from a sample of the segments: the box that contains the lines, and likely
candidates.

Most pairs of segments of two views would lie before or behind the scene if they were one line.
In a pencil of epipolar planes, the box is a range of disparities. Pairs outside this range are
never formed.
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
    """Box in space: the points with low_mm < axes @ point < high_mm.

    The rows of `axes` are orthonormal, in the world frame.
    """

    axes: Float[np.ndarray, "3 3"]
    low_mm: Float[np.ndarray, "3"]
    high_mm: Float[np.ndarray, "3"]


def bound_region(ends_mm: Float[np.ndarray, "m 2 3"], tuning: ScoutTuning) -> Region:
    """Return the box that contains nearly all of the given line ends, widened by a margin.

    The sides of the box are parallel to the principal axes of the ends.
    """
    points = ends_mm.reshape(-1, 3)
    axes = np.linalg.eigh(np.cov(points.T))[1].T
    positions = points @ axes.T
    low, high = np.quantile(positions, [tuning.trimmed_share, 1 - tuning.trimmed_share], axis=0)
    # A planar scene has a few lines beside its plane.
    margin = np.maximum(tuning.margin * (high - low), tuning.min_side_share * (high - low).max())
    return Region(axes, low - margin, high + margin)


class RegionOfPencil(NamedTuple):
    """Box in space, in the frame of a pencil of epipolar planes.

    The pencil consists of all planes through the centres of two cameras. In this frame, a point is
    radius * ray with ray = (slope, cos(phi), sin(phi)). `radius` is its distance from the baseline,
    phi the angle of its epipolar plane. The point is in the box if low / radius < axes @ ray < high
    / radius.
    """

    axes: Float[ArrayLike, "3 3"]
    low: Float[ArrayLike, "3"]
    high: Float[ArrayLike, "3"]


def region_of_pencil(region: Region, pencil: Pencil) -> RegionOfPencil:
    """Convert a box from the world frame to the frame of a pencil of epipolar planes."""
    origin = region.axes @ np.asarray(pencil.origin_mm)
    axes = region.axes @ np.asarray(pencil.frame).T
    return RegionOfPencil(axes, region.low_mm - origin, region.high_mm - origin)


def select_pairs_in_region(
    lines: SegmentTable,
    inputs: PredictionInput,
    region: RegionOfPencil,
    i: Int[np.ndarray, "p"],
    j: Int[np.ndarray, "p"],
    tuning: CandidateTuning,
) -> tuple[Int[np.ndarray, "_p"], Int[np.ndarray, "_p"]]:
    """Return the pairs (i, j) of segments whose common part in space lies in the box.

    The common part is the part of the line in space that both segments show. `i` are segments of
    the first view, `j` segments of the second view.
    """
    pair = inputs.view.baseline_mm, inputs.first, inputs.second

    def lies_inside(i: np.ndarray, j: np.ndarray) -> ArrayLike:
        return _lies_in_region(region, *pair, i, j, tuning=tuning)

    selected_rows = np.flatnonzero(in_blocks(lies_inside, block_size(lines, PAIRS_IN_BLOCK), i, j))
    return i[selected_rows], j[selected_rows]


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
    """Return the mask of the pairs (i, j) whose common part exists and has both ends in the box.

    The common part is the part of the line in space that both segments show.
    """
    part = cut_pair(baseline_mm, take_segments(first, i), take_segments(second, j), tuning)
    is_inside = part.possible
    for bounding_plane in (part.at_low, part.at_high):
        position = times_matrix(region.axes, bounding_plane[:3])
        above_low, below_high = (
            add3(position, vector3(bound), -bounding_plane[3])
            for bound in (region.low, region.high)
        )
        for k in range(3):
            is_inside &= (above_low[k] > 0) & (below_high[k] < 0)
    return jnp.asarray(is_inside)


class SearchPrior(NamedTuple):
    """Restrictions of a search for candidates.

    Attributes
    ----------
    region : Region or None
        Box that contains the lines; None for all space.
    mixture : MixtureParameters
        Parameters for the log odds of candidates.
    least_log_odds : float
        Candidates with smaller log odds are discarded.
    ends_px : float or None
        Limit for the distance between the corresponding ends of two segments, measured along the
        segment. A pair has two such distances; one of them must be below the limit. None for no
        limit.
    """

    region: Region | None
    mixture: MixtureParameters
    least_log_odds: float
    ends_px: float | None = None


# Data of one ordering of the views: tables, ordering, pencil, clutter model.
Screen = tuple[SegmentTable, Int[ArrayLike, "3"], Pencil, ClutterModel]


def likely_triples(
    screen: Screen, triple: Int[np.ndarray, "h 3"], prior: SearchPrior, tuning: MatchTuning
) -> Int[np.ndarray, "_ 3"]:
    """Return the triples of one frame whose approximate log odds exceed `prior.least_log_odds`.

    The approximation uses the line of the first two segments instead of the fit to all three, and
    assumes equal polarities. If the grey levels beside the segments are known, all triples are
    returned.
    """
    if np.isfinite(np.asarray(screen[0].sides)).any():
        return triple
    mixture = prior.mixture
    log_tail, log_ends = (np.log(share) for share in (mixture.tail, mixture.ends))
    constant = mixture.log_count - mixture.volume.log_size - np.log(2 * np.pi)
    constant += tuning.evidence.log_odds_offset
    if np.asarray(screen[0].polarity).any():
        constant += 2 * np.log(2)

    def evaluate(rows: np.ndarray) -> ArrayLike:
        tunings = {
            "tuning": tuning.candidates,
            "end_tuning": tuning.ends,
            "evidence_tuning": tuning.evidence,
        }
        return _log_odds(*screen, rows, (log_tail, log_ends), **tunings)

    log_odds = in_blocks(evaluate, block_size(screen[0], TRIPLES_IN_BLOCK), triple)
    return triple[log_odds + constant > prior.least_log_odds]


@partial(kept_jit, static_argnames=("tuning", "end_tuning", "evidence_tuning"))
def _log_odds(
    lines: SegmentTable,
    order: Int[ArrayLike, "3"],
    planes: Pencil,
    clutter: ClutterModel,
    triple: Int[ArrayLike, "h 3"],
    log_shares: tuple[Float[ArrayLike, "k"], Float[ArrayLike, "c"]],
    tuning: CandidateTuning,
    end_tuning: EndTuning,
    evidence_tuning: EvidenceTuning,
) -> Float[ArrayLike, "h"]:
    """Approximate log odds of each triple, one line against clutter, without constant terms.

    The result is -inf if the three segments cannot be images of one line. `log_shares` are the logs
    of the mixture weights of the error scales (k,) and of the components of `end_evidence` (c,).
    """
    segments = triple.T
    planes_of_triple = segment_planes(lines, clutter, order, segments)
    rows = take_segments(planes.first, segments[0]), take_segments(planes.second, segments[1])
    line_mm = common_ends_mm(planes, cut_pair(planes.baseline_mm, *rows, tuning))
    evidence = triple_evidence(planes_of_triple, line_mm, tuning)
    tail, shares = log_shares
    log_odds = evidence.log_density + _log_tail(evidence.chi_square, tail, evidence_tuning)
    for terms in end_evidence(evidence.extent_px, end_tuning):
        log_terms = [share + term for share, term in zip(shares, terms, strict=True)]
        log_odds += jax.nn.logsumexp(jnp.stack(log_terms), axis=0)
    return jnp.where(evidence.possible, log_odds, -jnp.inf)


def _log_tail(
    chi_square: Float[ArrayLike, "h"], log_shares: Float[ArrayLike, "k"], tuning: EvidenceTuning
) -> Float[ArrayLike, "h"]:
    terms = [
        log_share - float(np.log(2 * np.pi * scale**2)) - chi_square / (2 * scale**2)
        for log_share, scale in zip(log_shares, tuning.tail_scales, strict=True)
    ]
    return jax.nn.logsumexp(jnp.stack(terms), axis=0)
