"""Joint refinement: its estimates, their errors, and the parameters that it leaves unchanged."""

import equinox as eqx
import numpy as np
import pytest

from tests.calib.bundle.made_tracks import (
    NAMES,
    PARAMETERS,
    SHEET_SIGMA,
    TRUTH,
    made_tracks,
    rig_at,
)
from trinoc.calib.bundle import estimate
from trinoc.calib.bundle.refinement import refine
from trinoc.calib.bundle.result import RefineStatus
from trinoc.calib.tuning.every_group import TUNING
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import (
    LineObservations,
    angle_deg,
    distance_mm,
    length_mm,
)
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import Rig
from trinoc.numerics.tables import take_rows, with_field

CHI_SQUARE_6_AT_95 = 12.592


def sheet_estimate(seed):
    """Rig as calibrated with a sheet that has the stated sigmas."""
    noise = SHEET_SIGMA * np.random.default_rng(seed).standard_normal(12)
    return rig_at(TRUTH + noise, with_covariance=True)


def normalised(error, covariance):
    return np.einsum("...i,...ij,...j->...", error, np.linalg.inv(covariance), error)


@pytest.mark.slow
def test_sheet_and_segments_together_know_more_than_the_sheet_and_say_how_much():
    """Monte Carlo over 60 rigs: errors of parameters and segments follow their covariance."""
    of_rig, of_lines, before, after = [], [], [], []
    for seed in range(60):
        lines, ends, _ = made_tracks(seed, 100)
        start = sheet_estimate(1000 + seed)
        answer = refine(start, lines)
        assert answer.status is RefineStatus.CONVERGED
        assert answer.parameters == NAMES
        error = answer.values - TRUTH
        of_rig.append(normalised(error, answer.covariance))
        offset = (answer.lines.ends_mm - ends).reshape(-1, 6)
        of_lines.append(normalised(offset, answer.lines.covariance_mm2))
        after.append(error / SHEET_SIGMA)
        before.append([getattr(start[camera], name) for camera in start for name in PARAMETERS])
    assert np.mean(of_rig) == pytest.approx(12, abs=4 * np.sqrt(2 * 12 / 60))
    of_lines = np.concatenate(of_lines)
    assert (of_lines < CHI_SQUARE_6_AT_95).mean() == pytest.approx(0.95, abs=0.02)
    spread_before = (np.array(before) - TRUTH) / SHEET_SIGMA
    assert np.mean(np.square(after)) < 0.9 * np.mean(np.square(spread_before))


def test_cameras_without_a_view_change_nothing():
    lines, rig = made_tracks(7, 40)[0], sheet_estimate(8)
    more = {f"camera {k}": rig.cameras[0] for k in range(3)}
    names = [f"{camera}.{name}" for camera in more for name in PARAMETERS]
    covariance = np.eye(len(NAMES) + len(names))
    covariance[: len(NAMES), : len(NAMES)] = rig.covariance
    larger = Rig({**more, **dict(rig.items())}, parameters=(*NAMES, *names), covariance=covariance)
    expected, answer = refine(rig, lines), refine(larger, lines)
    assert answer.rig.names == rig.names
    assert answer.parameters == expected.parameters
    np.testing.assert_array_equal(answer.values, expected.values)
    np.testing.assert_array_equal(answer.covariance, expected.covariance)
    with pytest.raises(InputError, match="`moved` names camera 0"):
        refine(larger, lines, moved=("camera 0",))


def test_wrong_matches_are_found_and_do_not_pull():
    lines, _, bad = made_tracks(7, 120, wrong=0.25)
    assert bad.sum() > 15
    answer = refine(sheet_estimate(8), lines)
    assert (answer.parameters, answer.rank) == (NAMES, len(NAMES))
    agrees = (answer.inlier == lines.seen).all(axis=1)
    assert agrees[bad].mean() < 0.1
    assert agrees[~bad].mean() > 0.97
    assert normalised(answer.values - TRUTH, answer.covariance) < 40  # 99.99 % of 12: 39


