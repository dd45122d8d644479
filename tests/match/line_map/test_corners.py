"""Laws of ends snapped to corners, valid in every scene."""

import dataclasses

import numpy as np
import pytest
from scipy.special import logit
from scipy.stats import chi2, norm

from tests.match.made import loose_lines
from trinoc.match import (
    Corners,
    snap_corners,
)
from trinoc.match.line_map import corners as corners_file
from trinoc.match.line_map.corners import (
    Ends,
    _constrain,
    _move_end_to_point,
    corner_candidates,
    line_ends,
)
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.numerics.tables import with_field
from trinoc.numerics.vectors import complete_axes

from .made_tracks import (
    lines_alone,
    tracks_of,
)


def corners_of_lines(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random corners (count, 3), and three lines that start at each corner (3 count, 2, 3)."""
    rng = np.random.default_rng(seed)
    point = rng.uniform([-60, -50, 0], [60, 50, 40], (count, 3))
    direction = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    far = point[:, None] + rng.uniform(18, 30, (count, 3, 1)) * direction
    lines = np.stack([np.broadcast_to(point[:, None], far.shape), far], axis=2)
    return point, lines.reshape(-1, 2, 3)


def test_corners_are_as_far_from_the_true_ones_as_their_covariance_says(rig) -> None:
    squares, before, after = [], [], []
    for seed in range(5):
        point, lines = corners_of_lines(16, seed)
        joined = lines_alone(tracks_of(rig, lines, seed=seed), rig)
        corners = snap_corners(joined)
        for corner in range(len(corners)):
            of = corners.corner == corner
            of_truth = corners.line[of] // 3
            if of.sum() != 3 or len(set(of_truth.tolist())) > 1:
                continue
            truth = point[of_truth[0]]
            error = corners.points_mm[corner] - truth
            squares.append(error @ np.linalg.solve(corners.covariance_mm2[corner], error))
            after.append(np.linalg.norm(error))
            ends = joined.lines_mm[corners.line[of], corners.end[of]]
            before.extend(np.linalg.norm(ends - truth, axis=1))
    assert len(squares) > 60
    assert 0.85 < float(np.mean(np.array(squares) < chi2.ppf(0.95, 3))) < 0.999
    assert np.median(after) < 0.7 * np.median(before)


def test_snapped_ends_meet_and_the_other_lines_stay(rig) -> None:
    _, lines = corners_of_lines(6, seed=7)
    alone = loose_lines(6, seed=13) + np.array([0.0, 0.0, 150.0])
    joined = lines_alone(tracks_of(rig, np.concatenate([lines, alone]), seed=8), rig)
    corners = snap_corners(joined)
    assert len(corners) >= 5
    ends = corners.lines_mm[corners.line, corners.end]
    np.testing.assert_allclose(ends, corners.points_mm[corners.corner], atol=1e-8)
    others = np.setdiff1d(np.arange(len(joined)), corners.line)
    np.testing.assert_array_equal(corners.lines_mm[others], joined.lines_mm[others])
    np.testing.assert_array_equal(
        corners.lines_covariance_mm2[others], joined.covariance_mm2[others]
    )
    # Nothing is known worse across its line for having been held to a corner.
    for line in np.unique(corners.line[np.isin(corners.line, _at_one_corner(corners))]):
        end = int(corners.end[corners.line == line][0])
        offset = joined.lines_mm[line, 1] - joined.lines_mm[line, 0]
        axes = complete_axes(offset / np.linalg.norm(offset))
        unsnapped, snapped = (
            axes @ covariance[line].reshape(2, 3, 2, 3)[end, :, end] @ axes.T
            for covariance in (joined.covariance_mm2, corners.lines_covariance_mm2)
        )
        # But for the few pixels by which the end has moved out.
        assert np.linalg.eigvalsh(1.3 * unsnapped - snapped).min() > 0


def _at_one_corner(corners: Corners) -> np.ndarray:
    line, count = np.unique(corners.line, return_counts=True)
    return line[count == 1]


def test_snapping_what_is_snapped_moves_nothing(rig) -> None:
    _, lines = corners_of_lines(10, seed=14)
    joined = lines_alone(tracks_of(rig, lines, seed=9), rig)
    corners = snap_corners(joined)
    snapped_twice = snap_corners(dataclasses.replace(joined, lines_mm=corners.lines_mm))
    assert len(snapped_twice) >= len(corners) > 7
    table = {
        (int(a), int(b)): c
        for a, b, c in zip(snapped_twice.line, snapped_twice.end, snapped_twice.corner, strict=True)
    }
    for line, end, corner in zip(corners.line, corners.end, corners.corner, strict=True):
        np.testing.assert_allclose(
            snapped_twice.points_mm[table[int(line), int(end)]],
            corners.points_mm[corner],
            atol=1e-7,
        )


def test_odds_of_ends_fall_as_the_density_of_how_near_their_lines_pass(monkeypatch) -> None:
    """Two lines cross at a right angle; only their distance and their covariances change."""
    monkeypatch.setattr(corners_file, "_ROUNDS", 0)
    tuning = with_field(MatchTuning(), "collinear.min_posterior", 1e-9)
    root = np.random.default_rng(3).normal(size=(2, 6, 6))
    line_covariance = 0.02 * root @ root.mT

    def odds(distance_mm: float, scale: float) -> float:
        lines = np.array([[[0.0, 0, 0], [25, 0, 0]], [[0, 0, 0], [0, 25, 0]]])
        lines[1, :, 2] = distance_mm
        one = np.arange(2)
        joined = JoinedLines(
            lines, scale * line_covariance, np.zeros(2), 0 * one, one, np.zeros((2, 2)),
            3 + 0.0 * one, np.ones(2),
        )  # fmt: skip
        ends = line_ends(joined)
        pairs, likely = corner_candidates(ends, joined, tuning)
        met = np.flatnonzero((pairs == [0, 2]).all(axis=1))
        return float(logit(np.exp(likely[met[0]])))

    # Across both, each line is known at its first end as the third number of its covariance.
    variance = line_covariance[:, 2, 2].sum()
    for scale in (1.0, 4.0):
        sigma = np.sqrt(scale * variance)
        for distance_mm in (0.1, 0.4):
            expected = norm.logpdf(distance_mm, scale=sigma) - norm.logpdf(
                0, scale=np.sqrt(variance)
            )
            assert odds(distance_mm, scale) - odds(0.0, 1.0) == pytest.approx(expected, abs=1e-6)


def test_ends_that_pass_each_other_do_not_meet(rig) -> None:
    # Two lines cross at a right angle, 3 mm apart, which is ten standard deviations and more.
    one = np.array([[0.0, 0.0, 10.0], [25.0, 0.0, 10.0]])
    other = np.array([[0.0, 0.0, 13.0], [0.0, 25.0, 13.0]])
    joined = lines_alone(tracks_of(rig, np.stack([one, other])), rig)
    assert len(snap_corners(joined)) == 0
    met = lines_alone(tracks_of(rig, np.stack([one, other - [0.0, 0.0, 3.0]])), rig)
    corners = snap_corners(met)
    np.testing.assert_allclose(corners.points_mm, [[0.0, 0.0, 10.0]], atol=1e-5)


def test_lines_that_meet_at_both_ends_are_held_although_that_is_said_twice() -> None:
    """Two of the six conditions are redundant: the lines have no variance along themselves."""
    lines = np.array([[[0.0, 0, 0], [9, 0, 0]], [[0, 0.1, 0], [9, 0.2, 0]]])
    across = np.diag([0.0, 0.01, 0.04])
    covariance = np.tile(np.kron(np.eye(2), across), (2, 1, 1))
    _constrain(lines, covariance, np.array([0, 1]), [(0, 2), (1, 3)])
    np.testing.assert_allclose(lines[0], lines[1], atol=1e-12)
    np.testing.assert_allclose(lines[0, :, 1], [0.05, 0.1])
    np.testing.assert_allclose(np.diagonal(covariance[0]), [0, 0.005, 0.02] * 2, atol=1e-12)


def test_along_its_line_an_end_brought_to_a_corner_is_known_to_the_pixels_stated() -> None:
    lines = np.array([[[1.0, 2.0, 3.0], [4.0, 6.0, 3.0]]])
    root = np.random.default_rng(4).normal(size=(6, 6))
    covariance = 0.01 * (root @ root.T)[None]
    direction, px_per_mm, free_end_px = np.array([0.6, 0.8, 0.0]), 2.0, 7.0
    both_orders = np.stack([lines[0], lines[0, ::-1]])
    ends = Ends(
        lines[0], np.stack([-direction, direction]), both_orders, np.zeros((2, 6, 6)),
        np.full(2, px_per_mm),
    )  # fmt: skip
    moved, spread = lines.copy(), covariance.copy()
    _move_end_to_point(moved, spread, ends, 1, lines[0, 1], free_end_px)
    np.testing.assert_allclose(moved, lines)
    expected = covariance[0].copy()
    expected[3:, 3:] += (free_end_px / px_per_mm) ** 2 * np.outer(direction, direction)
    np.testing.assert_allclose(spread[0], expected, atol=1e-12)
