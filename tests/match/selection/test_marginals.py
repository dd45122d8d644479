"""The selection combines evidence, exclusion and neighbours, whatever the candidates' order."""

import numpy as np
import pytest

from tests.match.scene import MadeScene
from trinoc.match.candidates.table import Candidates, no_candidates, prior_log_odds
from trinoc.match.selection.marginals import Selection, select, selected_tracks
from trinoc.match.selection.messages import _padded_sizes, sum_product
from trinoc.match.tuning.every_group import DEFAULT

CONFLICT_OVERLAP = DEFAULT.selection.conflict_overlap
PRUNE_LOG_ODDS = DEFAULT.selection.prune_log_odds

TYPICAL = 30.0


@pytest.fixture(scope="module")
def selection(triples: Candidates) -> Selection:
    return select(triples, TYPICAL)


def test_true_triples_are_taken(noisy: MadeScene, selection: Selection) -> None:
    taken = {tuple(row) for row in selection.candidates.index[selection.is_accepted].tolist()}
    true = {tuple(row) for row in noisy.true.tolist()}
    assert len(taken & true) >= 25
    assert len(taken - true) <= 2


def test_no_part_of_a_segment_is_taken_twice(selection: Selection) -> None:
    index = selection.candidates.index[selection.is_accepted]
    part = np.sort(selection.candidates.interval[selection.is_accepted], axis=2)
    for view in range(3):
        for m, n in zip(*np.triu_indices(len(index), 1), strict=True):
            if index[m, view] == index[n, view]:
                shared = part[[m, n], view, 1].min() - part[[m, n], view, 0].max()
                assert shared <= CONFLICT_OVERLAP * np.ptp(part[[m, n], view], axis=1).min()


def test_odds_alone_are_those_of_what_was_learned(triples: Candidates) -> None:
    alone = select(triples, TYPICAL, neighbours=False)
    odds = prior_log_odds(alone.candidates, alone.mixture)
    # Sums of other rows round otherwise.
    np.testing.assert_allclose(alone.log_odds, odds, rtol=1e-12)
    beliefs = sum_product(alone.log_odds, alone.graph)
    np.testing.assert_array_equal(alone.posterior_log_odds, beliefs.log_odds)
    assert (odds > PRUNE_LOG_ODDS).all()
    # Rivals only ever lower the odds.
    assert (alone.posterior_log_odds <= odds).all()


def test_the_order_of_candidates_changes_nothing(triples: Candidates, selection: Selection) -> None:
    turn = np.random.default_rng(3).permutation(len(triples.index))
    reordered = select(triples.take(turn), TYPICAL)
    one, other = (np.lexsort(result.candidates.index.T) for result in (selection, reordered))
    np.testing.assert_array_equal(
        selection.candidates.index[one], reordered.candidates.index[other]
    )
    np.testing.assert_array_equal(selection.is_accepted[one], reordered.is_accepted[other])
    np.testing.assert_allclose(
        selection.posterior_log_odds[one], reordered.posterior_log_odds[other], atol=1e-6
    )


def test_the_rival_of_a_track_is_the_best_that_it_excludes(selection: Selection) -> None:
    tracks = selected_tracks(selection)
    taken = np.flatnonzero(selection.is_accepted)
    np.testing.assert_array_equal(tracks.candidates.index, selection.candidates.index[taken])
    np.testing.assert_array_equal(tracks.posterior_log_odds, selection.posterior_log_odds[taken])
    edges = list(zip(selection.graph.slot // 3, selection.graph.rival_slot // 3, strict=True))
    for n, row in enumerate(taken):
        rivals = [selection.posterior_log_odds[b] for a, b in edges if a == row]
        assert tracks.rival_posterior[n] == max(rivals, default=-np.inf)


def test_nothing_is_selected_from_nothing() -> None:
    nothing = select(no_candidates(3), TYPICAL)
    assert len(nothing.is_accepted) == 0
    assert len(selected_tracks(nothing).posterior_log_odds) == 0


def test_few_programs_serve_candidates_and_conflicts_of_any_number() -> None:
    random = np.random.default_rng(0)
    # As of 40 to 400 segments a view, which are tens to thousands of candidates.
    candidates = np.exp(random.uniform(np.log(10), np.log(6000), 2000)).astype(int)
    conflicts = (candidates * random.uniform(1, 50, 2000)).astype(int)
    needs = np.stack([candidates, conflicts], axis=1)
    sizes = [_padded_sizes(*need) for need in needs.tolist()]
    assert (np.array(sizes) >= needs).all()
    assert len(set(sizes)) <= 18
