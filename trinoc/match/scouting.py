"""Triples of large pictures: a sample of the segments tells where all lines lie.

The sample is matched against everything. From its sure triples come a box in space, with a margin,
and the parameters of the evidence. All pairs are then searched within the box, and what cannot be
likely is dropped at sight. Segments that nothing explains by then are searched everywhere.
"""

import numpy as np
from jaxtyping import Bool, Int

from trinoc.match.candidates import (
    Candidates,
    Learned,
    candidates_among,
    prepared_orders,
    prior_log_odds,
    region_of,
)
from trinoc.match.evidence import probability
from trinoc.match.observations import ClutterModel, SegmentTable
from trinoc.match.selection import affordable, conflict_graph, select, sum_product
from trinoc.match.tuning import MatchTuning
from trinoc.numerics import concatenate_rows


def scouted_candidates(
    lines: SegmentTable,
    views: tuple[int, int, int],
    counts: list[int],
    clutter: ClutterModel,
    tuning: MatchTuning,
) -> Candidates:
    """`trinocular_candidates`, of large pictures with less work: those that may be likely."""
    numbers = [counts[view] for view in views]
    orders = prepared_orders(lines, views, counts, clutter, tuning)
    if lines.frame is not None or min(numbers) <= tuning.scouting.above:
        return candidates_among(orders, tuning)
    every = tuple(np.arange(number) for number in numbers)
    sample = tuple(_spread(number, tuning.scouting.sample) for number in numbers)
    found = candidates_among(orders, tuning, rows=(sample, every))
    learned = _learned(found, float(np.mean(numbers)), tuning)
    if learned is None:
        return candidates_among(orders, tuning)
    inside = candidates_among(orders, tuning, learned=learned)
    free = _unexplained(inside, views, numbers, learned, tuning)
    left = tuple(np.flatnonzero(own) for own in free)
    anywhere = learned._replace(region=None)
    outside = candidates_among(orders, tuning, learned=anywhere, rows=(left, left))
    return _united(inside, outside)


def _spread(count: int, sample: int) -> Int[np.ndarray, "_"]:
    """Numbers of a sample of segments; these are in the order of their places."""
    return np.unique(np.linspace(0, count - 1, min(sample, count)).astype(np.int64))


def _learned(found: Candidates, count: float, tuning: MatchTuning) -> Learned | None:
    """What the triples of a sample say, None where too few of them are sure."""
    rules = tuning.scouting
    selection = select(found, float(rules.sample), neighbours=False, tuning=tuning)
    sure = selection.taken & (probability(selection.posterior_log_odds) > rules.sure)
    if sure.sum() < max(rules.fewest, 2):
        return None
    region = region_of(selection.candidates.union_ends_mm[sure], rules)
    # As many lines more as there are segments, and as likely wherever they lie.
    mixture = selection.mixture
    log_count = mixture.log_count + np.log(count / rules.sample)
    least = tuning.selection.prune_log_odds - rules.slack_log_odds
    return Learned(region, mixture._replace(log_count=log_count), least)


def _unexplained(
    found: Candidates,
    views: tuple[int, int, int],
    numbers: list[int],
    learned: Learned,
    tuning: MatchTuning,
) -> list[Bool[np.ndarray, "_"]]:
    """Segments of each view that are in no likely candidate, as far as their rivals say."""
    odds = prior_log_odds(found, learned.mixture, tuning.evidence)
    keep = np.flatnonzero(odds > tuning.selection.learn_log_odds)
    keep = keep[affordable(odds[keep], found.index[keep], tuning.selection)]
    index, odds = found.index[keep], odds[keep]
    graph = conflict_graph(index, found.interval[keep], tuning.selection)
    posterior = probability(sum_product(odds, graph, tuning.selection).log_odds)
    likely = index[posterior > tuning.scouting.explained]
    free = [np.ones(number, dtype=bool) for number in numbers]
    for own, view in zip(free, views, strict=True):
        own[likely[:, view]] = False
    return free


def _united(one: Candidates, other: Candidates) -> Candidates:
    """Candidates of both, each once, in their order."""
    both = concatenate_rows([one, other])
    return both.take(np.unique(both.index, axis=0, return_index=True)[1])
