"""Pairs of unmatched segments never use matched parts, whatever the order of the tracks."""

import jax
import numpy as np
import pytest

from tests.match.made import pictures
from tests.match.scene import MadeScene
from trinoc.match.candidates.table import Candidates, no_candidates
from trinoc.match.candidates.triples import trinocular_candidates
from trinoc.match.observations.clutter import ClutterModel, fit_clutter
from trinoc.match.observations.match_input import prepare
from trinoc.match.occlusion.pairs import occluded_pairs
from trinoc.match.occlusion.possible_pairs import (
    Pairs,
    end_shares,
    log_odds_among_lines,
    pair_bound,
    possible_pairs,
)
from trinoc.match.selection.marginals import Selection, Tracks, select, selected_tracks
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.tables import with_field

HIDDEN = 5


def pairs_beside(
    scene: MadeScene, clutter: ClutterModel, tracks: Tracks, selections: list[Selection], **options
) -> Pairs:
    depth_range_mm = options.get("depth_range_mm")
    inputs = scene.inputs
    return occluded_pairs(inputs.lines, inputs.counts, clutter, tracks, selections, depth_range_mm)


def rows(tracks: Tracks, keep: np.ndarray) -> Tracks:
    candidates = tracks.candidates.take(keep)
    return Tracks(candidates, tracks.posterior_log_odds[keep], tracks.rival_posterior[keep])


@pytest.fixture(scope="module")
def selection(triples: Candidates) -> Selection:
    return select(triples, 30.0)


@pytest.fixture(scope="module")
def tracks(selection: Selection) -> Tracks:
    """All tracks but the first few, whose segments are free for pairs."""
    every = selected_tracks(selection)
    return rows(every, np.arange(HIDDEN, len(every.posterior_log_odds)))


@pytest.fixture(scope="module")
def pairs(noisy, clutter, tracks, selection) -> Pairs:
    return pairs_beside(noisy, clutter, tracks, [selection])


def test_pairs_have_two_segments_that_are_not_matched(tracks: Tracks, pairs: Pairs) -> None:
    assert len(pairs.is_accepted) > 0
    assert ((pairs.candidates.index >= 0).sum(axis=1) == 2).all()
    is_mostly_used = np.abs(np.diff(tracks.candidates.interval, axis=2))[..., 0] > 0.5
    for view in range(3):
        matched = tracks.candidates.index[is_mostly_used[:, view], view]
        assert not np.isin(pairs.candidates.index[:, view], matched).any()


def test_pairs_that_are_taken_share_no_segment(pairs: Pairs) -> None:
    assert (pairs.posterior_log_odds[pairs.is_accepted] > 0).all()
    for view in range(3):
        used = pairs.candidates.index[pairs.is_accepted, view]
        used = used[used >= 0]
        part = np.sort(pairs.candidates.interval[pairs.is_accepted, view], axis=1)
        part = part[pairs.candidates.index[pairs.is_accepted, view] >= 0]
        for m, n in zip(*np.triu_indices(len(used), 1), strict=True):
            if used[m] == used[n]:
                shared = part[[m, n], 1].min() - part[[m, n], 0].max()
                assert shared <= 0.3 * np.ptp(part[[m, n]], axis=1).min()


def test_the_order_of_tracks_changes_nothing(noisy, clutter, tracks, selection, pairs) -> None:
    turn = np.random.default_rng(0).permutation(len(tracks.posterior_log_odds))
    reordered = pairs_beside(noisy, clutter, rows(tracks, turn), [selection])
    np.testing.assert_array_equal(reordered.candidates.index, pairs.candidates.index)
    np.testing.assert_allclose(reordered.posterior_log_odds, pairs.posterior_log_odds, atol=1e-9)


def test_where_all_is_matched_there_are_no_pairs(noisy, clutter, tracks, selection) -> None:
    empty = no_candidates(3)
    count = len(noisy.true)
    matched = jax.tree.map(lambda field: np.zeros((count, *field.shape[1:])), empty)._replace(
        index=noisy.true,
        interval=np.tile([0.0, 1.0], (count, 3, 1)),
        union_ends_mm=noisy.lines_mm,
        union_covariance_mm2=np.tile([1.0, 0, 0, 1, 0, 1], (count, 2, 1)),
        px_per_mm=np.full(count, 2.5),
    )
    all_tracks = Tracks(matched, np.full(count, 5.0), np.full(count, -np.inf))
    assert len(pairs_beside(noisy, clutter, all_tracks, [selection]).is_accepted) == 0


