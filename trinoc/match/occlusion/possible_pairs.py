"""Candidate pairs of step 3: segments of two views that share epipolar planes, with their evidence.

Both selection methods of step 3 share this evidence. With a bound on the log odds, unlikely
pairs are rejected inside the kernel that evaluates them.
"""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates.table import Candidates, build_candidates
from trinoc.match.evidence.mixture import MixtureParameters, log_position_density, log_sides
from trinoc.match.evidence.triple_position import pair_evidence
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.observations.table import TRIPLES_IN_BLOCK, SegmentTable, block_size
from trinoc.match.selection.messages import log_kept_share, rows_within_memory, use_claimed_parts
from trinoc.match.tuning.candidates import CandidateTuning
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.match.tuning.evidence import EndTuning, EvidenceTuning
from trinoc.match.two_view.epipolar_pencil import (
    Pencil,
    build_pencil,
    pairs_sharing_planes,
    take_pencil,
    take_segments,
)
from trinoc.numerics.buckets import as_columns, select_in_blocks, split_columns
from trinoc.numerics.joins import broadcast_groups
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.tables import take_rows
from trinoc.numerics.vectors import log_sum_exp

# numerical: approximate number of pairs in memory.
PAIRS_AT_A_TIME = 1 << 17


class PairBound(NamedTuple):
    """Terms of an upper bound on the log odds of a pair of segments.

    Attributes
    ----------
    log_ends : (c,)
        Log weights of the components of the end evidence.
    centre_mm, precision : (3,) and (3, 3)
        As in `Volume`.
    log_missed : float
        Log probability that a view does not show a line in its image.
    prior : float
        Terms that are equal for all pairs.
    min_log_odds : float
        Pairs with a smaller bound are discarded.
    """

    log_ends: Float[np.ndarray, "c"]
    centre_mm: Float[np.ndarray, "3"]
    precision: Float[np.ndarray, "3 3"]
    log_missed: float
    prior: float
    min_log_odds: float


def possible_pairs(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    free: list[Int[np.ndarray, "_"]],
    clutter: ClutterModel,
    tuning: MatchTuning,
    bound: PairBound | None = None,
    ends_px: float | None = None,
) -> Iterator[Candidates]:
    """Yield all pairs of free segments of two views that can be one line, in blocks.

    Parameters
    ----------
    lines : SegmentTable
        Segments of all views.
    views : (2,)
        Indices of the two views.
    free : list of arrays
        Indices of the segments of each view that may be used.
    clutter : ClutterModel
        Clutter model of all views.
    tuning : MatchTuning
        Tuned constants.
    bound : PairBound, optional
        Bound that rejects unlikely pairs.
    ends_px : float, optional
        Limit for the distance between corresponding ends of a pair. At least one of the two
        distances must be below the limit.
    """
    planes = build_pencil(lines, *views.tolist())
    rows = free[views[0]], free[views[1]]
    for pair in pairs_sharing_planes(lines, views, planes, rows, PAIRS_AT_A_TIME, ends_px):
        segments = np.stack(pair, axis=1).astype(np.int64)
        yield _evaluate_pairs(lines, views, planes, segments, clutter, tuning, bound)


def _evaluate_pairs(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    planes: Pencil,
    segments: Int[np.ndarray, "p 2"],
    clutter: ClutterModel,
    tuning: MatchTuning,
    bound: PairBound | None,
) -> Candidates:
    ends = len(tuning.ends.agreement_px) + 1
    shapes = ((2, 2), (2, 3), (), (2, ends), (2, 3), (2, 6), (), (), ())

    def evaluate(segments: np.ndarray) -> tuple[ArrayLike, ArrayLike]:
        tunings = {"tuning": tuning.candidates, "ends": tuning.ends}
        possible, columns = _pair_evidence(lines, views, planes, segments, clutter, **tunings)
        if bound is not None:
            possible = may_be_likely(bound, possible, columns, tuning=tuning.evidence)
        return possible, columns

    selected_rows, columns = select_in_blocks(
        evaluate, block_size(lines, TRIPLES_IN_BLOCK), segments
    )
    interval, ends_mm, *rest = split_columns(columns, shapes)
    # The chi-square of two views is always 0.
    evidence_columns = interval, ends_mm, np.zeros(len(selected_rows)), *rest
    return build_candidates(lines, views, segments[selected_rows], evidence_columns, tuning)


