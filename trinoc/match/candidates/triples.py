"""Step 1: triples of segments that can be one line, from all three orderings of the views.

Triples that passed the gate, evaluate by all of their evidence, in double precision.

Two programs: the first looks the segments up and fits a line to all three; the second computes the
evidence on that line, and serves pictures of any number of segments.
"""

from collections.abc import Iterator
from functools import partial

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates.learned import (
    SearchPrior,
    likely_triples,
    region_of_pencil,
    select_pairs_in_region,
)
from trinoc.match.candidates.search import Order, Orders, gate_triples, prepare_orders
from trinoc.match.candidates.table import (
    Candidates,
    build_candidates,
    no_candidates,
    prior_log_odds,
)
from trinoc.match.evidence.endpoints import END_COMPONENTS, end_evidence
from trinoc.match.evidence.mixture import prior_parameters
from trinoc.match.evidence.triple_position import line_of_three, triple_evidence
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.observations.table import TRIPLES_IN_BLOCK, SegmentTable, block_size
from trinoc.match.tuning.candidates import CandidateTuning
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.evidence import EndTuning
from trinoc.match.two_view.epipolar_pencil import (
    Pencil,
    common_ends_mm,
    cut_pair,
    pairs_sharing_planes,
    take_pencil,
    take_segments,
)
from trinoc.match.two_view.planes import SegmentPlanes, segment_planes
from trinoc.numerics.buckets import as_columns, blocks, select_in_blocks, split_columns
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.tables import concatenate_rows
from trinoc.numerics.vectors import Vector3

# numerical: what is kept of each triple: the shapes of interval, ends_mm, chi_square,
# log_density, end_log, union_ends_mm, union_covariance_mm2, px_per_mm.
_SHAPES = ((3, 2), (2, 3), (), (), (2, END_COMPONENTS), (2, 3), (2, 6), ())


def evaluate_triples(
    lines: SegmentTable,
    order: Int[np.ndarray, "3"],
    planes: Pencil,
    triple: Int[np.ndarray, "h 3"],
    clutter: ClutterModel,
    tuning: MatchTuning,
) -> Candidates:
    """Those triples, segments in the views of an order, that can be one line."""

    def evaluate(triple: np.ndarray) -> tuple[ArrayLike, ArrayLike]:
        fitted = _fit_triples(lines, order, planes, triple, clutter, tuning=tuning.candidates)
        return _triple_evidence(*fitted, tuning=tuning.candidates, ends=tuning.ends)

    keep, columns = select_in_blocks(evaluate, block_size(lines, TRIPLES_IN_BLOCK), triple)
    return build_candidates(lines, order, triple[keep], split_columns(columns, _SHAPES), tuning)


@partial(kept_jit, static_argnames=("tuning",), few_rows_of="triple")
def _fit_triples(
    lines: SegmentTable,
    order: Int[ArrayLike, "3"],
    planes: Pencil,
    triple: Int[ArrayLike, "h 3"],
    clutter: ClutterModel,
    tuning: CandidateTuning,
) -> tuple[SegmentPlanes, tuple[Vector3, Vector3], Bool[ArrayLike, "h"]]:
    """(segments, ends of the line that is fitted to all three, whether it can be one)."""
    segments = triple.T
    sight = segment_planes(lines, clutter, order, segments)
    of_pencil = take_pencil(planes, lines, order[0], segments[0])
    rows = take_segments(planes.first, segments[0]), take_segments(planes.second, segments[1])
    near_mm = common_ends_mm(of_pencil, cut_pair(of_pencil.baseline_mm, *rows, tuning))
    return sight, *line_of_three(sight, near_mm, tuning)


@partial(kept_jit, static_argnames=("tuning", "ends"), few_rows_of="possible")
def _triple_evidence(
    sight: SegmentPlanes,
    fitted_mm: tuple[Vector3, Vector3],
    possible: Bool[ArrayLike, "h"],
    tuning: CandidateTuning,
    ends: EndTuning,
) -> tuple[Bool[ArrayLike, "h"], Float[ArrayLike, "c h"]]:
    """(whether each can be one line, what is kept of it), on the line fitted to all three: it does
    not matter which pair came first."""
    found = triple_evidence(sight, fitted_mm, tuning)
    columns = (
        *(found.interval, found.ends_mm, found.chi_square, found.log_density),
        *(end_evidence(found.extent_px, ends), found.union_ends_mm),
        *(found.union_covariance_mm2, found.px_per_mm),
    )
    return possible & found.possible, as_columns(columns)


# numerical: about as many pairs are held at a time.
PAIRS_AT_A_TIME = 1 << 19
# numerical: triples whose evidence is held at a time, some 500 bytes for each.
TRIPLES_AT_A_TIME = 1 << 17

