"""Companions: neighbours beside or in continuation in every picture, and their log odds."""

import jax
import numpy as np
import pytest

from trinoc.match.candidates.table import Candidates, no_candidates
from trinoc.match.occlusion.companions import (
    BESIDE,
    CONTINUES,
    Companions,
    companion_log_odds,
    find_companions,
    image_neighbours,
)
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.tables import with_field

# A bar of two sides 5 px apart, a piece that goes on from the first, and a stranger.
PICTURE = np.array(
    [[[0.0, 0], [60, 0]], [[2, 5], [50, 5]], [[62, 1], [100, 4]], [[300, 0], [300, 50]]]
)


def neighbours_of(ends_px: np.ndarray, frame: np.ndarray | None = None) -> set[tuple[int, ...]]:
    columns = image_neighbours(ends_px, DEFAULT, frame)
    return set(zip(*(column.tolist() for column in columns), strict=True))


def pairs_of(index: list[tuple[int, int]]) -> Candidates:
    """Pairs of two views that run along their segments."""
    count = len(index)
    empty = jax.tree.map(lambda column: np.zeros((count, *column.shape[1:])), no_candidates(2))
    interval = np.tile([0.0, 1.0], (count, 2, 1))
    return empty._replace(index=np.array(index), interval=interval)


def graph_of(index: list[tuple[int, int]], *pictures: np.ndarray) -> set[tuple[int, ...]]:
    columns = find_companions(pairs_of(index), np.arange(len(index)), np.stack(pictures), DEFAULT)
    return set(zip(*(column.tolist() for column in columns), strict=True))


def test_sides_of_a_bar_and_pieces_that_go_on_are_neighbours() -> None:
    side_by_side = {(0, 1, BESIDE, 1), (1, 0, BESIDE, 0)}
    assert neighbours_of(PICTURE) == side_by_side | {(0, 2, CONTINUES, 1), (2, 0, CONTINUES, 0)}


def test_the_picture_may_be_turned_and_ends_change_places() -> None:
    cosine, sine = np.cos(2.0), np.sin(2.0)
    turned = PICTURE @ np.array([[cosine, sine], [-sine, cosine]]) + [700.0, -300.0]
    assert neighbours_of(turned) == neighbours_of(PICTURE)
    swapped = PICTURE.copy()
    swapped[0] = swapped[0, ::-1]
    expected = {
        (i, j, kind, 1 - side_or_end if i == 0 else side_or_end)
        for i, j, kind, side_or_end in neighbours_of(PICTURE)
    }
    assert neighbours_of(swapped) == expected


def test_segments_of_other_frames_are_no_neighbours() -> None:
    twice = np.concatenate([PICTURE, PICTURE])
    once = neighbours_of(PICTURE)
    in_second_frame = {(i + 4, j + 4, kind, side_or_end) for i, j, kind, side_or_end in once}
    assert neighbours_of(twice, np.repeat([0, 1], 4)) == once | in_second_frame


def test_companions_lie_on_the_same_side_in_every_picture() -> None:
    right = [(0, 0), (1, 1), (2, 2)]
    expected = {(0, 1, BESIDE), (1, 0, BESIDE), (0, 2, CONTINUES), (2, 0, CONTINUES)}
    assert graph_of(right, PICTURE, PICTURE + 20.0) == expected
    # The sides of the bar taken for each other are on the other side in one picture.
    assert not graph_of([(0, 1), (1, 0)], PICTURE, PICTURE)
    # A pair and another with the same segment are no company.
    assert not graph_of([(0, 0), (1, 0)], PICTURE, PICTURE)


def test_a_pair_that_runs_against_its_segment_has_the_same_companions() -> None:
    second = PICTURE[:, ::-1]
    pairs = pairs_of([(0, 0), (1, 1), (2, 2)])
    pairs.interval[:, 1] = [1.0, 0.0]
    companions = find_companions(pairs, np.arange(3), np.stack([PICTURE, second]), DEFAULT)
    expected = find_companions(
        pairs_of([(0, 0), (1, 1), (2, 2)]), np.arange(3), np.stack([PICTURE] * 2), DEFAULT
    )
    for one, other in zip(companions, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def in_pairs(count: int) -> Companions:
    """Companion graph: the first `count` candidates are companions in pairs."""
    site = np.arange(count)
    return Companions(site, site ^ 1, np.full(count, BESIDE))


def test_what_companions_are_worth_is_learned() -> None:
    # 100 likely pairs, of which 50 have company, and 100 unlikely ones that have none.
    posterior = np.repeat([0.99, 0.01], 100)
    gain = companion_log_odds(in_pairs(50), posterior, DEFAULT)
    weight = DEFAULT.evidence.prior_observations
    right = (0.99 * 50 * 0.99 + 0.05 * weight) / (100 + weight)
    wrong = (0.01 * 50 * 0.99 + 0.05 * weight) / (100 + weight)
    assert gain[0] == pytest.approx(
        0.99 * np.log(right / wrong) + 0.01 * np.log((1 - right) / (1 - wrong))
    )
    assert gain[-1] == pytest.approx(np.log((1 - right) / (1 - wrong)))


def test_where_company_is_by_chance_it_says_nothing() -> None:
    posterior = np.random.default_rng(0).uniform(0.05, 0.95, 200)
    assert not companion_log_odds(in_pairs(200), posterior, DEFAULT).any()
    assert not companion_log_odds(in_pairs(0), posterior, DEFAULT).any()


def test_nothing_more_is_added_than_may_be() -> None:
    posterior = np.repeat([0.999, 0.001], 100)
    for max_log_odds in (4.0, 1.0, 0.0):
        tuning = with_field(DEFAULT, "occlusion.max_companion_log_odds", max_log_odds)
        gain = companion_log_odds(in_pairs(100), posterior, tuning)
        assert np.abs(gain).max() == pytest.approx(max_log_odds)


def test_each_frame_learns_for_itself() -> None:
    posterior = np.tile(np.repeat([0.99, 0.01], 50), 2)
    frame = np.repeat([0, 1], 100)
    both = companion_log_odds(in_pairs(40), posterior, DEFAULT, frame, 2)
    alone = companion_log_odds(in_pairs(40), posterior[:100], DEFAULT)
    np.testing.assert_allclose(both[:100], alone)
    assert not both[100:].any()