def test_the_noise_of_the_segments_is_estimated():
    lines, _, _ = made_tracks(9, 120, hidden=0.0)
    pessimist = LineObservations(
        lines.views, lines.fragments_px, 4 * lines.covariance_px2, lines.seen, lines.lines_mm
    )
    right = refine(sheet_estimate(10), lines)
    assert right.segment_sigma_factor == pytest.approx(1, abs=0.1)
    answer = refine(sheet_estimate(10), pessimist)
    assert answer.segment_sigma_factor == pytest.approx(0.5 * right.segment_sigma_factor, rel=0.05)
    # The covariance of the lines does not depend on the stated sigmas.
    covariance_mm2, as_stated = (
        answer.lines.fragment_covariance_mm2,
        right.lines.fragment_covariance_mm2,
    )
    ratio = np.trace(covariance_mm2, axis1=1, axis2=2) / np.trace(as_stated, axis1=1, axis2=2)
    assert np.median(ratio) == pytest.approx(1, rel=0.1)


def test_a_sheet_that_fitted_worse_than_it_claims_knows_so_much_less(monkeypatch):
    lines, _, _ = made_tracks(9, 100, hidden=0.0)
    vague = LineObservations(
        lines.views, lines.fragments_px, 1e8 * lines.covariance_px2, lines.seen, lines.lines_mm
    )
    monkeypatch.setattr(estimate, "segment_factor", lambda squared, visible, *_: (1.0, visible))
    monkeypatch.setattr(estimate, "sheet_factor", lambda *_: 3.0)
    sheet = sheet_estimate(10)
    answer = refine(sheet, vague)
    sigma = [answer.rig.sigma(name) for name in sheet.parameters]
    np.testing.assert_allclose(
        sigma, [3 * sheet.sigma(name) for name in sheet.parameters], rtol=0.02
    )


@pytest.mark.parametrize(
    ("pose_model", "gauge"),
    [
        (PoseModel.AIMED, "orientation and scale of the whole rig"),
        (PoseModel.RIGID, "position, orientation and scale of the whole rig"),
    ],
)
def test_without_a_sheet_the_gauge_is_named_and_the_scale_stays(pose_model, gauge):
    lines, _, _ = made_tracks(11, 100)
    noise = 10 * SHEET_SIGMA * np.random.default_rng(12).standard_normal(12)
    start = rig_at(TRUTH + noise, with_covariance=False)
    answer = refine(start, lines, pose_model=pose_model)
    assert answer.status is RefineStatus.GAUGE_FREE
    assert answer.gauge == gauge
    assert answer.rig.parameters == ()  # no covariance is passed on as if it were known
    assert baselines(answer.rig).std() < baselines(start).std()
    assert spread(answer.rig) == pytest.approx(spread(start), rel=1e-9)
    assert answer.segment_sigma_factor == pytest.approx(1, abs=0.15)


def baselines(rig):
    """Ratio of each distance between two centres to the true one."""
    truth = rig_at(TRUTH, with_covariance=False)
    pairs = [(0, 1), (0, 2), (1, 2)]
    centres = [np.stack([c.centre_world_mm for c in r.cameras]) for r in (rig, truth)]
    lengths = [np.array([np.linalg.norm(c[a] - c[b]) for a, b in pairs]) for c in centres]
    return lengths[0] / lengths[1]


def spread(rig):
    centres = np.stack([camera.centre_world_mm for camera in rig.cameras])
    return np.linalg.norm(centres - centres.mean(axis=0))


def test_the_order_of_cameras_does_not_matter():
    lines, _, _ = made_tracks(13, 100)
    start = sheet_estimate(14)
    order = [2, 0, 1]
    turned = LineObservations(
        tuple(lines.views[v] for v in order),
        lines.fragments_px[:, order],
        lines.covariance_px2[:, order],
        lines.seen[:, order],
        lines.lines_mm,
    )
    one, two = refine(start, lines), refine(start, turned)
    np.testing.assert_allclose(one.values, two.values, atol=1e-9)


