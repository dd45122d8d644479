"""More than three views: tracks are consistent as wholes, and lose no view that agrees."""

import numpy as np
import pytest
from scipy.stats import chi2

from tests.match.made import as_set, loose_lines, pictures, rig_of
from tests.match.scene import MadeScene, made_scene
from tests.match.tracks.test_multiview import appended, tracks_from, triples_of
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.consolidation import consolidate_tracks
from trinoc.match.tracks.line_fit import consistent, fit_tracks
from trinoc.match.tracks.multiview import merge_triplets

GATE = 20.0
POSES = {
    f"c{k}": (float(pan), 38.0 + 15.0 * (k % 2), 0.0, 475.0)
    for k, pan in enumerate(range(-60, 61, 20))
}


@pytest.fixture(scope="module")
def scene() -> MadeScene:
    return made_scene("upper", "left", "right", "low", "east", count=12, seed=41, noise_px=0.3)


def test_true_tracks_stay_as_they_are(scene: MadeScene) -> None:
    tracks = merge_triplets(scene.seen.lines, triples_of(scene, list(range(5))))
    kept = consolidate_tracks(scene.seen, tracks)
    assert {tuple(row) for row in kept.candidates.index.tolist()} == {
        tuple(row) for row in scene.true.tolist()
    }


def test_a_member_that_does_not_fit_is_split_off_and_the_right_one_put_in(scene: MadeScene) -> None:
    wrong = scene.true.copy()
    wrong[:, 3] = np.roll(wrong[:, 3], 1)
    tracks = tracks_from(wrong, np.tile([0.0, 1.0], (len(wrong), 5, 1)), scene.lines_mm)
    before = fit_tracks(scene.seen, wrong, scene.lines_mm)
    assert not consistent(before, GATE).any()
    kept = consolidate_tracks(scene.seen, tracks)
    index = kept.candidates.index
    after = fit_tracks(scene.seen, index, kept.candidates.ends_mm)
    assert consistent(after, GATE).all()
    for row in index:
        line = np.argwhere(scene.true[:, 0] == row[0])[0, 0]
        assert set(row) <= {*scene.true[line], -1}


def test_parts_of_one_line_become_one_track(scene: MadeScene) -> None:
    first, second = scene.true.copy(), scene.true.copy()
    first[:, 3:], second[:, :2] = -1, -1
    parts = np.tile([0.0, 1.0], (len(first), 5, 1))
    tracks = appended(
        tracks_from(first, parts, scene.lines_mm), tracks_from(second, parts, scene.lines_mm), 3.0
    )
    kept = consolidate_tracks(scene.seen, tracks)
    assert {tuple(row) for row in kept.candidates.index.tolist()} == {
        tuple(row) for row in scene.true.tolist()
    }


@pytest.mark.slow
def test_seven_views_lose_none_and_misfit_no_more_than_chance() -> None:
    rig, lines = rig_of(**POSES), loose_lines(25, seed=12)
    matches = match_segments(pictures(rig, lines, 0.4, seed=3), rig, sigma_px=0.4)
    whole = {(line,) * 7 for line in range(25)}
    assert len(as_set(matches, tuple(POSES)) & whole) >= 22
    views = (matches.index >= 0).sum(axis=1)
    assert matches.misfit is not None
    seen = views > 2
    assert (chi2.sf(matches.misfit[seen], 2 * (views[seen] - 2)) > 1e-5).all()
