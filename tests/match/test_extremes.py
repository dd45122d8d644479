"""Pictures with other content than lines: no segment exhausts the memory, and none makes others
sure."""

import tracemalloc

import equinox as eqx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.match.made import loose_lines, pictures, rig_of
from trinoc.geometry.segments import Segments, covariance_of_ends
from trinoc.match.candidates.index import LAYERS, spatial_index
from trinoc.match.matcher import match_segments
from trinoc.match.observations.unusable import DUPLICATE, POSITION_UNKNOWN, first_of_duplicates
from trinoc.match.selection.junction_support import _pairs_of_near_ends
from trinoc.match.selection.messages import (
    conflict_graph,
    log_kept_share,
    rows_within_memory,
    with_log_share,
)
from trinoc.match.tracks.answers import DISCARDED_TRIPLES
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.selection import SelectionTuning
from trinoc.numerics.tables import with_field

VIEWS = ("upper", "left", "right")
RIG = rig_of(*VIEWS)
# Bytes of NumPy at a time: what the same lines without extremes take is 30 MB.
MOST_BYTES = 300e6


def stated(ends_px, sigma_px):
    """Segments with these standard deviations across themselves, px."""
    sigma = np.broadcast_to(np.asarray(sigma_px, dtype=float), len(ends_px))
    covariance = np.concatenate(
        [
            covariance_of_ends(ends_px[k : k + 1], across_px, 4 * across_px)
            for k, across_px in enumerate(sigma)
        ]
    )
    segments = Segments.from_endpoints(ends_px, image_size_px=(512, 480))
    return eqx.tree_at(lambda s: s.covariance_px2, segments, covariance)


def peak_bytes(segments):
    """(matches, peak size of NumPy's arrays, bytes)."""
    tracemalloc.start()
    matches = match_segments(segments, RIG)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return matches, peak


def test_segments_that_say_nothing_change_no_other_match():
    lines = pictures(RIG, loose_lines(40, seed=3), sigma_px=0.2, seed=4)
    rng = np.random.default_rng(5)
    plain, more = {}, {}
    for view, ends in lines.items():
        shift, sigma = rng.uniform(-200, 200, (20, 1, 2)), 10 ** rng.uniform(1, 5, 20)
        plain[view] = stated(ends, 0.3)
        every = np.concatenate([ends, ends[:20] + shift, ends[:5]])
        more[view] = stated(every, np.concatenate([np.full(40, 0.3), sigma, np.full(5, 0.3)]))
    alone, (with_vague, peak) = match_segments(plain, RIG), peak_bytes(more)
    np.testing.assert_array_equal(with_vague.index, alone.index)
    # Which end is first follows from which view has the most segments.
    sorted_lines_mm = (np.sort(matches.lines_mm, axis=1) for matches in (with_vague, alone))
    np.testing.assert_allclose(*sorted_lines_mm, rtol=0, atol=1e-4)
    np.testing.assert_allclose(with_vague.posterior, alone.posterior, atol=1e-6)
    for view in VIEWS:
        assert set(with_vague.reasons[view][40:60]) == {POSITION_UNKNOWN}
        assert set(with_vague.reasons[view][60:]) == {DUPLICATE}
    assert with_vague.counts[f"segments {POSITION_UNKNOWN}"] == 60
    assert peak < MOST_BYTES


def test_copies_that_differ_by_less_than_their_sigmas_make_nothing_sure():
    """Any of 20 segments may belong to any other: no posterior prefers one, whatever the memory."""
    line = np.array([[[-60.0, -20.0, 5.0], [60.0, 30.0, 5.0]]])
    rng, segments = np.random.default_rng(1), {}
    for view, ends in pictures(RIG, line).items():
        copies = np.repeat(ends, 20, axis=0) + 0.2 * rng.normal(size=(20, 2, 2))
        segments[view] = stated(copies, 0.3)
    few = with_field(DEFAULT, "selection.max_conflicts", 1 << 18)
    tracemalloc.start()
    matches = match_segments(segments, RIG, tuning=few)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert matches.counts[DISCARDED_TRIPLES] > 0
    assert (matches.posterior < 0.5).all()
    assert any("repeated structure" in note for note in matches.notes)
    assert peak < MOST_BYTES