# Of each view, the segments that come first in a pair, and those that come second.
Rows = tuple[tuple[Int[np.ndarray, "_"], ...], tuple[Int[np.ndarray, "_"], ...]]


def trinocular_candidates(
    lines: SegmentTable,
    views: tuple[int, int, int],
    counts: list[int],
    clutter: ClutterModel,
    tuning: MatchTuning = DEFAULT,
) -> Candidates:
    """All triples of three views; each is found from the pair of views that crosses best."""
    return candidates_among(prepare_orders(lines, views, counts, clutter, tuning), tuning)


def candidates_among(
    orders: Orders,
    tuning: MatchTuning = DEFAULT,
    *,
    learned: SearchPrior | None = None,
    rows: Rows | None = None,
) -> Candidates:
    """All triples, each found from the pair of views that crosses best.

    With `learned`, those in its region alone that may be likely. With `rows`, those of pairs of
    certain segments.
    """
    numbers = orders.numbers
    every = tuple(np.arange(number) for number in numbers)
    first, second = (every, every) if rows is None else rows
    parts, known = [no_candidates(3, orders.lines.frame is not None)], np.zeros(0, np.int64)
    for own in orders.each:
        here = [known]
        pair = first[own.order[0]], second[own.order[1]]
        for number, part in _in_order(orders, own, known, tuning, learned, pair):
            here.append(number)
            parts.append(part)
            if sum(len(found.index) for found in parts) > tuning.candidates.most_candidates:
                every_part = concatenate_rows(parts)
                odds = _odds_anywhere(every_part, float(np.mean(numbers)), tuning)
                parts = [every_part.take(odds > np.median(odds))]
        known = np.sort(np.concatenate(here))
    found = concatenate_rows(parts)
    found = found.take(np.argsort(_number_triples(found.index, numbers)))
    index = np.full((len(found.index), len(orders.counts)), -1)
    interval = np.zeros((len(found.index), len(orders.counts), 2))
    index[:, orders.views], interval[:, orders.views] = found.index, found.interval
    return found._replace(index=index, interval=interval)


def _number_triples(index: Int[np.ndarray, "m 3"], counts: list[int]) -> Int[np.ndarray, "m"]:
    """A number of its own for each triple."""
    i, j, k = index.T.astype(np.int64)
    return (i * counts[1] + j) * counts[2] + k


def _in_order(
    orders: Orders,
    own: Order,
    known: Int[np.ndarray, "t"],
    tuning: MatchTuning,
    learned: SearchPrior | None,
    pair: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
) -> Iterator[tuple[Int[np.ndarray, "_"], Candidates]]:
    """(numbers of triples, those that may be likely) of which the first two views predict the third
    segment, but those `known`: two orderings find one triple where they cross about as well."""
    lines, clutter, numbers = orders.lines, orders.clutter, orders.numbers
    order, planes, inputs, table = own
    typical = float(np.mean(numbers))
    within, screen = None, None
    if learned is not None:
        screen = jax.device_put((lines, order, planes, clutter))
        within = None if learned.region is None else region_of_pencil(learned.region, planes)
    ends_px = None if learned is None else learned.ends_px
    for i, j in pairs_sharing_planes(lines, order[:2], planes, pair, PAIRS_AT_A_TIME, ends_px):
        if within is not None:
            i, j = select_pairs_in_region(lines, inputs, within, i, j, tuning.candidates)
        # Of three ends two may agree whose pair crosses worse than another.
        any_order = ends_px is not None
        triple = gate_triples(lines, inputs, table, i, j, tuning.candidates, any_order)
        if len(known):
            number = _number_triples(triple[:, np.argsort(order)], numbers)
            place = np.minimum(np.searchsorted(known, number), len(known) - 1)
            triple = triple[known[place] != number]
        if learned is not None and screen is not None:
            triple = likely_triples(screen, triple, learned, tuning)
        for part in blocks(len(triple), TRIPLES_AT_A_TIME):
            found = evaluate_triples(lines, order, planes, triple[part], clutter, tuning)
            # Most of what passes the gate is not likely, and takes memory. Frames of a stack are
            # small.
            many = lines.frame is None and learned is None
            many = many and len(found.index) > tuning.candidates.prune_above
            number = _number_triples(found.index, numbers)
            if many:
                odds = _odds_anywhere(found, typical, tuning)
                found = found.take(odds > tuning.candidates.prune_log_odds)
            yield number, found


def _odds_anywhere(
    found: Candidates, typical_count: float, tuning: MatchTuning
) -> Float[np.ndarray, "m"]:
    mixture = prior_parameters(found.ends_mm, typical_count, tuning)
    # One block shows how large the volume is, but not yet where lines lie in it.
    everywhere = mixture.volume._replace(precision=np.zeros((3, 3)))
    return prior_log_odds(found, mixture._replace(volume=everywhere), tuning.evidence)
