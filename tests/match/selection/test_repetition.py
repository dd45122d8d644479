"""Matches within a repeating pattern are never sure; other matches do not change."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from trinoc.geometry.camera import Camera
from trinoc.geometry.projection import project_points
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.candidates.table import Candidates, no_candidates
from trinoc.match.evidence.mixture import probability
from trinoc.match.matcher import match_segments
from trinoc.match.selection.messages import conflict_graph, sum_product
from trinoc.match.selection.repetition import (
    NO_REPETITION,
    find_repetition,
    greatest_log_odds,
    limit_log_odds,
)
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.tables import with_field
from trinoc.synth import table1_lens

GREATEST = DEFAULT.repetition.max_log_odds
LINES, SHIFTS = 90, 4
SHIFT = np.tile(np.arange(SHIFTS), LINES)


def shifted(*, ends: bool) -> tuple[Candidates, np.ndarray]:
    """A row of lines with rivals that are one, two and three periods off. Their evidence differs
    only by noise. The row ends, or closes to a ring."""
    line = np.repeat(np.arange(LINES), SHIFTS)
    index = line[:, None] + SHIFT[:, None] * np.arange(3)
    is_shown = (index < LINES).all(axis=1) | (not ends)
    index = index[is_shown] % LINES
    log_odds = np.random.default_rng(5).normal(12.0, 3.0, len(line))[is_shown]
    return at_places(index, np.stack([line, SHIFT, 0 * line], axis=1)[is_shown]), log_odds


def at_places(index: np.ndarray, middle_mm: np.ndarray, frame: np.ndarray | None = None):
    """Candidates of full lines of 2 mm along z at these positions."""
    ends_mm = middle_mm[:, None] + np.array([[0, 0, -1.0], [0, 0, 1.0]])
    interval = np.tile([0.0, 1.0], (len(index), 3, 1))
    return no_candidates(3)._replace(index=index, interval=interval, ends_mm=ends_mm, frame=frame)


def ordinary(offset_mm: float = 0.0, first: int = 0) -> tuple[Candidates, np.ndarray]:
    """Lines whose every second has a rival with little evidence. The rival of every twentieth has
    much evidence and contests two lines."""
    line = np.arange(LINES)
    wrong = line[::2]
    index = np.concatenate(
        [np.stack([line] * 3, 1), np.stack([wrong, wrong, (wrong + 7) % LINES], 1)]
    )
    log_odds = np.concatenate([np.full(LINES, 12.0), np.where(wrong % 20 == 0, 11.0, 1.0)])
    middle = np.concatenate([line, wrong])
    # No two are as far from a third.
    positions_mm = np.stack([middle**1.001 + offset_mm, 0 * middle, 0 * middle], axis=1)
    return at_places(index + first, positions_mm), log_odds


def posteriors(candidates: Candidates, log_odds: np.ndarray, *, limited: bool = True) -> np.ndarray:
    graph = conflict_graph(candidates.index, candidates.interval)
    beside_rivals = sum_product(log_odds, graph).log_odds
    if limited:
        repetition = find_repetition(candidates, log_odds, graph)
        beside_rivals = limit_log_odds(beside_rivals, greatest_log_odds(candidates, repetition))
    return probability(beside_rivals)


def test_of_a_pattern_noise_is_sure_of_nothing() -> None:
    candidates, log_odds = shifted(ends=False)
    unlimited = posteriors(candidates, log_odds, limited=False)
    assert ((unlimited > 0.9) & (SHIFT > 0)).sum() > LINES / 3
    assert posteriors(candidates, log_odds).max() < 0.01 + 1 / (1 + np.exp(-GREATEST))


@given(arrays(float, 20, elements=st.floats(-30, 30)), st.floats(-3, 3), st.floats(0.0, 1.0))
def test_odds_against_both_are_below_each_and_in_the_same_order(log_odds, limit, share) -> None:
    limited = limit_log_odds(log_odds, np.full(20, limit))
    assert (limited <= np.minimum(log_odds, limit)).all()
    order = np.argsort(log_odds)
    assert (np.diff(limited[order]) >= 0).all()
    # Odds w against clutter and against a pattern of share q: w / (1 + q w / m).
    odds, pattern = np.exp(log_odds), share / np.exp(limit)
    if share > 0:
        limited_at_share = limit_log_odds(log_odds, np.full(20, limit - np.log(share)))
        np.testing.assert_allclose(np.exp(limited_at_share), odds / (1 + pattern * odds), rtol=1e-9)


def test_a_candidate_without_rivals_is_no_surer_than_its_pattern() -> None:
    candidates, log_odds = shifted(ends=False)
    lone = at_places(np.full((1, 3), LINES), np.array([[LINES / 2, 0.0, 0.0]]))
    graph = conflict_graph(candidates.index, candidates.interval)
    greatest = greatest_log_odds(lone, find_repetition(candidates, log_odds, graph))
    assert limit_log_odds(np.array([20.0]), greatest)[0] == pytest.approx(GREATEST, abs=0.01)


def test_where_nothing_repeats_nothing_changes() -> None:
    candidates, log_odds = ordinary()
    before = posteriors(candidates, log_odds, limited=False)
    np.testing.assert_allclose(posteriors(candidates, log_odds), before, atol=1e-4)


def test_a_pattern_limits_its_own_place_and_frame_alone() -> None:
    pattern, of_pattern = shifted(ends=True)
    scene, of_scene = ordinary(offset_mm=1000.0, first=LINES)
    index, ends_mm, interval = (
        np.concatenate([getattr(one, name) for one in (pattern, scene)])
        for name in ("index", "ends_mm", "interval")
    )
    log_odds = np.concatenate([of_pattern, of_scene])
    is_pattern = np.arange(len(index)) < len(of_pattern)
    both = no_candidates(3)._replace(index=index, ends_mm=ends_mm, interval=interval)
    graph = conflict_graph(index, interval)
    greatest = greatest_log_odds(both, find_repetition(both, log_odds, graph))
    assert (greatest[is_pattern] < 1).all()
    assert (greatest[~is_pattern] > 10).all()
    # In a stack, though at one place.
    ends_mm[~is_pattern, :, 0] -= 1000
    stack = both._replace(ends_mm=ends_mm, frame=np.where(is_pattern, 0, 1).astype(np.int32))
    greatest_in_stack = greatest_log_odds(stack, find_repetition(stack, log_odds, graph))
    np.testing.assert_allclose(greatest_in_stack, greatest, rtol=1e-12)


def test_nothing_known_limits_nothing() -> None:
    candidates, log_odds = ordinary()
    greatest = greatest_log_odds(candidates, NO_REPETITION)
    np.testing.assert_array_equal(limit_log_odds(log_odds, greatest), log_odds)


def test_matches_of_a_grating_are_not_sure_unless_the_limit_is_taken_off() -> None:
    """Lines perpendicular to the row of cameras. No picture shows their ends or the borders."""
    cameras = {
        name: Camera.from_degrees(
            table1_lens(), pan_deg=pan, tilt_deg=40.0, swing_deg=0.0, distance_mm=distance
        )
        for name, pan, distance in (("a", 0.0, 480.0), ("b", -22.0, 500.0), ("c", 22.0, 500.0))
    }
    random, x = np.random.default_rng(2), np.arange(-200.0, 200.0, 8.0)
    segments = {}
    for name, camera in cameras.items():
        ends_mm = np.stack([np.stack([x, 0 * x + y, 0 * x], axis=1) for y in (-40, 40)], axis=1)
        ends = project_points(camera.pose, camera.intrinsics.lens, ends_mm.reshape(-1, 3)).reshape(
            -1, 2, 2
        )
        ends = ends + random.normal(scale=0.5, size=ends.shape)
        size = np.array(camera.image_size_px)
        segments[name] = Segments.from_endpoints(ends[((ends > 0) & (ends < size)).all((1, 2))])
    rig, unlimited = Rig(cameras), with_field(DEFAULT, "repetition.max_log_odds", np.inf)
    freely, limited = match_segments(segments, rig, tuning=unlimited), match_segments(segments, rig)
    assert (freely.posterior > 0.9).sum() > 10
    assert (limited.posterior > 0.9).sum() == 0
    # Who reads the reasons sees whose probability the pattern lowers, and nobody else's.
    np.testing.assert_array_equal(freely.index, limited.index)
    lowered = limited.posterior < 0.9 * freely.posterior
    assert lowered.sum() > 10
    for view, name in enumerate(limited.views):
        of_pattern = np.unique(limited.index[lowered, view])
        with_reason = np.flatnonzero(limited.reasons[name] == "matched within a pattern")
        np.testing.assert_array_equal(with_reason, of_pattern[of_pattern >= 0])
        assert not (freely.reasons[name] == "matched within a pattern").any()
