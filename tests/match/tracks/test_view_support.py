"""Tracks of many views: evidence from shown segments, missing segments and their fit."""

import numpy as np
import pytest

from tests.match.made import loose_lines, pictures, rig_of
from tests.match.scene import MadeScene, made_scene, seen_by
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.line_fit import are_consistent, fit_tracks
from trinoc.match.tracks.unequal_errors import student_log_density
from trinoc.match.tracks.view_support import (
    HitRates,
    chance_rates,
    lines_in_images,
    member_posteriors,
    misfit_evidence,
    right_rates,
    view_evidence,
)
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.tracks import ViewSupportTuning

VIEWS = ("upper", "left", "right", "low", "east")
RULES = ViewSupportTuning(prior_lines=1e-9)
GATE = DEFAULT.candidates.gate


@pytest.fixture(scope="module")
def scene() -> MadeScene:
    return made_scene(*VIEWS, count=40, seed=41, noise_px=0.3)


def test_views_beyond_three_are_a_likelihood_ratio() -> None:
    """The ratio of each view that shows a line, and of each that should but does not, by hand."""
    index = np.array([[0, 0, 0, -1, -1], [1, 1, 1, 1, -1], [2, 2, 2, 2, 2]])
    shown = np.array([[True] * 5, [True] * 5, [True] * 5])
    shown[0, 4] = False
    rates = HitRates(np.full((5, 5), 0.8), np.full(5, 0.1))
    met, missed = np.log(0.8 / 0.1), np.log(0.2 / 0.9)
    expected = [missed, met + missed, 2 * met]
    np.testing.assert_allclose(view_evidence(index, shown, rates, RULES), expected)


def test_the_rate_of_right_lines_leaves_out_the_views_that_found_them() -> None:
    """Each view shows 1,000 lines with its own probability; lines in three views are tracks. The
    estimated rates still equal these probabilities."""
    rate = np.array([0.95, 0.9, 0.7, 0.5, 0.8])
    member = np.random.default_rng(1).uniform(size=(20_000, 5)) < rate
    member = member[member.sum(axis=1) >= 3]
    index = np.where(member, 0, -1)
    right = right_rates(index, np.ones_like(member), np.ones(len(index)), RULES)
    off_diagonal = ~np.eye(5, dtype=bool)
    expected = np.broadcast_to(rate[:, None], (5, 5))
    np.testing.assert_allclose(right[off_diagonal], expected[off_diagonal], atol=0.03)


def test_the_rate_of_chance_grows_with_clutter(scene: MadeScene) -> None:
    rig = rig_of(*VIEWS)
    rates = []
    for strays in (0, 400):
        pictures_px = pictures(rig, scene.lines_mm, 0.3, seed=3)
        random = np.random.default_rng(2)
        for name, ends in pictures_px.items():
            middle = random.uniform(20, 450, (strays, 1, 2))
            half = random.uniform(-20, 20, (strays, 1, 2))
            more = np.concatenate([middle - half, middle + half], axis=1).reshape(strays, 4)
            pictures_px[name] = np.concatenate([ends.reshape(-1, 4), more])
        scene_with_strays = seen_by(rig, scene.lines_mm, pictures_px, 0.3)
        tracks = fit_tracks(
            scene_with_strays.inputs, scene_with_strays.true[: len(scene.lines_mm)], scene.lines_mm
        )
        rates.append(chance_rates(scene_with_strays.inputs, tracks, GATE, DEFAULT).mean())
    # 40 lines and 440: each passes by chance as often, but strays are shorter.
    assert 1.5 * rates[0] < rates[1] < 11 * rates[0] < 0.5


def test_a_line_lies_in_the_pictures_whose_cameras_look_at_it(scene: MadeScene) -> None:
    inside = lines_in_images(scene.inputs.lines, scene.lines_mm)
    assert inside.all()
    behind = scene.lines_mm + 1e4 * np.asarray(scene.inputs.lines.centre_mm).mean(axis=0)
    assert not lines_in_images(scene.inputs.lines, behind).any()


