"""Step 1 for images with many segments: a sample of the segments determines where all lines lie.

1. The sample is matched against all segments. Its sure triples give a box in space with a margin,
   and the parameters of the evidence.
2. Pairs whose ends agree are searched inside this box. If ends are not informative, all pairs are.
   Unlikely candidates are discarded at once.
3. Segments that are still not explained over their full length are searched everywhere.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Int

from trinoc.match.candidates.learned import SearchPrior, bound_region
from trinoc.match.candidates.search import prepare_orders
from trinoc.match.candidates.table import Candidates, in_depth_range, prior_log_odds
from trinoc.match.candidates.triples import search_candidates
from trinoc.match.evidence.endpoints import end_search_radius_px
from trinoc.match.evidence.mixture import probability
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.observations.match_input import MatchInput
from trinoc.match.observations.table import SegmentTable
from trinoc.match.selection.marginals import select
from trinoc.match.selection.messages import conflict_graph, rows_within_memory, sum_product
from trinoc.match.tracks.multiview import view_triplets
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.numerics.tables import concatenate_rows


def find_triples(
    inputs: MatchInput,
    clutter: ClutterModel,
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
) -> Iterator[tuple[tuple[int, int, int], Candidates, Int[np.ndarray, "_o _v"]]]:
    """Yield the candidate triples of each triplet of views.

    Each item is (the three views, candidates in the depth range, segments (o, v) of the other
    candidates).
    """
    for views in view_triplets(inputs.lines, tuning.tracks):
        candidates = scout_candidates(inputs.lines, views, inputs.counts, clutter, tuning)
        in_range = in_depth_range(candidates, inputs.lines, depth_range_mm)
        yield views, candidates.take(in_range), candidates.index[~in_range]


def scout_candidates(
    lines: SegmentTable,
    views: tuple[int, int, int],
    counts: list[int],
    clutter: ClutterModel,
    tuning: MatchTuning,
) -> Candidates:
    """Return the candidate triples of three views, with less work than `trinocular_candidates`.

    For more than 1,500 segments per view, a sample of the segments restricts the search. Unlikely
    candidates may be missing.
    """
    view_counts = [counts[view] for view in views]
    orders = prepare_orders(lines, views, counts, clutter, tuning)
    if lines.frame is not None or min(view_counts) <= tuning.scouting.min_segments:
        return search_candidates(orders, tuning)
    all_rows = tuple(np.arange(count) for count in view_counts)
    sample_rows = tuple(_evenly_spaced(count, tuning.scouting.sample_size) for count in view_counts)
    sampled = search_candidates(orders, tuning, rows=(sample_rows, all_rows))
    search_prior = _learn_prior(sampled, float(np.mean(view_counts)), clutter, tuning)
    if search_prior is None:
        return search_candidates(orders, tuning)
    regional = search_candidates(orders, tuning, prior=search_prior)
    is_unexplained = _find_unexplained(regional, views, view_counts, search_prior, tuning)
    remaining_rows = tuple(np.flatnonzero(mask) for mask in is_unexplained)
    unbounded_prior = search_prior._replace(region=None, ends_px=None)
    remaining = search_candidates(
        orders, tuning, prior=unbounded_prior, rows=(remaining_rows, remaining_rows)
    )
    union = concatenate_rows([regional, remaining])
    # Remove duplicates; the result is sorted.
    return union.take(np.unique(union.index, axis=0, return_index=True)[1])


def _evenly_spaced(count: int, sample_size: int) -> Int[np.ndarray, "_"]:
    """Return the indices of an evenly spaced sample of `count` segments, which are sorted by
    position.
    """
    return np.unique(np.linspace(0, count - 1, min(sample_size, count)).astype(np.int64))


def _learn_prior(
    candidates: Candidates, count: float, clutter: ClutterModel, tuning: MatchTuning
) -> SearchPrior | None:
    """Estimate the restrictions of the search from the triples of a sample.

    The result is None if too few of these triples have a posterior above 0.9. `count` is the number
    of segments per view.
    """
    rules = tuning.scouting
    selection = select(candidates, float(rules.sample_size), neighbours=False, tuning=tuning)
    is_sure = selection.is_accepted & (
        probability(selection.posterior_log_odds) > rules.sure_posterior
    )
    if is_sure.sum() < max(rules.min_sure_triples, 2):
        return None
    region = bound_region(selection.candidates.union_ends_mm[is_sure], rules)
    # Scale the number of lines from the sample to all segments, with the same density.
    mixture = selection.mixture
    log_count = mixture.log_count + np.log(count / rules.sample_size)
    least_log_odds = tuning.selection.prune_log_odds - rules.slack_log_odds
    mixture = mixture._replace(log_count=log_count)
    ends_px = end_search_radius_px(
        mixture.ends, float(np.asarray(clutter.typical_px)), rules, tuning.ends
    )
    return SearchPrior(region, mixture, least_log_odds, ends_px)


def _find_unexplained(
    candidates: Candidates,
    views: tuple[int, int, int],
    view_counts: list[int],
    search_prior: SearchPrior,
    tuning: MatchTuning,
) -> list[Bool[np.ndarray, "_"]]:
    """Return, for each view, the mask of the segments that likely candidates use too little.

    The used share of the length must exceed `explained_share`; without the limit
    `search_prior.ends_px`, any used part is enough. A candidate is likely if its posterior is
    large. Candidates that use the same part of a segment exclude each other.
    """
    odds = prior_log_odds(candidates, search_prior.mixture, tuning.evidence)
    rules = tuning.selection
    selected_rows = rows_within_memory(odds, candidates.index, rules.learn_log_odds, rules)
    index = candidates.index[selected_rows]
    interval = candidates.interval[selected_rows]
    odds = odds[selected_rows]
    graph = conflict_graph(index, interval, tuning.selection)
    posterior = probability(sum_product(odds, graph, tuning.selection).log_odds)
    is_likely = posterior > tuning.scouting.explained_posterior
    length = np.abs(np.diff(interval[is_likely], axis=2)[..., 0])
    # If all pairs were tried, any covered part is enough.
    covered_share = 0.0 if search_prior.ends_px is None else tuning.scouting.explained_share
    return [
        np.bincount(index[is_likely, view], length[:, view], minlength=count) <= covered_share
        for count, view in zip(view_counts, views, strict=True)
    ]
