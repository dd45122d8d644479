"""More than three views: every track is consistent and loses no view that agrees."""

import numpy as np
import pytest
from scipy.stats import chi2

from tests.match.made import as_set, loose_lines, pictures, rig_of
from tests.match.scene import MadeScene, made_scene, seen_by
from tests.match.tracks.test_multiview import appended, tracks_from, triples_of
from trinoc.match.matcher import match_segments
from trinoc.match.selection.marginals import Tracks
from trinoc.match.tracks.consolidation import consolidate_tracks
from trinoc.match.tracks.line_fit import are_consistent, fit_tracks
from trinoc.match.tracks.multiview import merge_triplets

VIEWS = ("upper", "left", "right", "low", "east")
POSES = {
    f"c{k}": (float(pan), 38.0 + 15.0 * (k % 2), 0.0, 475.0)
    for k, pan in enumerate(range(-60, 61, 20))
}


@pytest.fixture(scope="module")
def scene() -> MadeScene:
    return made_scene(*VIEWS, count=12, seed=41, noise_px=0.3)


def test_true_tracks_stay_as_they_are(scene: MadeScene) -> None:
    tracks = merge_triplets(scene.inputs.lines, triples_of(scene, list(range(5))))
    consolidated, _ = consolidate_tracks(scene.inputs, tracks)
    assert {tuple(row) for row in consolidated.candidates.index.tolist()} == {
        tuple(row) for row in scene.true.tolist()
    }


def test_a_member_that_does_not_fit_is_split_off_and_the_right_one_put_in(scene: MadeScene) -> None:
    wrong = scene.true.copy()
    wrong[:4, 3] = np.roll(wrong[:4, 3], 1)
    tracks = tracks_from(wrong, np.tile([0.0, 1.0], (len(wrong), 5, 1)), scene.lines_mm)
    before = fit_tracks(scene.inputs, wrong, scene.lines_mm)
    np.testing.assert_array_equal(are_consistent(scene.inputs, before), np.arange(len(wrong)) >= 4)
    consolidated, _ = consolidate_tracks(scene.inputs, tracks)
    index = consolidated.candidates.index
    after = fit_tracks(scene.inputs, index, consolidated.candidates.ends_mm)
    assert are_consistent(scene.inputs, after).all()
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
    consolidated, _ = consolidate_tracks(scene.inputs, tracks)
    assert {tuple(row) for row in consolidated.candidates.index.tolist()} == {
        tuple(row) for row in scene.true.tolist()
    }


def whole_tracks(scene: MadeScene) -> Tracks:
    return tracks_from(scene.true, np.tile([0.0, 1.0], (*scene.true.shape, 1)), scene.lines_mm)


def test_errors_are_as_large_as_most_tracks_say() -> None:
    scene = made_scene(*VIEWS, count=60, seed=8, noise_px=0.3, sigma_px=0.1)
    consolidated, larger = consolidate_tracks(scene.inputs, whole_tracks(scene))
    np.testing.assert_allclose(larger, 3.0, rtol=0.1)
    assert consolidated.candidates.index.shape == scene.true.shape
    assert (consolidated.candidates.index >= 0).all()
    # Less than stated may be chance.
    cautious = made_scene(*VIEWS, count=60, seed=8, noise_px=0.3, sigma_px=1.0)
    assert consolidate_tracks(cautious.inputs, whole_tracks(cautious))[1] == 1.0


@pytest.mark.parametrize("sigma_px", [0.3, 0.1])
def test_unequal_errors_cost_few_views_and_one_line_that_alone_is_off_loses_one(
    sigma_px: float,
) -> None:
    rig, lines_mm, count = rig_of(*VIEWS), loose_lines(80, seed=5), 80
    exact, noisy = pictures(rig, lines_mm), pictures(rig, lines_mm, 0.3, seed=6)
    unequal = np.sqrt(3 / np.random.default_rng(7).chisquare(3, count))
    alone = np.where(np.arange(count) == 9, 5.0, 1.0)
    complete = []
    for factor in (unequal, alone):
        pictures_px = {v: exact[v] + factor[:, None, None] * (noisy[v] - exact[v]) for v in exact}
        scene = seen_by(rig, lines_mm, pictures_px, sigma_px)
        consolidated, _ = consolidate_tracks(scene.inputs, whole_tracks(scene))
        complete.append((consolidated.candidates.index >= 0).all(axis=1).sum())
    assert complete[0] >= 75
    assert complete[1] == count - 1


def test_cameras_that_drift_cost_no_line_and_all_errors_say_so() -> None:
    lines, sigma_px = loose_lines(25, seed=12), 0.1
    # Every three near each other agree.
    tilt_deg = 0.2 * (np.arange(len(POSES)) / 3) ** 2
    drifted = {v: tuple(np.add(POSES[v], [0, tilt_deg[k], 0, 0])) for k, v in enumerate(POSES)}
    pictures_px = pictures(rig_of(**POSES), lines, sigma_px, seed=3)
    matches = match_segments(pictures_px, rig_of(**drifted), sigma_px=sigma_px)
    assert matches.misfit is not None
    assert matches.fragments_covariance_px2 is not None
    is_right = (matches.index == matches.index[:, :1]).all(axis=1)
    assert is_right.sum() >= 24
    degrees = 2 * (len(POSES) - 2)
    np.testing.assert_allclose(np.median(matches.misfit[is_right]), chi2.median(degrees), rtol=0.2)
    # What is stated of fragments are the errors found.
    direction = np.diff(matches.fragments_px[is_right], axis=2)[..., 0, :]
    normal = (
        np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
        / np.linalg.norm(direction, axis=-1)[..., None]
    )
    end_covariance = matches.fragments_covariance_px2[is_right][..., :2, :2]
    across_px = np.sqrt(np.einsum("tvi,tvij,tvj->tv", normal, end_covariance, normal))
    np.testing.assert_allclose(across_px.max(), matches.noise_scale * sigma_px, rtol=0.02)


@pytest.mark.slow
def test_seven_views_lose_none_and_misfit_no_more_than_chance() -> None:
    rig, lines = rig_of(**POSES), loose_lines(25, seed=12)
    matches = match_segments(pictures(rig, lines, 0.4, seed=3), rig, sigma_px=0.4)
    true_tracks = {(line,) * 7 for line in range(25)}
    assert len(as_set(matches, tuple(POSES)) & true_tracks) >= 22
    views = (matches.index >= 0).sum(axis=1)
    assert matches.misfit is not None
    has_misfit = views > 2
    assert (chi2.sf(matches.misfit[has_misfit], 2 * (views[has_misfit] - 2)) > 1e-5).all()
