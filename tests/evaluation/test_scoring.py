"""Scores: the truth scores one, order does not matter, and each definition agrees by hand."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, strategies as st

from benchmarks.match_scores import score_matches
from simulation import Detector, block_scene, loose_segments, simulate_segments
from simulation.observations import PERFECT
from trinoc.evaluation.distances import distance_to_segments_mm, sampled_segments
from trinoc.evaluation.scoring import score_lengths
from trinoc.synth import table1_rig
from trinoc.synth.truth import (
    NOT_SCORED,
    SPURIOUS,
    SceneTruth,
    SeenParts,
    SegmentTruth,
    parts_in_views_mm,
    shown_parts_mm,
)

VIEWS = ("upper", "left", "right")
SEEDS = st.integers(0, 10_000)
RIG = table1_rig()


class Joined(NamedTuple):
    views: tuple[str, ...]
    index: np.ndarray


def tracks(rows, views=VIEWS):
    return Joined(views, np.array(rows).reshape(-1, len(views)))


def perfect_tracks(truth):
    """One track for each edge that two or more views show."""
    rows = []
    for edge in range(len(truth.edges_mm)):
        segments = [np.flatnonzero(truth.edge_of[view] == edge) for view in VIEWS]
        if sum(len(f) > 0 for f in segments) >= 2:
            rows.append([f[0] if len(f) else -1 for f in segments])
    return np.array(rows).reshape(-1, 3)


@given(seed=SEEDS)
def test_the_truth_scores_one(seed):
    # Within this reach all of each segment lies in all pictures.
    scene = loose_segments(seed, count=12, reach_mm=30.0)
    _, truth = simulate_segments(scene, RIG, PERFECT, seed=seed)
    score = score_matches(tracks(perfect_tracks(truth)), truth)
    assert score.pairs[:2] == (1.0, 1.0)
    assert score.triples[:2] == (1.0, 1.0)
    lengths = score_lengths(truth.edges_mm, truth, tolerance_mm=1e-3)
    assert lengths[:2] == (1.0, 1.0)


@given(seed=SEEDS)
def test_the_order_of_tracks_segments_and_views_does_not_matter(seed):
    generator = np.random.default_rng(seed)
    scene = block_scene(seed, count=3, cylinder_sides=8)
    _, truth = simulate_segments(scene, RIG, Detector(), seed=seed)
    counts = [len(truth.edge_of[view]) for view in VIEWS]
    rows = np.stack([generator.integers(-1, count, 60) for count in counts], axis=1)
    rows = np.concatenate([rows, perfect_tracks(truth)])
    score = score_matches(tracks(rows), truth)
    orders = {view: generator.permutation(n) for view, n in zip(VIEWS, counts, strict=True)}
    moved = SegmentTruth(
        truth.edges_mm,
        {view: truth.edge_of[view][orders[view]] for view in VIEWS},
        {view: truth.extent[view][orders[view], ::-1] for view in VIEWS},
    )
    renamed = np.stack(
        [
            np.where(rows[:, v] >= 0, np.argsort(orders[view])[rows[:, v]], -1)
            for v, view in enumerate(VIEWS)
        ],
        axis=1,
    )
    order = generator.permutation(3)
    reordered = tracks(generator.permutation(renamed)[:, order], tuple(VIEWS[v] for v in order))
    assert score_matches(reordered, moved) == score


def hand_made(extents, edges=None):
    """Truth with one segment per view on edge 0, with these extents."""
    edges = (0, 0, 0) if edges is None else edges
    return SegmentTruth(
        np.array([[[0.0, 0, 0], [100.0, 0, 0]]]),
        {view: np.array([edge]) for view, edge in zip(VIEWS, edges, strict=True)},
        {view: np.array([extent]) for view, extent in zip(VIEWS, extents, strict=True)},
    )


@pytest.mark.parametrize(
    ("extents", "right", "true"),
    [
        ([(0.0, 1.0), (0.0, 1.0), (0.5, 0.9)], 1.0, 1),
        # A common part below a fifth of the shortest is right when put out, and not asked for.
        ([(0.0, 0.5), (0.45, 1.0), (0.0, 1.0)], 1.0, 0),
        ([(0.0, 0.4), (0.5, 1.0), (0.0, 1.0)], 0.0, 0),
    ],
)
def test_a_triple_is_right_where_all_extents_overlap(extents, right, true):
    score = score_matches(tracks([[0, 0, 0]]), hand_made(extents))
    assert score.triples.precision == right
    assert score.triples.true == true


def test_spurious_segments_are_wrong_and_unscored_ones_do_not_count():
    full_extents = [(0.0, 1.0)] * 3
    row = tracks([[0, 0, 0]])
    wrong = score_matches(row, hand_made(full_extents, (0, 0, SPURIOUS)))
    assert (wrong.triples.precision, wrong.triples.put_out) == (0.0, 1)
    assert wrong.pairs.precision == pytest.approx(1 / 3)
    unscored = score_matches(row, hand_made(full_extents, (NOT_SCORED,) * 3))
    assert (unscored.triples.put_out, unscored.pairs.put_out) == (0, 0)
    mixed = score_matches(row, hand_made(full_extents, (NOT_SCORED, 0, 0)))
    assert (mixed.triples.put_out, mixed.pairs.put_out) == (1, 3)


def test_a_pair_of_two_views_counts_as_a_pair_alone():
    score = score_matches(tracks([[0, -1, 0]]), hand_made([(0.0, 1.0)] * 3))
    assert score.triples[:3] == (0.0, 0.0, 0)
    assert score.pairs == (1.0, pytest.approx(1 / 3), 1, 3)


def test_no_answer_scores_nothing():
    truth = hand_made([(0.0, 1.0)] * 3)
    assert score_matches(tracks(np.zeros((0, 3), dtype=int)), truth).pairs[:2] == (0.0, 0.0)
    assert score_lengths(np.zeros((0, 2, 3)), truth)[:2] == (0.0, 0.0)


def test_lengths_count_by_tolerance_and_share():
    truth = hand_made([(0.0, 0.6), (0.2, 1.0), (0.9, 1.0)])
    # Two views or more cover 0.2 to 0.6 and 0.9 to 1.
    lines = np.array([[[20.0, 0.9, 0], [60.0, 0.9, 0]], [[0.0, 5.0, 0], [40.0, 5.0, 0]]])
    loose, tight = (score_lengths(lines, truth, tolerance_mm=t) for t in (1.0, 0.5))
    assert loose.precision == pytest.approx(0.5)
    assert loose.length_true_mm == pytest.approx(50.0)
    assert loose.recall == pytest.approx(0.8, abs=0.02)
    assert tight[:2] == (0.0, 0.0)


def test_a_faint_edge_is_not_asked_for():
    edges = np.array([[[0.0, 0, 0], [10.0, 0, 0]], [[0.0, 5, 0], [20.0, 5, 0]]])

    def parts_seen(steps):
        return SeenParts(np.arange(2), np.array([[0.0, 1.0]] * 2), np.array(steps))

    truth = SceneTruth(
        edges, ("edge", "rim"), {"a": parts_seen([-30.0, 9.0]), "b": parts_seen([12.0, 7.0])}
    )
    np.testing.assert_allclose(shown_parts_mm(truth, grey_step=8.0), edges[:1])
    np.testing.assert_allclose(shown_parts_mm(truth), edges)
    np.testing.assert_allclose(shown_parts_mm(truth, kinds=("rim",)), edges[1:])
    score = score_lengths(edges[:1], truth, grey_step=8.0)
    assert (score.precision, score.recall) == (1.0, 1.0)


@given(
    st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), max_size=5),
    st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), max_size=5),
    st.floats(0.001, 0.999),
)
def test_shared_parts_hold_exactly_the_points_that_both_views_show(first, second, position):
    edge = np.array([[[0.0, 0, 0], [1.0, 0, 0]]])
    views = [np.array(intervals).reshape(-1, 2) for intervals in (first, second)]
    borders = np.concatenate([view.ravel() for view in views])
    if len(borders) and np.abs(borders - position).min() < 1e-9:
        return
    parts = parts_in_views_mm(
        edge, {str(k): (np.zeros(len(v), dtype=int), v) for k, v in enumerate(views)}, views=2
    )
    shown = all(
        any(min(interval) < position < max(interval) for interval in view) for view in views
    )
    assert shown == any(part[0, 0] < position < part[1, 0] for part in parts)


def test_distances_to_segments():
    segments = np.array([[[0.0, 0, 0], [10.0, 0, 0]], [[0.0, 50, 0], [0.0, 60, 0]]])
    points = np.array([[5.0, 3, 4], [-3.0, 0, 4], [1.0, 55, 0], [13.0, 4, 0]])
    np.testing.assert_allclose(distance_to_segments_mm(points, segments), [5, 5, 1, 5])
    assert np.isinf(distance_to_segments_mm(points, segments[:0])).all()
    samples, weights = sampled_segments(segments, 0.5)
    assert weights.sum() == pytest.approx(20.0)
    np.testing.assert_allclose(distance_to_segments_mm(samples, segments), 0.0, atol=1e-5)
