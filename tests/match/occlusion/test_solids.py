"""Edges of solids are confused with each other: the tempered odds are calibrated."""

import numpy as np
import pytest

from simulation import Detector, block_scene, simulate_segments
from trinoc.match.candidates.table import no_candidates
from trinoc.match.evidence.side_intensity import SIDE_COMPONENTS
from trinoc.match.matcher import match_segments
from trinoc.match.occlusion.solids import NO_BODIES, Bodies, temper_pairs, temper_tracks
from trinoc.match.selection.marginals import Tracks
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.synth import table1_rig

ODDS = np.array([-3.0, 0.0, 2.0, 9.0, 30.0])
UNKNOWN = np.zeros((len(ODDS), len(SIDE_COMPONENTS)))
KNOWN = UNKNOWN + 0.5


def of_tracks(lines, bodies: Bodies, sides: np.ndarray = UNKNOWN) -> np.ndarray:
    candidates = no_candidates(3)._replace(index=np.zeros((len(ODDS), 3), int), side_log=sides)
    tracks = temper_tracks(lines, Tracks(candidates, ODDS, ODDS - 1), bodies, DEFAULT)
    np.testing.assert_allclose(np.diff(tracks.posterior_log_odds), np.diff(tracks.rival_posterior))
    return tracks.posterior_log_odds


def of_pairs(sine: float, bodies: Bodies, sides: np.ndarray) -> np.ndarray:
    return temper_pairs(ODDS, sides, np.full(len(ODDS), sine), bodies, DEFAULT)


def test_lines_that_meet_nowhere_keep_their_odds(noisy) -> None:
    np.testing.assert_array_equal(of_tracks(noisy.inputs.lines, NO_BODIES), ODDS)
    np.testing.assert_array_equal(of_pairs(0.7, NO_BODIES, UNKNOWN), ODDS)


@pytest.mark.parametrize("through", [0.0, 0.8])
def test_odds_of_tracks_keep_order_and_sign_and_shrink_as_more_ends_meet(noisy, through) -> None:
    before = ODDS
    for joined in (0.3, 0.6, 1.0):
        tempered = of_tracks(noisy.inputs.lines, Bodies(joined, through))
        assert (np.diff(tempered) > 0).all()
        assert (np.sign(tempered) == np.sign(ODDS)).all()
        assert (np.abs(tempered) < np.abs(before))[ODDS != 0].all()
        before = tempered


def test_where_all_ends_meet_and_nothing_is_seen_through_odds_have_their_temperature(noisy) -> None:
    solid, rules = Bodies(1.0, 0.0), DEFAULT.occlusion
    tracks = of_tracks(noisy.inputs.lines, solid)
    np.testing.assert_allclose(tracks, rules.solid_temperature * ODDS)
    # What the turn takes off is the same for all.
    pairs = of_pairs(0.4, solid, UNKNOWN)
    np.testing.assert_allclose(np.diff(pairs), rules.solid_temperature * np.diff(ODDS))


def test_pairs_of_solids_are_less_likely_as_the_viewpoint_turns_unless_levels_are_known() -> None:
    by_sine = np.array([of_pairs(sine, Bodies(0.8, 0.0), UNKNOWN) for sine in (0.1, 0.5, 0.9)])
    assert (np.diff(by_sine, axis=0) < 0).all()
    in_pictures = of_pairs(0.1, Bodies(0.8, 0.0), KNOWN)
    np.testing.assert_array_equal(in_pictures, of_pairs(0.9, Bodies(0.2, 0.9), KNOWN))
    np.testing.assert_allclose(in_pictures, DEFAULT.evidence.temperature * ODDS)


def test_posteriors_of_blocks_come_true() -> None:
    stated, right = [], []
    for seed in range(3):
        scene = block_scene(seed, count=8)
        segments, truth = simulate_segments(scene, table1_rig(), Detector(), seed=seed)
        matches = match_segments(segments, table1_rig())
        for row, posterior in zip(matches.index, matches.posterior, strict=True):
            views = np.flatnonzero(row >= 0)
            edges = {int(truth.edge_of[matches.views[v]][row[v]]) for v in views}
            if edges != {-2}:
                stated.append(posterior)
                right.append(len(edges) == 1 and min(edges) >= 0)
    p = np.array(stated)
    # Three standard deviations, and as much again, since wrong matches of one body come together.
    assert abs(np.sum(right) - p.sum()) < 6 * np.sqrt((p * (1 - p)).sum())