@partial(kept_jit, static_argnames=("tuning", "ends"), few_rows_of="pairs")
def _pair_evidence(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    planes: Pencil,
    pairs: Int[ArrayLike, "h 2"],
    clutter: ClutterModel,
    tuning: CandidateTuning,
    ends: EndTuning,
) -> tuple[Bool[ArrayLike, "h"], Float[ArrayLike, "c h"]]:
    """Compute `PairEvidence` of each pair of segments: log-likelihoods, depths and weights.

    `pairs` (h, 2) are segments of the two `views`. Returns the mask of the pairs that can be one
    line, and the c fields of `PairEvidence` as the rows of one array (c, h).
    """
    segments = pairs.T
    rows = take_segments(planes.first, segments[0]), take_segments(planes.second, segments[1])
    frame_pencil = take_pencil(planes, lines, views[0], segments[0])
    evidence = pair_evidence(lines, views, frame_pencil, rows, segments, clutter, tuning, ends)
    columns = (
        *(
            evidence.interval,
            evidence.ends_mm,
            evidence.log_density,
            evidence.end_log,
            evidence.union_ends_mm,
        ),
        *(evidence.union_covariance_mm2, evidence.px_per_mm, evidence.expected_views),
        evidence.crossing_sine,
    )
    return evidence.possible, as_columns(columns)


def pair_bound(
    lines: SegmentTable,
    mixture: MixtureParameters,
    end_shares: Float[np.ndarray, "c"],
    tuning: MatchTuning,
) -> PairBound | None:
    """Return the terms of the upper bound for the pairs of one frame.

    The result is None if the grey levels beside the segments are known, because their evidence is
    not in the bound.
    `end_shares` are the weights of the end components.
    """
    if np.isfinite(np.asarray(lines.sides)).any():
        return None
    volume, pair_tuning = mixture.volume, tuning.occlusion
    prior = mixture.log_count - volume.log_size - np.log(2 * np.pi) + pair_tuning.log_odds_offset
    # Upper bound: darker sides agree.
    prior += np.log(2) * bool(np.asarray(lines.polarity).any())
    return PairBound(
        np.log(end_shares),
        volume.centre_mm,
        volume.precision,
        float(np.log(pair_tuning.miss_probability)),
        float(prior),
        tuning.selection.prune_log_odds,
    )


@partial(kept_jit, static_argnames=("tuning",), few_rows_of="possible")
def may_be_likely(
    bound: PairBound,
    possible: Bool[ArrayLike, "h"],
    columns: Float[ArrayLike, "k h"],
    tuning: EvidenceTuning,
) -> Bool[ArrayLike, "h"]:
    """Return the mask of the possible pairs whose upper bound exceeds `bound.min_log_odds`, (h,).

    `columns` are those of `_pair_evidence`.
    """
    components = len(bound.log_ends)
    ends_mm, log_density, end_log = columns[4:10], columns[10], columns[11 : 11 + 2 * components]
    log_odds = log_density + columns[-2] * bound.log_missed + bound.prior
    xp = array_namespace(columns)
    squared_distance = xp.zeros_like(log_odds)
    for e in range(2):
        terms = [
            log_share + term
            for log_share, term in zip(
                bound.log_ends, end_log[e * components : (e + 1) * components], strict=True
            )
        ]
        log_odds = log_odds + log_sum_exp(terms)
        offset = ends_mm[3 * e : 3 * e + 3] - bound.centre_mm[:, None]
        squared_distance = xp.maximum(
            squared_distance, ((bound.precision @ offset) * offset).sum(axis=0)
        )
    position_cost = xp.clip(squared_distance - tuning.box_corner_sigmas**2, 0.0, tuning.box_cost)
    return possible & (log_odds - 0.5 * position_cost > bound.min_log_odds)


