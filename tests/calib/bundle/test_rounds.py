"""Rounds of matching: the round that wins, and answers that chance alone would give."""

import numpy as np
import pytest

from tests.calib.bundle.made_tracks import NAMES, SHEET_SIGMA, TRUTH, made_tracks, rig_at
from trinoc.calib.bundle.refinement import refine
from trinoc.calib.bundle.result import RefineStatus
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry import LineObservations
from trinoc.numerics.tables import take_rows, with_field


def knocked(degrees):
    values = TRUTH + SHEET_SIGMA * np.random.default_rng(70).standard_normal(12)
    values[[NAMES.index(f"left.{angle}_deg") for angle in ("pan", "tilt", "swing")]] += degrees
    return rig_at(values, with_covariance=True)


def with_two_views_only(lines, rows):
    """The same tracks, without their third view in some rows."""
    visible = lines.seen.copy()
    visible[rows] = [True, True, False]
    return LineObservations(
        lines.views, lines.fragments_px, lines.covariance_px2, visible, lines.lines_mm
    )


def test_more_tracks_in_two_views_do_not_win():
    lines, _, _ = made_tracks(71, 120, hidden=0.0)
    few = take_rows(lines, np.arange(120) < 100)
    many = with_two_views_only(lines, np.arange(120) >= 90)
    answer = refine(knocked(0.0), few, match_again=lambda rig: many)
    assert len(answer.tracks) == 100
    assert len(answer.history) == 1


def test_rounds_never_lower_the_posterior():
    lines, _, _ = made_tracks(72, 120, hidden=0.0)
    rounds = iter([80, 100, 90])
    answer = refine(
        knocked(0.0),
        take_rows(lines, np.arange(120) < 70),
        match_again=lambda rig: take_rows(lines, np.arange(120) < next(rounds)),
    )
    assert len(answer.tracks) == 100
    assert np.all(np.diff(answer.history) > 0)
    assert answer.history[-1] == answer.log_posterior


@pytest.fixture(scope="module")
def right():
    """A matcher with the right lines for any rig, and the refined answer."""
    lines, _, _ = made_tracks(73, 100, hidden=0.0)
    calls = []

    def tolerant(rig):
        calls.append("tolerant")
        return lines

    def last(rig):
        calls.append("last")
        return lines

    answer = refine(knocked(0.3), lines, moved=("left",), match_again=[tolerant, last])
    return answer, calls


def test_the_matchers_take_turns_from_the_most_tolerant_to_the_last(right):
    answer, calls = right
    assert calls[:3] == ["last", "tolerant", "tolerant"]
    assert calls[-1] == "last"
    assert answer.status is RefineStatus.CONVERGED
    assert answer.history[-1] == answer.log_posterior


def test_a_knocked_camera_need_not_aim_at_the_origin(right):
    answer, _ = right
    assert "left.aim_x_mm" in answer.parameters
    for camera in ("upper", "right"):  # the aims of those that did not move are held
        assert max(map(abs, answer.rig[camera].aim_mm)) < 0.01
    error = np.linalg.norm(
        answer.rig["left"].centre_world_mm
        - rig_at(TRUTH, with_covariance=False)["left"].centre_world_mm
    )
    assert error < 3.0


def test_matches_that_agree_with_any_rig_are_refused():
    """Matches made by chance agree with the assumed rig, wherever that rig stands."""
    lines, ends, _ = made_tracks(74, 100, hidden=0.0)

    def chance(rig):
        image = np.einsum("vij,tej->tvei", rig.matrices_px[:, :, :3], ends)
        image = image + rig.matrices_px[None, :, None, :, 3]
        return LineObservations(
            rig.names, image[..., :2] / image[..., 2:], lines.covariance_px2, lines.seen, ends
        )

    start = knocked(0.3)
    answer = refine(start, chance(start), moved=("left",), match_again=chance)
    assert answer.status is RefineStatus.AMBIGUOUS
    np.testing.assert_array_equal(answer.rig.matrices_px, start.matrices_px)
    # Any two answers are one where lines may miss each other by so much.
    lax = with_field(TUNING, "bundle.same_sigmas", 1e9)
    answer = refine(start, chance(start), moved=("left",), match_again=chance, tuning=lax)
    assert answer.status is not RefineStatus.AMBIGUOUS
