"""Step 1 of the paper: triples of segments that can be one line, from all three orderings of the
views.

Two compiled programs evaluate the triples that passed the gate, in double precision. The first
fits a line to all three segments. The second computes the evidence on that line. It does not
depend on the number of segments in the images.
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

# numerical: shapes of the columns of each triple: interval, ends_mm, chi_square, log_density,
# end_log, union_ends_mm, union_covariance_mm2, px_per_mm.
_SHAPES = ((3, 2), (2, 3), (), (), (2, END_COMPONENTS), (2, 3), (2, 6), ())


def evaluate_triples(
    lines: SegmentTable,
    order: Int[np.ndarray, "3"],
    planes: Pencil,
    triple: Int[np.ndarray, "h 3"],
    clutter: ClutterModel,
    tuning: MatchTuning,
) -> Candidates:
    """Compute the evidence of triples (h, 3), and return the triples that can be one line.

    The columns of `triple` are segments of the views in the sequence of `order`.
    """

    def evaluate(triple: np.ndarray) -> tuple[ArrayLike, ArrayLike]:
        fitted = _fit_triples(lines, order, planes, triple, clutter, tuning=tuning.candidates)
        return _triple_evidence(*fitted, tuning=tuning.candidates, ends=tuning.ends)

    selected_rows, columns = select_in_blocks(evaluate, block_size(lines, TRIPLES_IN_BLOCK), triple)
    return build_candidates(
        lines, order, triple[selected_rows], split_columns(columns, _SHAPES), tuning
    )


@partial(kept_jit, static_argnames=("tuning",), few_rows_of="triple")
def _fit_triples(
    lines: SegmentTable,
    order: Int[ArrayLike, "3"],
    planes: Pencil,
    triple: Int[ArrayLike, "h 3"],
    clutter: ClutterModel,
    tuning: CandidateTuning,
) -> tuple[SegmentPlanes, tuple[Vector3, Vector3], Bool[ArrayLike, "h"]]:
    """Fit a line in space to the three segments of each triple.

    Returns (segments with the data of their cameras, the two ends of each line, mm, mask of the
    triples that can be one line).
    """
    segments = triple.T
    planes_of_triple = segment_planes(lines, clutter, order, segments)
    pencil = take_pencil(planes, lines, order[0], segments[0])
    rows = take_segments(planes.first, segments[0]), take_segments(planes.second, segments[1])
    line_mm = common_ends_mm(pencil, cut_pair(pencil.baseline_mm, *rows, tuning))
    return planes_of_triple, *line_of_three(planes_of_triple, line_mm, tuning)


@partial(kept_jit, static_argnames=("tuning", "ends"), few_rows_of="possible")
def _triple_evidence(
    planes_of_triple: SegmentPlanes,
    fitted_mm: tuple[Vector3, Vector3],
    possible: Bool[ArrayLike, "h"],
    tuning: CandidateTuning,
    ends: EndTuning,
) -> tuple[Bool[ArrayLike, "h"], Float[ArrayLike, "c h"]]:
    """Compute the evidence of each triple on the line fitted to its three segments.

    Returns the mask of possible triples, and the columns of `_SHAPES` as one array (c, h). The
    result does not depend on which pair predicted the triple.
    """
    evidence = triple_evidence(planes_of_triple, fitted_mm, tuning)
    columns = (
        *(evidence.interval, evidence.ends_mm, evidence.chi_square, evidence.log_density),
        *(end_evidence(evidence.extent_px, ends), evidence.union_ends_mm),
        *(evidence.union_covariance_mm2, evidence.px_per_mm),
    )
    return possible & evidence.possible, as_columns(columns)


# numerical: approximate number of pairs in memory.
PAIRS_AT_A_TIME = 1 << 19
# numerical: number of triples whose evidence is in memory, about 500 bytes each.
TRIPLES_AT_A_TIME = 1 << 17

# For each view: segments that may come first in a pair, and segments that may come second.
Rows = tuple[tuple[Int[np.ndarray, "_"], ...], tuple[Int[np.ndarray, "_"], ...]]


def trinocular_candidates(
    lines: SegmentTable,
    views: tuple[int, int, int],
    counts: list[int],
    clutter: ClutterModel,
    tuning: MatchTuning = DEFAULT,
) -> Candidates:
    """Return all candidate triples of three views.

    Each triple is predicted by the two segments whose interpretation planes cross at the widest
    angle.
    """
    return search_candidates(prepare_orders(lines, views, counts, clutter, tuning), tuning)


def search_candidates(
    orders: Orders,
    tuning: MatchTuning = DEFAULT,
    *,
    prior: SearchPrior | None = None,
    rows: Rows | None = None,
) -> Candidates:
    """Search for the candidate triples of three views.

    Parameters
    ----------
    orders : Orders
        Search data of the three orderings of the views.
    tuning : MatchTuning
        Tuned constants.
    prior : SearchPrior, optional
        Restricts the search to a box in space and to likely candidates.
    rows : (first, second), optional
        For each view, the segments to use as the first member of a pair, and those to use as the
        second. Default: all segments.
    """
    counts = orders.counts_of_three
    all_rows = tuple(np.arange(count) for count in counts)
    first, second = (all_rows, all_rows) if rows is None else rows
    parts = [no_candidates(3, orders.lines.frame is not None)]
    all_ids = np.zeros(0, np.int64)
    for order in orders.orders:
        id_parts = [all_ids]
        pair = first[order.order[0]], second[order.order[1]]
        for ids, part in _search_ordering(orders, order, all_ids, tuning, prior, pair):
            id_parts.append(ids)
            parts.append(part)
            if sum(len(part.index) for part in parts) > tuning.candidates.max_candidates:
                all_parts = concatenate_rows(parts)
                odds = _log_odds_without_position(all_parts, float(np.mean(counts)), tuning)
                parts = [all_parts.take(odds > np.median(odds))]
        all_ids = np.sort(np.concatenate(id_parts))
    candidates = concatenate_rows(parts)
    candidates = candidates.take(np.argsort(_triple_ids(candidates.index, counts)))
    index = np.full((len(candidates.index), len(orders.counts)), -1)
    interval = np.zeros((len(candidates.index), len(orders.counts), 2))
    index[:, orders.views], interval[:, orders.views] = candidates.index, candidates.interval
    return candidates._replace(index=index, interval=interval)


def _triple_ids(index: Int[np.ndarray, "m 3"], counts: list[int]) -> Int[np.ndarray, "m"]:
    """Return an integer for each triple, unique among all triples of the three views."""
    i, j, k = index.T.astype(np.int64)
    return (i * counts[1] + j) * counts[2] + k


def _search_ordering(
    orders: Orders,
    order_input: Order,
    earlier_ids: Int[np.ndarray, "t"],
    tuning: MatchTuning,
    prior: SearchPrior | None,
    pair: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
) -> Iterator[tuple[Int[np.ndarray, "_"], Candidates]]:
    """Yield blocks of (result of `_triple_ids`, candidates) from one ordering of the views.

    Triples with an id in `earlier_ids` are skipped, because another ordering has predicted them.
    `pair` are the segments of the first view and of the second view to combine.
    """
    lines, clutter, counts = orders.lines, orders.clutter, orders.counts_of_three
    order, planes, inputs, table = order_input
    mean_count = float(np.mean(counts))
    region, screen = None, None
    if prior is not None:
        screen = jax.device_put((lines, order, planes, clutter))
        region = None if prior.region is None else region_of_pencil(prior.region, planes)
    ends_px = None if prior is None else prior.ends_px
    for i, j in pairs_sharing_planes(lines, order[:2], planes, pair, PAIRS_AT_A_TIME, ends_px):
        if region is not None:
            i, j = select_pairs_in_region(lines, inputs, region, i, j, tuning.candidates)
        # The pair whose ends agree need not be the pair that crosses best.
        any_order = ends_px is not None
        triple = gate_triples(lines, inputs, table, i, j, tuning.candidates, any_order)
        if len(earlier_ids):
            ids = _triple_ids(triple[:, np.argsort(order)], counts)
            position = np.minimum(np.searchsorted(earlier_ids, ids), len(earlier_ids) - 1)
            triple = triple[earlier_ids[position] != ids]
        if prior is not None and screen is not None:
            triple = likely_triples(screen, triple, prior, tuning)
        for part in blocks(len(triple), TRIPLES_AT_A_TIME):
            candidates = evaluate_triples(lines, order, planes, triple[part], clutter, tuning)
            # Most triples that pass the gate are unlikely, and they occupy memory. Frames of a
            # stack are small, so they need no pruning.
            is_large = lines.frame is None and prior is None
            is_large = is_large and len(candidates.index) > tuning.candidates.prune_above
            ids = _triple_ids(candidates.index, counts)
            if is_large:
                odds = _log_odds_without_position(candidates, mean_count, tuning)
                candidates = candidates.take(odds > tuning.candidates.prune_log_odds)
            yield ids, candidates


def _log_odds_without_position(
    candidates: Candidates, typical_count: float, tuning: MatchTuning
) -> Float[np.ndarray, "m"]:
    mixture = prior_parameters(candidates.ends_mm, typical_count, tuning)
    # One block determines the size of the volume, but not the positions of lines in it.
    flat_volume = mixture.volume._replace(precision=np.zeros((3, 3)))
    return prior_log_odds(candidates, mixture._replace(volume=flat_volume), tuning.evidence)
