"""Levels beside segments: their measurement and the evidence that follows from them."""

import dataclasses

import numpy as np
import pytest

from tests.match.made import as_set, loose_lines, pictures, rig_of
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.evidence.mixture import temper
from trinoc.match.evidence.side_intensity import SIDE_COMPONENTS, side_evidence
from trinoc.match.matcher import match_segments
from trinoc.match.observations.side_intensity import side_table
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.segments import with_side_levels
from trinoc.segments.side_intensity import side_levels

VIEWS = ("upper", "left", "right")
FORWARD, BACKWARD = [0.0, 1.0], [1.0, 0.0]


def tables_of(levels: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Segment tables of three views that show the same."""
    return np.stack(side_table([levels] * 3, [np.full(len(levels), np.nan)] * 3, [middles] * 3))


def of_contrasts(seed: int) -> np.ndarray:
    """The same tables for segments with a contrast and without levels."""
    rng = np.random.default_rng(seed)
    contrast, middles = rng.uniform(5, 200, 40), rng.uniform(0, 400, (40, 2))
    return np.stack(side_table([np.full((40, 2), np.nan)] * 3, [contrast] * 3, [middles] * 3))


def with_levels(ends: np.ndarray, levels: np.ndarray) -> Segments:
    return dataclasses.replace(Segments.from_endpoints(ends), side_levels=levels)


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    """Levels of 40 segments, equal in all three views."""
    rng = np.random.default_rng(0)
    levels, middles = rng.uniform(20, 230, (40, 2)), rng.uniform(0, 400, (40, 2))
    return tables_of(levels, middles)


def test_levels_are_those_of_the_right_and_of_the_left() -> None:
    grey = np.where(np.arange(64) < 30, 40.0, 160.0) * np.ones((48, 1))
    # Up the picture the dark side is on the left; down, on the right.
    ends = np.array([[[29.5, 40.0], [29.5, 8.0]], [[29.5, 8.0], [29.5, 40.0]]])
    np.testing.assert_array_equal(side_levels(grey, ends), [[160.0, 40.0], [40.0, 160.0]])
    segments = with_side_levels(Segments.from_endpoints(ends), grey)
    np.testing.assert_array_equal(segments.side_levels, side_levels(grey, ends))
    np.testing.assert_array_equal(segments.endpoints_px, ends)
    assert side_levels(grey, np.zeros((0, 2, 2))).shape == (0, 2)


def test_which_end_comes_first_means_nothing(table: np.ndarray) -> None:
    index = np.array([[4, 4, 4], [4, 7, 4], [4, -1, 4]])
    part = np.tile(np.array(FORWARD), (3, 3, 1))
    turned, against = table.copy(), part.copy()
    turned[1, :, :] = turned[1][:, [1, 0, 3, 2, 4, 5, 6]]
    against[:, 1] = BACKWARD
    expected = side_evidence(table, index, part)
    np.testing.assert_allclose(side_evidence(turned, index, against), expected, atol=1e-12)
    # Nor does the way along the line itself.
    np.testing.assert_allclose(side_evidence(table, index, part[..., ::-1]), expected, atol=1e-12)


def test_equal_levels_speak_for_one_line_and_unknown_ones_say_nothing(table: np.ndarray) -> None:
    part = np.tile(np.array(FORWARD), (40, 3, 1))
    same = np.repeat(np.arange(40)[:, None], 3, axis=1)
    other = same.copy()
    other[:, 1] = np.roll(other[:, 1], 1)
    alike = [one < 3 and two < 3 for one, two in SIDE_COMPONENTS]
    for_same = side_evidence(table, same, part)[:, alike].max(axis=1)
    for_other = side_evidence(table, other, part)[:, alike].max(axis=1)
    assert (for_same > 3).all()
    assert (for_other < 0).mean() > 0.8
    unknown = np.full_like(table, np.nan)
    assert not side_evidence(unknown, same, part).any()
    unknown[0] = table[0]
    assert not side_evidence(unknown, same, part).any()


def test_usual_levels_are_weaker_evidence_than_rare_ones() -> None:
    rng = np.random.default_rng(1)
    levels = rng.uniform(0, 255, (60, 2))
    levels[:40] = [50.0, 200.0]
    table = tables_of(levels, rng.uniform(0, 400, (60, 2)))[0]
    assert table[:40, 4].min() > table[40:, 4].max()


def test_levels_that_are_the_same_everywhere_speak_for_nothing() -> None:
    rng = np.random.default_rng(2)
    levels = np.tile([60.0, 180.0], (40, 1))
    table = tables_of(levels, rng.uniform(0, 400, (40, 2)))
    index = rng.integers(0, 40, (20, 3))
    evidence = side_evidence(table, index, np.tile(np.array(FORWARD), (20, 3, 1)))
    assert (np.log(np.exp(evidence) @ np.array(DEFAULT.sides.prior_shares)) < 0.3).all()


def test_equal_contrasts_speak_for_one_line_and_less_than_levels_do(table: np.ndarray) -> None:
    part = np.tile(np.array(FORWARD), (40, 3, 1))
    same = np.repeat(np.arange(40)[:, None], 3, axis=1)
    other = same.copy()
    other[:, 1] = np.roll(other[:, 1], 1)
    alike = [one < 3 and two < 3 for one, two in SIDE_COMPONENTS]
    contrasts = of_contrasts(0)
    for_same, for_other = (
        side_evidence(contrasts, index, part)[:, alike].max(axis=1) for index in (same, other)
    )
    assert (for_same > 1).all()
    assert (for_other < 0).mean() > 0.5
    assert for_other.mean() < for_same.mean() - 3
    # A step says nothing where one side is not that of the line, and is one number, not two.
    assert not side_evidence(contrasts, same, part)[:, ~np.array(alike)].any()
    assert for_same.mean() < side_evidence(table, same, part)[:, alike].max(axis=1).mean()
    contrasts[1:] = np.nan
    assert not side_evidence(contrasts, same, part).any()


def test_a_ratio_of_contrasts_is_one_on_average_over_strangers() -> None:
    # Under clutter, two views' steps are even between 0 and 110: the density of both is known.
    table = np.full((2, 4001, 7), np.nan)
    steps = np.linspace(0, 110, 4001)
    table[:, :, 5], table[:, :, 6] = steps, -np.log(110)
    index = np.stack([np.full(4001, 2000), np.arange(4001)], axis=1)
    ratio = np.exp(side_evidence(table, index, np.tile(np.array(FORWARD), (4001, 2, 1))))
    np.testing.assert_allclose(ratio.mean(axis=0), 1.0, rtol=1e-3)


def test_a_contrast_counts_where_levels_are_not_known_whatever_its_unit() -> None:
    rng = np.random.default_rng(4)
    levels, contrast = rng.uniform(20, 230, (40, 2)), rng.uniform(5, 200, 40)
    levels[10:] = np.nan
    middles = [rng.uniform(0, 400, (40, 2))]
    table = side_table([levels], [contrast], middles)[0]
    assert np.isnan(table[:10, 5:]).all()
    assert np.isfinite(table[10:, 5:]).all()
    scaled = side_table([levels / 255], [-contrast / 255], middles)[0]
    np.testing.assert_allclose(scaled, table, atol=1e-9)


def of_twins(gain: float = 1.0) -> tuple[Rig, dict[str, Segments]]:
    """Loose lines, each seen twice: only the levels tell the two copies from each other."""
    rig, lines = rig_of(*VIEWS), loose_lines(20, seed=1)
    rng = np.random.default_rng(3)
    levels = rng.uniform(20, 230, (40, 2))
    pictures_px = pictures(rig, np.concatenate([lines, lines]), sigma_px=0.3, seed=2)
    return rig, {
        name: with_levels(ends, gain * (levels + rng.normal(0, 1.0, levels.shape)))
        for name, ends in pictures_px.items()
    }


def test_levels_tell_lines_apart_whose_geometry_does_not() -> None:
    rig, segments = of_twins()
    true = {(k, k, k) for k in range(40)}
    plain = {n: dataclasses.replace(s, side_levels=None) for n, s in segments.items()}
    blind = as_set(match_segments(plain, rig), VIEWS)
    tracks = as_set(match_segments(segments, rig), VIEWS)
    assert len(tracks & true) > len(blind & true) + 10
    assert len(tracks & true) > 0.95 * len(tracks)
    assert len(tracks & true) > 35


def test_order_and_unit_of_levels_change_nothing() -> None:
    rig, segments = of_twins()
    matches = match_segments(segments, rig)
    turned = {
        name: dataclasses.replace(
            s,
            endpoints_px=np.asarray(s.endpoints_px)[:, ::-1],
            side_levels=np.asarray(s.side_levels)[:, ::-1],
        )
        for name, s in reversed(segments.items())
    }
    turned_matches = match_segments(turned, rig)
    assert as_set(turned_matches, VIEWS) == as_set(matches, VIEWS)
    _, scaled = of_twins(gain=1 / 255)
    assert as_set(match_segments(scaled, rig), VIEWS) == as_set(matches, VIEWS)


def test_only_odds_of_segments_of_pictures_are_tempered() -> None:
    posterior_log_odds = np.array([-4.0, 8.0, 8.0])
    side_log = np.zeros((3, len(SIDE_COMPONENTS)))
    np.testing.assert_array_equal(temper(posterior_log_odds, side_log), posterior_log_odds)
    side_log[2, 0] = 1.0
    np.testing.assert_array_equal(temper(posterior_log_odds, side_log)[:2], posterior_log_odds[:2])
    assert 0 < temper(posterior_log_odds, side_log)[2] < posterior_log_odds[2]
