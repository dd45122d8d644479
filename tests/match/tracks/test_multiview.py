"""Triples of several view triplets become one track through all views, whatever their order."""

from itertools import combinations

import jax
import numpy as np
import pytest

from tests.match.scene import MadeScene, image_px, made_scene, place_on
from trinoc.match.candidates.table import no_candidates
from trinoc.match.observations.table import SegmentTable
from trinoc.match.selection.marginals import Tracks
from trinoc.match.tracks.multiview import merge_triplets, view_triplets
from trinoc.numerics.tables import concatenate_rows

LINES = 12


@pytest.fixture(scope="module")
def scene() -> MadeScene:
    return made_scene("upper", "left", "right", "low", "east", count=LINES, seed=41)


def of_views(lines: SegmentTable, views: list[int]) -> SegmentTable:
    """Tables of some of the views, in this order."""
    return jax.tree.map(lambda table: np.asarray(table)[views], lines)


def triples_of(scene: MadeScene, views: list[int]) -> Tracks:
    """Triples of every line in every three of the views, with different posteriors."""
    index, interval, ends = [], [], []
    for three in combinations(range(len(views)), 3):
        rows = np.full((LINES, len(views)), -1)
        parts = np.zeros((LINES, len(views), 2))
        for v in three:
            rows[:, v] = scene.true[:, views[v]]
            shown = scene.table.ends_px[views[v], rows[:, v]]
            parts[:, v] = place_on(shown, image_px(scene.table.matrix_px[views[v]], scene.lines_mm))
        index.append(rows)
        interval.append(parts)
        ends.append(scene.lines_mm)
    return tracks_from(np.concatenate(index), np.concatenate(interval), np.concatenate(ends))


def tracks_from(index: np.ndarray, interval: np.ndarray, ends_mm: np.ndarray) -> Tracks:
    count = len(index)
    empty = no_candidates(index.shape[1])
    candidates = jax.tree.map(lambda field: np.zeros((count, *field.shape[1:])), empty)
    candidates = candidates._replace(index=index, interval=interval, ends_mm=ends_mm)
    odds = np.random.default_rng(count).uniform(1, 9, count)
    return Tracks(candidates, odds, np.full(count, -np.inf))


def appended(tracks: Tracks, others: Tracks, odds: float) -> Tracks:
    candidates = concatenate_rows([tracks[0], others[0]])
    posterior = np.append(tracks.posterior_log_odds, np.full(len(others[1]), odds))
    return Tracks(candidates, posterior, np.full(len(posterior), -np.inf))


def as_set(tracks: Tracks) -> set[tuple[int, ...]]:
    assert len({tuple(row) for row in tracks.candidates.index}) == len(tracks.candidates.index)
    return {tuple(row) for row in tracks.candidates.index.tolist()}


@pytest.mark.parametrize("views", [[0, 1, 2, 3], [0, 1, 2, 3, 4], [4, 2, 0, 3, 1]])
def test_all_triples_of_a_line_become_one_track(scene: MadeScene, views: list[int]) -> None:
    merged = merge_triplets(of_views(scene.inputs.lines, views), triples_of(scene, views))
    assert as_set(merged) == {tuple(row) for row in scene.true[:, views].tolist()}
    order = np.argsort(merged.candidates.index[:, 0])
    line = np.argsort(scene.true[:, views[0]])
    np.testing.assert_allclose(merged.candidates.ends_mm[order], scene.lines_mm[line], atol=1e-6)
    part = np.sort(merged.candidates.interval, axis=2)
    np.testing.assert_allclose(part, np.broadcast_to([0.0, 1.0], part.shape), atol=1e-8)


def test_a_track_keeps_the_posterior_of_its_best_triple(scene: MadeScene) -> None:
    tracks = triples_of(scene, list(range(5)))
    merged = merge_triplets(scene.inputs.lines, tracks)
    for row, odds in zip(merged.candidates.index, merged.posterior_log_odds, strict=True):
        agree = (tracks.candidates.index == row) | (tracks.candidates.index < 0)
        assert odds == tracks.posterior_log_odds[agree.all(axis=1)].max()


def test_the_order_of_triples_changes_nothing(scene: MadeScene) -> None:
    tracks = triples_of(scene, list(range(5)))
    turn = np.random.default_rng(1).permutation(len(tracks.posterior_log_odds))
    turned = Tracks(tracks[0].take(turn), tracks[1][turn], tracks[2][turn])
    one, other = (merge_triplets(scene.inputs.lines, ordered) for ordered in (tracks, turned))
    np.testing.assert_array_equal(one.candidates.index, other.candidates.index)
    np.testing.assert_array_equal(one.candidates.ends_mm, other.candidates.ends_mm)


def test_a_less_likely_triple_that_contradicts_is_dropped(scene: MadeScene) -> None:
    tracks = triples_of(scene, list(range(5)))
    wrong = scene.true[:4].copy()
    wrong[:, 2] = np.roll(wrong[:, 2], 1)
    wrong[:, 3:] = -1
    parts = np.tile([0.0, 1.0], (4, 5, 1))
    others = tracks_from(wrong, parts, scene.lines_mm[:4])
    merged = merge_triplets(scene.inputs.lines, appended(tracks, others, odds=0.5))
    assert as_set(merged) == {tuple(row) for row in scene.true.tolist()}


@pytest.mark.parametrize("tied_both_ways", [True, False])
def test_tracks_of_other_views_are_one_where_triples_tie_them_both_ways(
    scene: MadeScene, tied_both_ways: bool
) -> None:
    # Six views, of which the last is the first once more.
    views, threes = [0, 1, 2, 3, 4, 0], [(0, 1, 2), (3, 4, 5), (0, 1, 3), (0, 3, 4)]
    triples = triples_of(scene, views)
    line = (triples.candidates.index == scene.true[0, views]) | (triples.candidates.index < 0)
    rows = [
        np.flatnonzero(line.all(axis=1) & (triples.candidates.index[:, three] >= 0).all(axis=1))[0]
        for three in (threes if tied_both_ways else threes[:3])
    ]
    candidates = triples.candidates.take(np.array(rows))
    # The two tracks first, and then what ties them.
    tracks = Tracks(candidates, -np.arange(len(rows), dtype=float), triples.rival_posterior[rows])
    merged = as_set(merge_triplets(of_views(scene.inputs.lines, views), tracks))
    full_track = tuple(scene.true[0, views].tolist())
    two_tracks = {full_track[:3] + (-1,) * 3, (-1,) * 3 + full_track[3:]}
    assert merged == ({full_track} if tied_both_ways else two_tracks)


def test_every_view_is_matched_in_some_three() -> None:
    centre = np.random.default_rng(2).normal(size=(9, 3))
    for views in (3, 4, 5, 9):
        lines = made_scene("upper", "left", "right", count=LINES, seed=41).table
        lines = lines._replace(centre_mm=centre[:views], size_px=np.ones((views, 2)))
        threes = view_triplets(lines)
        assert threes == sorted(set(threes))
        assert {v for three in threes for v in three} == set(range(views))
        assert all(a < b < c for a, b, c in threes)
        if views <= 5:
            assert len(threes) == len(list(combinations(range(views), 3)))