def test_depths_bound_pairs_too(noisy, clutter, tracks, selection) -> None:
    nearby_pairs = pairs_beside(noisy, clutter, tracks, [selection], depth_range_mm=(10.0, 20.0))
    assert len(nearby_pairs.is_accepted) == 0


def test_what_no_other_picture_could_show_costs_nothing(pairs: Pairs) -> None:
    assert (pairs.miss_log_odds <= 0).all()


def test_hidden_lines_that_meet_matched_ones_are_paired(exact: MadeScene) -> None:
    # Five rods start at the ends of lines, and the first of the pictures does not show them.
    rng = np.random.default_rng(4)
    foot = exact.lines_mm[:5, 0]
    rods = np.stack([foot, foot + rng.uniform(-15, 15, (5, 3)) + [0, 0, 12]], axis=1)
    shown = pictures(exact.rig, np.concatenate([exact.lines_mm, rods]), sigma_px=0.1, seed=8)
    shown["upper"] = shown["upper"][:-5]
    inputs = prepare(shown, exact.rig, 0.1)
    clutter = fit_clutter(inputs.lines, inputs.counts)
    candidates = trinocular_candidates(inputs.lines, (0, 1, 2), inputs.counts, clutter)
    selection = select(candidates, 33.0)
    hidden_pairs = occluded_pairs(
        inputs.lines, inputs.counts, clutter, selected_tracks(selection), [selection], None
    )
    index = hidden_pairs.candidates.index[hidden_pairs.is_accepted]
    # By the numbers of the lines, in the order of the rig.
    named = np.stack(
        [
            np.where(index[:, v] < 0, -1, inputs.order[v][index[:, v]])
            for v in (inputs.names.index(name) for name in exact.rig.names)
        ],
        axis=1,
    )
    paired = {tuple(row) for row in named.tolist()}
    assert len(paired & {(-1, rod, rod) for rod in range(30, 35)}) >= 4


def test_pairs_that_are_let_go_unseen_change_nothing(noisy, clutter, tracks, selection) -> None:
    inputs, tuning = noisy.inputs, with_field(DEFAULT, "scouting.min_segments", 0)
    tuning = with_field(tuning, "scouting.max_ends_share", 0.0)
    args = inputs.lines, inputs.counts, clutter, tracks, [selection], None
    one, other = occluded_pairs(*args), occluded_pairs(*args, tuning)
    for every, bounded in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(every, bounded)
    views = np.array([0, 1])
    free = [np.arange(count) for count in inputs.counts]
    shares = end_shares(selection.mixture, DEFAULT.ends)
    bound = pair_bound(inputs.lines, selection.mixture, shares, DEFAULT)
    assert bound is not None
    (all_pairs,) = possible_pairs(inputs.lines, views, free, clutter, DEFAULT)
    (bounded_pairs,) = possible_pairs(inputs.lines, views, free, clutter, DEFAULT, bound)
    odds = log_odds_among_lines(all_pairs, selection.mixture, DEFAULT)
    likely = {tuple(row) for row in all_pairs.index[odds > bound.min_log_odds].tolist()}
    pairs_within_bound = {tuple(row) for row in bounded_pairs.index.tolist()}
    assert likely <= pairs_within_bound
    assert len(pairs_within_bound) <= len(likely) + 1
    assert len(likely) < len(odds) / 2


def test_pairs_of_which_an_end_agrees_are_few_and_hold_partners(noisy, clutter) -> None:
    inputs, views = noisy.inputs, np.array([0, 1])
    free = [np.arange(count) for count in inputs.counts]

    def pairs(ends_px: float | None) -> list[tuple[int, ...]]:
        parts = possible_pairs(inputs.lines, views, free, clutter, DEFAULT, None, ends_px)
        return [tuple(row) for part in parts for row in part.index[:, :2].tolist()]

    all_pairs, agreeing = pairs(None), pairs(2.0)
    assert len(set(agreeing)) == len(agreeing) < len(all_pairs) / 2
    assert set(agreeing) <= set(all_pairs)
    partners = {tuple(row) for row in noisy.true[:, :2].tolist()} & set(all_pairs)
    assert len(partners & set(agreeing)) > 0.95 * len(partners) > 10
