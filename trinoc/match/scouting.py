"""Triples of large pictures: a sample of the segments tells where all lines lie.

The sample is matched against everything. From its sure triples come a box in space, with a margin,
and the parameters of the evidence, among them how nearly ends agree. Pairs of which an end agrees
are then searched within the box, all pairs where ends do not tell; what cannot be likely is dropped
at sight. Segments that are not explained by then, or not on all of their length, are searched
everywhere.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Int

from trinoc.match.candidates.learned import SearchPrior, bound_region
from trinoc.match.candidates.search import prepare_orders
from trinoc.match.candidates.table import Candidates, in_depth_range, prior_log_odds
from trinoc.match.candidates.triples import candidates_among
from trinoc.match.evidence.endpoints import reach_of_ends
from trinoc.match.evidence.mixture import probability
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.observations.match_input import MatchInput
from trinoc.match.observations.table import SegmentTable
from trinoc.match.selection.marginals import select
from trinoc.match.selection.messages import affordable, conflict_graph, sum_product
from trinoc.match.tracks.multiview import view_triplets
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.numerics.tables import concatenate_rows


def find_triples(
    seen: MatchInput,
    clutter: ClutterModel,
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
) -> Iterator[tuple[tuple[int, int, int], Candidates, Int[np.ndarray, "_o _v"]]]:
    """(three of the views, their candidates within the depth range, segments of those outside)."""
    for views in view_triplets(seen.lines, tuning.tracks):
        found = scout_candidates(seen.lines, views, seen.counts, clutter, tuning)
        inside = in_depth_range(found, seen.lines, depth_range_mm)
        yield views, found.take(inside), found.index[~inside]


def scout_candidates(
    lines: SegmentTable,
    views: tuple[int, int, int],
    counts: list[int],
    clutter: ClutterModel,
    tuning: MatchTuning,
) -> Candidates:
    """`trinocular_candidates`, of large pictures with less work: those that may be likely."""
    numbers = [counts[view] for view in views]
    orders = prepare_orders(lines, views, counts, clutter, tuning)
    if lines.frame is not None or min(numbers) <= tuning.scouting.above:
        return candidates_among(orders, tuning)
    every = tuple(np.arange(number) for number in numbers)
    sample = tuple(_spread(number, tuning.scouting.sample) for number in numbers)
    found = candidates_among(orders, tuning, rows=(sample, every))
    learned = _learn_prior(found, float(np.mean(numbers)), clutter, tuning)
    if learned is None:
        return candidates_among(orders, tuning)
    inside = candidates_among(orders, tuning, learned=learned)
    free = _find_unexplained(inside, views, numbers, learned, tuning)
    left = tuple(np.flatnonzero(own) for own in free)
    anywhere = learned._replace(region=None, ends_px=None)
    outside = candidates_among(orders, tuning, learned=anywhere, rows=(left, left))
    both = concatenate_rows([inside, outside])
    # Each once, in their order.
    return both.take(np.unique(both.index, axis=0, return_index=True)[1])


def _spread(count: int, sample: int) -> Int[np.ndarray, "_"]:
    """Numbers of a sample of segments; these are in the order of their places."""
    return np.unique(np.linspace(0, count - 1, min(sample, count)).astype(np.int64))


def _learn_prior(
    found: Candidates, count: float, clutter: ClutterModel, tuning: MatchTuning
) -> SearchPrior | None:
    """What the triples of a sample say, None where too few of them are sure."""
    rules = tuning.scouting
    selection = select(found, float(rules.sample), neighbours=False, tuning=tuning)
    sure = selection.taken & (probability(selection.posterior_log_odds) > rules.sure)
    if sure.sum() < max(rules.fewest, 2):
        return None
    region = bound_region(selection.candidates.union_ends_mm[sure], rules)
    # As many lines more as there are segments, and as likely wherever they lie.
    mixture = selection.mixture
    log_count = mixture.log_count + np.log(count / rules.sample)
    least = tuning.selection.prune_log_odds - rules.slack_log_odds
    mixture = mixture._replace(log_count=log_count)
    ends_px = reach_of_ends(mixture.ends, float(np.asarray(clutter.typical_px)), rules, tuning.ends)
    return SearchPrior(region, mixture, least, ends_px)


def _find_unexplained(
    found: Candidates,
    views: tuple[int, int, int],
    numbers: list[int],
    learned: SearchPrior,
    tuning: MatchTuning,
) -> list[Bool[np.ndarray, "_"]]:
    """Segments of each view that likely candidates show little of, as far as their rivals say."""
    odds = prior_log_odds(found, learned.mixture, tuning.evidence)
    rules = tuning.selection
    keep = affordable(odds, found.index, rules.learn_log_odds, rules)
    index, interval, odds = found.index[keep], found.interval[keep], odds[keep]
    graph = conflict_graph(index, interval, tuning.selection)
    posterior = probability(sum_product(odds, graph, tuning.selection).log_odds)
    likely = posterior > tuning.scouting.explained
    length = np.abs(np.diff(interval[likely], axis=2)[..., 0])
    # Where all pairs have been tried, any part is enough.
    enough = 0.0 if learned.ends_px is None else tuning.scouting.covered
    return [
        np.bincount(index[likely, view], length[:, view], minlength=number) <= enough
        for number, view in zip(numbers, views, strict=True)
    ]
