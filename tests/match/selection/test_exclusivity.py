"""Beliefs are the exact marginals if the conflicts form a tree."""

from itertools import product

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from trinoc.match.selection.messages import choose_greedily, conflict_graph, sum_product

WHOLE = np.array([0.0, 1.0])


def exact_marginals(log_odds: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Exact marginals: a sum over every set of candidates that uses no segment twice."""
    weight, total = np.zeros(len(log_odds)), 0.0
    for is_selected in product((False, True), repeat=len(log_odds)):
        rows = index[list(is_selected)]
        used = [(v, s) for row in rows for v, s in enumerate(row) if s >= 0]
        if len(used) == len(set(used)):
            w = np.exp(log_odds[list(is_selected)].sum())
            total += w
            weight += w * np.array(is_selected)
    return weight / total


@given(st.lists(st.floats(-4, 4), min_size=4, max_size=4))
def test_beliefs_on_a_chain_are_the_marginals(odds: list[float]) -> None:
    # 0 and 1 share a segment of view 0, 1 and 2 one of view 1, 2 and 3 one of view 2.
    index = np.array([[0, 0, 0], [0, 1, 1], [1, 1, 2], [2, 2, 2]])
    log_odds = np.array(odds)
    graph = conflict_graph(index, np.broadcast_to(WHOLE, (4, 3, 2)))
    posterior_log_odds = sum_product(log_odds, graph).log_odds
    exact = exact_marginals(log_odds, index)
    np.testing.assert_allclose(1 / (1 + np.exp(-posterior_log_odds)), exact, atol=0.01)


def test_parts_that_do_not_overlap_do_not_conflict() -> None:
    index = np.array([[0, 0, 0], [0, 1, 1]])
    part = np.array([[[0.0, 0.5]] + [[0.0, 1.0]] * 2, [[0.45, 1.0]] + [[0.0, 1.0]] * 2])
    assert len(conflict_graph(index, part).slot) == 0
    part[1, 0] = [1.0, 0.2]
    assert len(conflict_graph(index, part).slot) == 2


def one_by_one(score: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Greedy selection in order of the score. Of equal scores the first comes first."""
    taken, used = np.zeros(len(score), dtype=bool), set()
    for m in np.argsort(-score, kind="stable"):
        segments = set(enumerate(index[m].tolist()))
        if score[m] > 0 and not segments & used:
            taken[m] = True
            used |= segments
    return taken


@given(st.integers(0, 1000), st.booleans())
def test_rounds_choose_what_taking_one_by_one_does(seed: int, ties: bool) -> None:
    rng = np.random.default_rng(seed)
    index, score = rng.integers(0, 6, (25, 3)), rng.normal(1, 2, 25)
    score = np.round(score) if ties else score
    graph = conflict_graph(index, np.broadcast_to(WHOLE, (25, 3, 2)))
    np.testing.assert_array_equal(choose_greedily(score, graph), one_by_one(score, index))


def test_frames_of_a_stack_settle_as_each_does_alone() -> None:
    rng = np.random.default_rng(5)
    # The second frame has hardly a conflict, and settles long before the first.
    index = np.concatenate([rng.integers(0, 8, (30, 3)), 8 + rng.integers(0, 40, (20, 3))])
    log_odds, frame = rng.normal(0, 3, 50), np.repeat([0, 1], [30, 20])
    intervals = np.broadcast_to(WHOLE, (50, 3, 2))
    both = sum_product(log_odds, conflict_graph(index, intervals), frame=frame).log_odds
    for number in (0, 1):
        in_frame = frame == number
        alone = sum_product(
            log_odds[in_frame], conflict_graph(index[in_frame], intervals[in_frame])
        ).log_odds
        np.testing.assert_allclose(both[in_frame], alone, atol=1e-12)


@given(st.lists(st.floats(-4, 4), min_size=4, max_size=4), st.floats(-2, 2))
def test_messages_go_on_from_those_under_other_odds(odds: list[float], change: float) -> None:
    index = np.array([[0, 0, 0], [0, 1, 1], [1, 1, 2], [2, 2, 2]])
    graph = conflict_graph(index, np.broadcast_to(WHOLE, (4, 3, 2)))
    before = sum_product(np.array(odds), graph)
    log_odds = np.array(odds) + change * np.array([1, -1, 1, -1])
    resumed = sum_product(log_odds, graph, previous=before).log_odds
    np.testing.assert_allclose(resumed, sum_product(log_odds, graph).log_odds, atol=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_chosen_uses_no_segment_twice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    index = rng.integers(0, 15, (60, 3))
    score = rng.normal(size=60)
    graph = conflict_graph(index, np.broadcast_to(WHOLE, (60, 3, 2)))
    taken = choose_greedily(score, graph)
    assert (score[taken] > 0).all()
    for view in range(3):
        assert len(np.unique(index[taken, view])) == taken.sum()