def test_segments_that_fit_as_chance_has_it_count_against_a_track() -> None:
    """Three views add nothing; the density of a good fit is above that of chance."""
    index = np.array([[0, 0, 0, -1], [0, 0, 0, 0], [0, 0, 0, 0]])
    evidence = misfit_evidence(index, np.array([9.0, 1.0, 36.0]), GATE, 0.0)
    assert evidence[0] == 0.0
    assert evidence[1] > 0.0 > evidence[2]
    expected = student_log_density(np.array([18.0]), 0.0)[0] + np.log(GATE)
    np.testing.assert_allclose(evidence[2], expected)


def test_the_density_of_a_misfit_is_one_in_all_and_that_of_chi_square_without_a_tail() -> None:
    misfit = np.linspace(0, 400, 400_001)
    np.testing.assert_allclose(
        student_log_density(misfit[:100], 0.0), -np.log(2) - misfit[:100] / 2, atol=1e-3
    )
    for tail in (0.0, 0.1, 0.2):
        assert abs(np.trapezoid(np.exp(student_log_density(misfit, tail)), misfit) - 1) < 2e-3


def test_a_foreign_segment_is_told_from_those_of_the_line(scene: MadeScene) -> None:
    wrong = scene.true.copy()
    wrong[:4, 3] = np.roll(wrong[:4, 3], 1)
    tracks = fit_tracks(scene.inputs, wrong, scene.lines_mm)
    rates = HitRates(np.full((5, 5), 0.9), np.full(5, 0.1))
    posterior = member_posteriors(scene.inputs, tracks, rates, GATE, 0.0, ViewSupportTuning())
    assert (posterior[:4, 3] < 0.01).all()
    assert (posterior[4:] > 0.9).mean() > 0.98
    # Of three views none can be told from the others.
    three = np.where(np.arange(5) < 3, scene.true, -1)
    alone = member_posteriors(
        scene.inputs, fit_tracks(scene.inputs, three, scene.lines_mm), rates, GATE, 0.0, RULES
    )
    assert np.isnan(alone).all()


def test_no_segment_is_far_from_its_line_however_unequal_errors_are(scene: MadeScene) -> None:
    """The limit in pixels is needed because a heavy tail makes any misfit likely."""
    rig, far_px = rig_of(*VIEWS), DEFAULT.tracks.max_distance_px
    for sigma_px, tail, off_px, should_fit in (
        (0.3, 1.0, far_px / 2, True),
        (0.3, 1.0, 4 * far_px, False),
        # Ten sigmas are too many where errors are equal, however few pixels they are.
        (0.1, 0.0, 1.0, False),
    ):
        pictures_px = pictures(rig, scene.lines_mm, 0.0)
        direction = np.diff(pictures_px["low"], axis=1)[:, 0]
        normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        normal = normal / np.linalg.norm(direction, axis=1, keepdims=True)
        pictures_px["low"] = pictures_px["low"] + off_px * normal[:, None]
        shifted_scene = seen_by(rig, scene.lines_mm, pictures_px, sigma_px)
        tracks = fit_tracks(shifted_scene.inputs, shifted_scene.true, scene.lines_mm)
        fits = are_consistent(shifted_scene.inputs, tracks, DEFAULT, tail)
        assert (fits == should_fit).mean() > 0.9


def test_posteriors_of_members_are_of_the_views_that_see_a_track() -> None:
    rig = rig_of(*VIEWS)
    matches = match_segments(pictures(rig, loose_lines(30, seed=6), 0.3, seed=7), rig)
    assert matches.member_posterior is not None
    members = matches.index >= 0
    np.testing.assert_array_equal(np.isnan(matches.member_posterior), ~members)
    few = members.sum(axis=1) < 4
    np.testing.assert_allclose(
        np.nanmax(matches.member_posterior[few], axis=1, initial=0), matches.posterior[few]
    )
    assert np.nanmedian(matches.member_posterior[~few]) > 0.99
