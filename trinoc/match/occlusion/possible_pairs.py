"""Pairs of segments that can be one line: those of two views that share epipolar planes.

What is evaluate of pairs: their values, and evidence that both ways of choosing them count.

Which pairs may be likely, evaluate where they were made: most never leave the kernel.
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
from trinoc.match.selection.messages import affordable, are_claimed, log_share_kept
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

# numerical: about as many pairs are held at a time.
PAIRS_AT_A_TIME = 1 << 17


class PairBound(NamedTuple):
    """What the log odds of a pair among matched lines are made of, but for its polarity.

    prior : what all pairs share. least : below this, pairs are let go.
    """

    log_ends: Float[np.ndarray, "c"]
    centre_mm: Float[np.ndarray, "3"]
    precision: Float[np.ndarray, "3 3"]
    log_missed: float
    prior: float
    least: float


def possible_pairs(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    free: list[Int[np.ndarray, "_"]],
    clutter: ClutterModel,
    tuning: MatchTuning,
    bound: PairBound | None = None,
    ends_px: float | None = None,
) -> Iterator[Candidates]:
    """All pairs of free segments of two views that can be one line, and may be likely as far as a
    `bound` tells, and of which an end agrees by `ends_px`, if that is given, block by block."""
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
    ends = len(tuning.ends.agreeing_px) + 1
    shapes = ((2, 2), (2, 3), (), (2, ends), (2, 3), (2, 6), (), (), ())

    def evaluate(segments: np.ndarray) -> tuple[ArrayLike, ArrayLike]:
        groups = {"tuning": tuning.candidates, "ends": tuning.ends}
        possible, columns = _pair_evidence(lines, views, planes, segments, clutter, **groups)
        if bound is not None:
            possible = may_be_likely(bound, possible, columns, tuning=tuning.evidence)
        return possible, columns

    keep, columns = select_in_blocks(evaluate, block_size(lines, TRIPLES_IN_BLOCK), segments)
    of_views, ends_mm, *rest = split_columns(columns, shapes)
    # Two views always agree about a place.
    place = of_views, ends_mm, np.zeros(len(keep)), *rest
    return build_candidates(lines, views, segments[keep], place, tuning)


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
    """(whether each can be one line, what is kept of it)."""
    segments = pairs.T
    rows = take_segments(planes.first, segments[0]), take_segments(planes.second, segments[1])
    of_pencil = take_pencil(planes, lines, views[0], segments[0])
    found = pair_evidence(lines, views, of_pencil, rows, segments, clutter, tuning, ends)
    columns = (
        *(found.interval, found.ends_mm, found.log_density, found.end_log, found.union_ends_mm),
        *(found.union_covariance_mm2, found.px_per_mm, found.expected_views),
        found.crossing_sine,
    )
    return found.possible, as_columns(columns)


def pair_bound(
    lines: SegmentTable,
    mixture: MixtureParameters,
    end_shares: Float[np.ndarray, "c"],
    tuning: MatchTuning,
) -> PairBound | None:
    """The bound of one frame's pairs; None where side levels, of pictures, say more."""
    if np.isfinite(np.asarray(lines.sides)).any():
        return None
    volume, rules = mixture.volume, tuning.occlusion
    prior = mixture.log_count - volume.log_size - np.log(2 * np.pi) + rules.log_odds_offset
    # As if darker sides agreed.
    prior += np.log(2) * bool(np.asarray(lines.polarity).any())
    return PairBound(
        np.log(end_shares),
        volume.centre_mm,
        volume.precision,
        float(np.log(rules.missed)),
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
    """Which of the possible pairs are as likely as they have to be; `columns` are those that
    `possible_pairs` makes: intervals, ends, log density, that of the ends, and others."""
    components = len(bound.log_ends)
    ends_mm, log_density, end_log = columns[4:10], columns[10], columns[11 : 11 + 2 * components]
    total = log_density + columns[-2] * bound.log_missed + bound.prior
    xp = array_namespace(columns)
    square = xp.zeros_like(total)
    for e in range(2):
        terms = [
            log_share + term
            for log_share, term in zip(
                bound.log_ends, end_log[e * components : (e + 1) * components], strict=True
            )
        ]
        total = total + log_sum_exp(terms)
        apart = ends_mm[3 * e : 3 * e + 3] - bound.centre_mm[:, None]
        square = xp.maximum(square, ((bound.precision @ apart) * apart).sum(axis=0))
    outside = xp.clip(square - tuning.box_corner_sigmas**2, 0.0, tuning.box_cost)
    return possible & (total - 0.5 * outside > bound.least)


class Pairs(NamedTuple):
    """Candidate pairs (chi-square is zero), their log odds without and with rivals, those taken.

    missed : what it costs each, in log odds, that no third view shows it where one should.
    """

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    posterior_log_odds: Float[np.ndarray, "m"]
    taken: Bool[np.ndarray, "m"]
    missed: Float[np.ndarray, "m"]

    def take(self, rows: np.ndarray) -> "Pairs":
        """Those at the given indices, in that order, or where the mask is true."""
        return take_rows(self, rows)


def likely_rows(
    found: Candidates, matched: Candidates, odds: Float[np.ndarray, "m"], tuning: MatchTuning
) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """(rows of pairs that are likely at all, and need no part of a segment that is matched, and of
    each its `log_share_kept`)."""
    rules = tuning.selection
    rows = np.flatnonzero(odds > rules.prune_log_odds)
    own = found.take(rows)
    rows = rows[~are_claimed(own.index, own.interval, matched.index, matched.interval, rules)]
    odds, index = odds[rows], found.index[rows]
    kept = affordable(odds, index, -np.inf, rules)
    return rows[kept], log_share_kept(odds, index, kept)


def evidence_beside_lines(
    candidates: Candidates,
    mixture: MixtureParameters,
    tuning: MatchTuning,
) -> Float[np.ndarray, "m"]:
    """Log odds of pairs among matched lines, but for how seldom pairs are, and for junctions."""
    rules, frame = tuning.occlusion, candidates.frame
    ends = log_ends(candidates, broadcast_groups(end_shares(mixture, tuning.ends), frame))
    ends += log_sides(candidates.side_log, mixture, frame)
    in_images = candidates.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset)
    evidence = (
        candidates.log_density + ends + candidates.expected_views * float(np.log(rules.missed))
    )
    place = log_position_density(candidates.ends_mm, mixture.volume, tuning.evidence, frame)
    return evidence + offset + broadcast_groups(mixture.log_count, frame) + place


def log_ends(candidates: Candidates, shares: Float[np.ndarray, "*m c"]) -> Float[np.ndarray, "m"]:
    """Evidence of the ends, by the shares of their components."""
    return np.log((np.exp(candidates.end_log) @ shares[..., None])[..., 0]).sum(axis=1)


def end_shares(mixture: MixtureParameters, tuning: EndTuning) -> Float[np.ndarray, "*f c"]:
    """How the ends of two views agree follows from how those of three do."""
    all_agree, two_agree = len(tuning.agreeing_px), len(tuning.pair_px)
    agreeing = mixture.ends[..., :all_agree].copy()
    # Of two views that agree against the third, a given pair is one in three.
    short = mixture.ends[..., all_agree : all_agree + two_agree]
    on = mixture.ends[..., all_agree + two_agree : -1]
    agreeing[..., :two_agree] += (short + on) / 3
    return np.concatenate([agreeing, 1 - agreeing.sum(axis=-1, keepdims=True)], axis=-1)
