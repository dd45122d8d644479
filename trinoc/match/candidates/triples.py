"""Step 1: triples of segments that can be one line, from all three orderings of the views."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates.judged import candidates_of
from trinoc.match.candidates.learned import Learned, likely_triples, screen_of
from trinoc.match.candidates.orders import Order, Orders, prepared_orders
from trinoc.match.candidates.region import pairs_within, region_of_pencil
from trinoc.match.candidates.search import gated_triples
from trinoc.match.candidates.table import Candidates, no_candidates, prior_log_odds
from trinoc.match.evidence import prior_parameters
from trinoc.match.observations import ClutterModel, SegmentTable
from trinoc.match.tuning import DEFAULT, MatchTuning
from trinoc.match.two_view import pairs_sharing_planes
from trinoc.numerics import concatenate_rows

# About as many pairs are held at a time.
PAIRS_AT_A_TIME = 1 << 19

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
    return candidates_among(prepared_orders(lines, views, counts, clutter, tuning), tuning)


def candidates_among(
    orders: Orders,
    tuning: MatchTuning = DEFAULT,
    *,
    learned: Learned | None = None,
    rows: Rows | None = None,
) -> Candidates:
    """All triples, each found from the pair of views that crosses best.

    With `learned`, those in its region alone that may be likely. With `rows`, those of pairs of
    certain segments.
    """
    numbers = orders.numbers
    every = tuple(np.arange(number) for number in numbers)
    first, second = (every, every) if rows is None else rows
    parts, known = [no_candidates(3)], np.zeros(0, np.int64)
    for own in orders.each:
        here = [known]
        pair = first[own.order[0]], second[own.order[1]]
        for number, part in _in_order(orders, own, known, tuning, learned, pair):
            here.append(number)
            parts.append(part)
            if sum(len(found.index) for found in parts) > tuning.candidates.most_candidates:
                parts = [_likelier_half(concatenate_rows(parts), numbers, tuning)]
        known = np.sort(np.concatenate(here))
    found = concatenate_rows(parts)
    found = found.take(np.argsort(_number_of(found.index, numbers)))
    index = np.full((len(found.index), len(orders.counts)), -1)
    interval = np.zeros((len(found.index), len(orders.counts), 2))
    index[:, orders.views], interval[:, orders.views] = found.index, found.interval
    return found._replace(index=index, interval=interval)


def _number_of(index: Int[np.ndarray, "m 3"], counts: list[int]) -> Int[np.ndarray, "m"]:
    """A number of its own for each triple."""
    i, j, k = index.T.astype(np.int64)
    return (i * counts[1] + j) * counts[2] + k


def _in_order(
    orders: Orders,
    own: Order,
    known: Int[np.ndarray, "t"],
    tuning: MatchTuning,
    learned: Learned | None,
    pair: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
) -> Iterator[tuple[Int[np.ndarray, "_"], Candidates]]:
    """(numbers of triples, those that may be likely) of which the first two views predict the third
    segment, but those `known`: two orderings find one triple where they cross about as well."""
    lines, clutter, numbers = orders.lines, orders.clutter, orders.numbers
    order, planes, single, table = own
    typical = float(np.mean(numbers))
    within, screen = None, None
    if learned is not None:
        screen = screen_of(lines, order, planes, clutter)
        within = None if learned.region is None else region_of_pencil(learned.region, planes)
    ends_px = None if learned is None else learned.ends_px
    for i, j in pairs_sharing_planes(lines, order[:2], planes, pair, PAIRS_AT_A_TIME, ends_px):
        if within is not None:
            i, j = pairs_within(lines, single, within, i, j, tuning.candidates)
        # Of three ends two may agree whose pair crosses worse than another.
        any_order = ends_px is not None
        triple = gated_triples(lines, single, table, i, j, tuning.candidates, any_order)
        if len(known):
            number = _number_of(triple[:, np.argsort(order)], numbers)
            place = np.minimum(np.searchsorted(known, number), len(known) - 1)
            triple = triple[known[place] != number]
        if learned is not None and screen is not None:
            triple = likely_triples(screen, triple, learned, tuning)
        found = candidates_of(lines, order, planes, triple, clutter, tuning)
        # Frames of a stack are small.
        many = lines.frame is None and learned is None
        many = many and len(found.index) > tuning.candidates.prune_above
        number = _number_of(found.index, numbers)
        yield number, _pruned(found, typical, tuning) if many else found


def _pruned(found: Candidates, typical_count: float, tuning: MatchTuning) -> Candidates:
    """Those that may yet be likely: most of what passes the gate is not, and takes memory."""
    odds = _odds_anywhere(found, typical_count, tuning)
    return found.take(odds > tuning.candidates.prune_log_odds)


def _likelier_half(found: Candidates, counts: list[int], tuning: MatchTuning) -> Candidates:
    odds = _odds_anywhere(found, float(np.mean(counts)), tuning)
    return found.take(odds > np.median(odds))


def _odds_anywhere(
    found: Candidates, typical_count: float, tuning: MatchTuning
) -> Float[np.ndarray, "m"]:
    mixture = prior_parameters(found.ends_mm, typical_count, tuning)
    # One block shows how large the volume is, but not yet where lines lie in it.
    everywhere = mixture.volume._replace(precision=np.zeros((3, 3)))
    return prior_log_odds(found, mixture._replace(volume=everywhere), tuning.evidence)
