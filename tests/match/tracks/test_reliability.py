"""Usability of matches: evidence against the set, and uncertainty relative to the scene."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulation import Detector, simulate_segments
from simulation.scenes import see_through_boxes
from tests.match.made import sure_matches
from trinoc.geometry.rig import Rig
from trinoc.match.decoys import SureTracks, _as_suspect
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import Matches, MatchStatus
from trinoc.match.tracks.reliability import assess_matches, scene_extent_mm
from trinoc.match.tuning.tracks import DecoyTuning, TrackTuning
from trinoc.synth import table1_rig


def scaled(matches: Matches, factor: float) -> Matches:
    """The same matches with the world and the cameras scaled by this factor."""
    return replace(
        matches,
        lines_mm=factor * matches.lines_mm,
        covariance_mm2=factor**2 * matches.covariance_mm2,
    )


@given(
    share=st.floats(1e-5, 1.0),
    factor=st.sampled_from([1e-3, 0.1, 25.4, 1e3, 1e6]),
    count=st.integers(1, 60),
)
def test_the_scale_of_the_world_changes_no_verdict(share, factor, count):
    limit = TrackTuning.max_sigma_of_scene
    if abs(share / limit - 1) < 1e-6:
        return
    matches = sure_matches(share, count)
    one, other = assess_matches(matches), assess_matches(scaled(matches, factor))
    assert [each.status for each in one.findings] == [each.status for each in other.findings]
    assert (one.status, one.deciding.topic) == (other.status, other.deciding.topic)
    percent = [each.deciding.figure.split(", ")[-1] for each in (one, other)]
    assert percent[0] == percent[1]


@given(share=st.floats(0.1, 100.0), count=st.integers(1, 200))
def test_lines_that_err_by_a_tenth_of_the_scene_are_never_usable(share, count):
    assert sure_matches(share, count).status is not MatchStatus.MATCHED


def test_the_sentence_has_the_number_its_unit_and_the_remedy():
    good, bad = (sure_matches(share) for share in (0.002, 0.12))
    sigma = float(np.median(bad.across_sigma_mm))
    assert assess_matches(good).sentence.startswith("You can use these matches. ± ")
    assert assess_matches(good).deciding.remedy == ""
    assessment = assess_matches(bad)
    assert assessment.status is MatchStatus.UNCERTAIN
    assert f"± {sigma:.0f} mm, 12 % of the scene" in assessment.sentence
    assert assessment.sentence.endswith(assessment.deciding.remedy)
    assert assessment.deciding.remedy.startswith(
        "To reduce the sigmas, put the cameras farther apart"
    )


@pytest.mark.parametrize("clutter", [0, 200, 20_000])
def test_unmatched_segments_of_a_cluttered_scene_are_no_evidence(clutter):
    matches = sure_matches()
    reasons = {
        view: np.concatenate([view_reasons, np.full(clutter, "evidence too weak")])
        for view, view_reasons in matches.reasons.items()
    }
    assert replace(matches, reasons=reasons).status is MatchStatus.MATCHED


@given(share=st.floats(1e-6, 1.0), count=st.integers(20, 60), by_chance=st.integers(0, 60))
def test_a_refused_set_is_never_usable(share, count, by_chance):
    matches = sure_matches(share, count)
    chance = [SureTracks(by_chance, 0)] if by_chance else []
    refused = _as_suspect(matches, SureTracks(count, 0), chance, "They are exchanged.")
    assessment = assess_matches(refused, {"upper": "Its residuals are a swirl."})
    assert assessment.status is refused.status is MatchStatus.SUSPECT
    assert "They are exchanged." in assessment.sentence
    assert (refused.posterior <= 0.5).all()


def test_few_sure_lines_are_not_usable_however_exact():
    fewest = TrackTuning.min_sure_lines
    for count in (0, 1, fewest - 1, fewest, fewest + 1):
        matches = sure_matches(1e-4, 40)
        sure = np.arange(40) < count
        matches = replace(matches, posterior=np.where(sure, 0.99, DecoyTuning.sure_posterior))
        assessment = assess_matches(matches)
        assert (assessment.status is MatchStatus.MATCHED) is (count >= fewest)
        if count < fewest:
            assert assessment.deciding.figure == f"{count} sure lines in three views or more"
            assert "Check that this rig took these images" in assessment.sentence


def test_two_views_are_never_more_than_usable_with_care():
    assessment = assess_matches(sure_matches(1e-4, 40, ("upper", "left")))
    assert assessment.status is MatchStatus.UNCERTAIN
    assert "add a third camera" in assessment.sentence


def test_lines_of_unknown_error_are_not_usable():
    matches = sure_matches()
    unknown = replace(matches, covariance_mm2=np.full((40, 6, 6), np.nan))
    assert unknown.status is MatchStatus.UNCERTAIN
    assert "not known" in assess_matches(unknown).sentence


def test_a_suspect_calibration_and_errors_above_those_stated_ask_for_care():
    matches = sure_matches()
    doubted = assess_matches(matches, {"upper": "its residuals are a swirl."})
    assert (doubted.status, doubted.deciding.topic) == (MatchStatus.UNCERTAIN, "rig")
    assert (
        "the rig states that the calibration of upper is SUSPECT. Its residuals are a swirl."
        in doubted.sentence
    )
    noisy = replace(matches, noise_scale=DecoyTuning.noisy_above + 0.1)
    assert assess_matches(noisy).deciding.topic == "agreement"
    assert "2.10 times their sigma" in assess_matches(noisy).sentence


@given(outlier=st.floats(10.0, 1e9))
def test_one_line_far_away_does_not_make_the_scene_large(outlier):
    lines = np.random.default_rng(4).uniform(-100, 100, (40, 2, 3))
    far = np.concatenate([lines, outlier * lines[:1]])
    assert scene_extent_mm(far) == pytest.approx(scene_extent_mm(lines), rel=0.15)


def test_the_matcher_gives_one_verdict_in_worlds_of_any_unit():
    rig = table1_rig()
    segments = dict(
        simulate_segments(see_through_boxes(31, count=5), rig, Detector(shortest_px=8.0), seed=31)[
            0
        ]
    )
    figures = []
    for factor in (1.0, 1e3):
        matrices = {
            name: np.asarray(rig[name].matrix_px) @ np.diag([1, 1, 1, factor]) for name in rig
        }
        matches = match_segments(segments, Rig.from_matrices(matrices, (512, 480)))
        assert matches.status is MatchStatus.MATCHED
        figures.append(assess_matches(matches).deciding.figure.split(", ")[1])
    assert figures[0] == figures[1]


@pytest.mark.skipif("TRINOC_DATA" not in os.environ, reason="TRINOC_DATA names no folder of data")
@pytest.mark.parametrize(
    ("order", "status"), [((0, 1, 2), MatchStatus.MATCHED), ((1, 0, 2), MatchStatus.SUSPECT)]
)
def test_photographs_are_usable_and_suspect_once_two_are_exchanged(order, status):
    file = Path(os.environ["TRINOC_DATA"]) / "vgg_merton1" / "merton1.npz"
    if not file.exists():
        pytest.skip("TRINOC_DATA holds no vgg_merton1")
    data = np.load(file)
    rig = Rig.from_matrices({str(k): data["projection"][k] for k in range(3)}, (1024, 768))
    segments = {str(k): data[f"segments_{order[k]}"] for k in range(3)}
    assert match_segments(segments, rig).status is status