class Pairs(NamedTuple):
    """Candidate pairs with their log odds.

    Rivals are candidates that use the same part of a segment; at most one of them is right.

    Attributes
    ----------
    candidates : Candidates
        The pairs.
    log_odds : (m,)
        Log odds before the exclusion of rivals.
    posterior_log_odds : (m,)
        Log odds after the exclusion of rivals and after the reduction for solid bodies
        (`temper_pairs`).
    is_accepted : (m,)
        True for the accepted pairs.
    miss_log_odds : (m,)
        Part of the log odds from views that should show the pair and do not; 0 or negative.
    """

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    posterior_log_odds: Float[np.ndarray, "m"]
    is_accepted: Bool[np.ndarray, "m"]
    miss_log_odds: Float[np.ndarray, "m"]

    def take(self, rows: np.ndarray) -> "Pairs":
        """Return the pairs with the given indices, or the pairs for which a mask is true."""
        return take_rows(self, rows)


def likely_pair_rows(
    candidates: Candidates, matched: Candidates, odds: Float[np.ndarray, "m"], tuning: MatchTuning
) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Return the indices of the likely pairs that use no matched part of a segment, (k,).

    Some likely pairs may be discarded to limit the memory. The second result (k,) is the log of the
    probability that the right pair was not discarded (`log_kept_share`).
    """
    rules = tuning.selection
    rows = np.flatnonzero(odds > rules.prune_log_odds)
    likely = candidates.take(rows)
    rows = rows[
        ~use_claimed_parts(likely.index, likely.interval, matched.index, matched.interval, rules)
    ]
    odds, index = odds[rows], candidates.index[rows]
    selected_rows = rows_within_memory(odds, index, -np.inf, rules)
    return rows[selected_rows], log_kept_share(odds, index, selected_rows)


def log_odds_among_lines(
    candidates: Candidates,
    mixture: MixtureParameters,
    tuning: MatchTuning,
) -> Float[np.ndarray, "m"]:
    """Return the log odds of pairs in a scene with matched lines, (m,).

    Not included are competing candidates, junctions, and the share of lines that only two views
    show.
    """
    rules, frame = tuning.occlusion, candidates.frame
    member_evidence = log_ends(
        candidates, broadcast_groups(end_shares(mixture, tuning.ends), frame)
    )
    member_evidence += log_sides(candidates.side_log, mixture, frame)
    in_images = candidates.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset)
    evidence = (
        candidates.log_density
        + member_evidence
        + candidates.expected_views * float(np.log(rules.miss_probability))
    )
    position_density = log_position_density(
        candidates.ends_mm, mixture.volume, tuning.evidence, frame
    )
    return evidence + offset + broadcast_groups(mixture.log_count, frame) + position_density


def log_ends(candidates: Candidates, shares: Float[np.ndarray, "*m c"]) -> Float[np.ndarray, "m"]:
    """Return the log evidence of both ends of each pair, (m,).

    `shares` are the weights of the mixture components.
    """
    return np.log((np.exp(candidates.end_log) @ shares[..., None])[..., 0]).sum(axis=1)


def end_shares(mixture: MixtureParameters, tuning: EndTuning) -> Float[np.ndarray, "*f c"]:
    """Return the mixture weights of the segment ends for two views, (c,), from the weights for
    three.

    The last component means that the two ends do not correspond. The others mean that they
    correspond, with each scale of their distance. The two views are assumed to be a random pair of
    the three.
    """
    all_agree, two_agree = len(tuning.agreement_px), len(tuning.pair_px)
    agreeing = mixture.ends[..., :all_agree].copy()
    # If two of three views agree, they are a given pair in one of three cases.
    stops_short = mixture.ends[..., all_agree : all_agree + two_agree]
    runs_on = mixture.ends[..., all_agree + two_agree : -1]
    agreeing[..., :two_agree] += (stops_short + runs_on) / 3
    return np.concatenate([agreeing, 1 - agreeing.sum(axis=-1, keepdims=True)], axis=-1)