@given(
    count=st.integers(1, 60),
    others=st.integers(0, 5),
    seed=st.integers(0, 1000),
)
@settings(max_examples=25)
def test_of_equal_segments_the_first_is_left(count, others, seed):
    rng = np.random.default_rng(seed)
    one = rng.uniform(0, 400, (1, 2, 2))
    equal = one + 1e-3 * rng.uniform(-1, 1, (count, 2, 2))
    different = one + 20 + 10 * np.arange(others)[:, None, None]
    rows = first_of_duplicates(
        np.concatenate([equal, different]),
        np.full(count + others, 0.3),
        np.ones(count + others, int),
    )
    assert rows.tolist() == [0, *range(count, count + others)]


def test_edges_of_both_polarities_are_two():
    ends = np.tile(np.array([[[10.0, 10.0], [90.0, 40.0]]]), (3, 1, 1))
    assert first_of_duplicates(ends, np.full(3, 0.3), np.array([1, -1, 1])).tolist() == [0, 1]


@given(sigma_px=st.floats(1.0, 1e6), far_px=st.floats(0.0, 1e6))
@settings(max_examples=25)
def test_a_segment_enters_no_more_cells_than_there_are(sigma_px, far_px):
    ends = np.array([[[100.0, 90.0], [180.0, 120.0]], [[-far_px, -far_px], [far_px + 9, far_px]]])
    margins, slack = np.full((len(LAYERS), 2), 4 * sigma_px), np.full(2, 10.0)
    size = np.array([512.0, 480.0])
    table = spatial_index(ends, slack, margins, size, 9.0, 1.0)
    cells = sum(
        np.ceil(512 / (9 * layer.cell_scale))
        * np.ceil(480 / (9 * layer.cell_scale))
        * layer.sectors
        for layer in LAYERS
    )
    assert len(table.segment) <= 2 * cells
    if sigma_px > 200:
        assert len(table.segment) == 2 * cells


def test_a_share_gives_the_posterior_of_all_to_the_kept():
    """Candidates of one segment of each view exclude each other: p = odds / (1 + sum of odds)."""
    rng = np.random.default_rng(2)
    log_odds, index = rng.normal(0, 4, 30), np.zeros((30, 3), dtype=np.int64)
    rows = np.flatnonzero(rng.random(30) < 0.4)
    odds = np.exp(log_odds)
    alone = odds[rows] / (1 + odds[rows].sum())
    share = log_kept_share(log_odds, index, rows)
    shared_log_odds = with_log_share(np.log(alone) - np.log1p(-alone), share)
    np.testing.assert_allclose(
        1 / (1 + np.exp(-shared_log_odds)), odds[rows] / (1 + odds.sum()), rtol=1e-9
    )


def test_what_is_kept_has_no_more_conflicts_than_memory_bears():
    rng = np.random.default_rng(3)
    index = rng.integers(0, 12, (400, 3))
    # Many are equally likely.
    log_odds = np.round(rng.normal(0, 2, 400))
    for max_conflicts in (0, 10, 3000, 10**6):
        rules = SelectionTuning(max_conflicts=max_conflicts)
        rows = rows_within_memory(log_odds, index, -np.inf, rules)
        interval = np.tile([0.0, 1.0], (len(rows), 3, 1))
        assert len(conflict_graph(index[rows], interval).slot) <= max_conflicts
        assert log_odds[rows].min(initial=np.inf) > np.delete(log_odds, rows).max(initial=-np.inf)


def test_meetings_are_counted_before_they_are_listed():
    rng = np.random.default_rng(4)
    ends, log_odds = rng.uniform(0, 10, (200, 3)), rng.normal(size=100)
    is_near = np.linalg.norm(ends[:, None] - ends, axis=-1) <= 2
    every = {tuple(pair) for pair in np.argwhere(np.triu(is_near, 1))}
    assert {tuple(pair) for pair in _pairs_of_near_ends(ends, log_odds, 2.0, 10**6)} == every
    few = _pairs_of_near_ends(ends, log_odds, 2.0, 100)
    assert 0 < len(few) <= 100
    assert {tuple(pair) for pair in few} <= every
    lines = np.unique(few // 2)
    assert log_odds[lines].min() > np.median(log_odds)


@pytest.mark.parametrize("view", VIEWS)
def test_a_view_without_any_usable_segment_leaves_pairs_of_the_others(view):
    lines = pictures(RIG, loose_lines(40, seed=3), sigma_px=0.2, seed=4)
    segments = {name: stated(ends, 100.0 if name == view else 0.3) for name, ends in lines.items()}
    matches = match_segments(segments, RIG)
    assert len(matches) > 20
    assert (matches.index[:, VIEWS.index(view)] == -1).all()