@pytest.mark.slow
def test_intrinsics_on_request_follow_their_covariance():
    """The errors of 12 pose and 12 intrinsic parameters, from a start with wrong focal lengths."""
    lines, _, _ = made_tracks(15, 300, sigma_px=0.1)
    start = sheet_estimate(16)
    wrong = eqx.tree_at(
        lambda rig: [camera.intrinsics.lens.focal_length_px for camera in rig.cameras],
        start,
        [1.002 * camera.intrinsics.focal_length_px for camera in start.cameras],
    )
    answer = refine(wrong, lines, free_lens=True)
    assert answer.status is RefineStatus.CONVERGED
    lens = start["upper"].intrinsics
    intrinsics = [*lens.focal_length_px, *lens.principal_point_px]
    truth = np.concatenate([[*row, *intrinsics] for row in TRUTH.reshape(3, 4)])
    assert normalised(answer.values - truth, answer.covariance) < 56.4  # 99.98 % of 24


def test_matching_again_goes_on_while_it_gains_and_stops_when_it_does_not():
    lines, _, _ = made_tracks(17, 100)
    calls = []

    def match_again(rig: Rig) -> LineObservations:
        calls.append(rig)
        return lines if len(calls) < 2 else take_rows(lines, np.arange(100) < 80)

    answer = refine(
        sheet_estimate(18), take_rows(lines, np.arange(100) < 90), match_again=match_again
    )
    assert len(calls) == 2
    assert len(answer.lines) == 100


def test_measures_carry_shared_and_own_errors():
    lines, ends, _ = made_tracks(19, 100, hidden=0.0)
    answer = refine(sheet_estimate(20), lines)
    for measure, indices in ((length_mm, [3]), (angle_deg, [3, 8]), (distance_mm, [3, 8])):
        value, sigma = answer.lines.measure(measure, *indices)
        truth = float(measure(*ends[indices]))
        assert abs(value - truth) < 4 * sigma
        assert sigma > 0
    shared = answer.lines.shared_covariance_mm2
    assert (np.linalg.eigvalsh(answer.lines.covariance_mm2 - shared) > 0).all()


def test_what_does_not_belong_together_is_refused():
    lines, _, _ = made_tracks(21, 3)
    other = LineObservations(
        ("a", "b", "c"), lines.fragments_px, lines.covariance_px2, lines.seen, lines.lines_mm
    )
    with pytest.raises(InputError, match="views a, b, c, but the rig has the cameras upper"):
        refine(sheet_estimate(0), other)
    with pytest.raises(CalibrationError, match="no track"):
        refine(sheet_estimate(0), take_rows(lines, np.zeros(3, dtype=bool)))
    lost = lines.seen.copy()
    lost[1] = [True, False, False]
    with pytest.raises(InputError, match="Track 1 is visible in 1 view"):
        LineObservations(
            lines.views, lines.fragments_px, lines.covariance_px2, lost, lines.lines_mm
        )


def test_another_tuning_is_used_after_a_call_with_the_default():
    lines, _, _ = made_tracks(5, 100)
    sheet = sheet_estimate(6)
    usual = refine(sheet, lines)
    # Residuals of two sigmas cost less under a loss that levels out there.
    narrow = refine(sheet, lines, tuning=with_field(TUNING, "bundle.loss_sigmas", 2.0))
    assert narrow.chi_square[0] < 0.9 * usual.chi_square[0]
    # If the loss never narrows, wrong fragments pull the cameras.
    wide = refine(sheet, lines, tuning=with_field(TUNING, "bundle.widenings", (16.0,)))
    assert np.abs(wide.values - usual.values).max() > 0
    strict = refine(sheet, lines, tuning=with_field(TUNING, "bundle.outlier_chance", 0.5))
    assert strict.inlier.sum() < usual.inlier.sum()
    repeated = refine(sheet, lines)
    np.testing.assert_array_equal(repeated.values, usual.values)
    np.testing.assert_array_equal(repeated.covariance, usual.covariance)
