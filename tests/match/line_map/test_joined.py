"""Laws of joined collinear tracks, valid in every scene."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from tests.match.made import loose_lines, rig_of
from trinoc.errors import InputError
from trinoc.geometry import distort_pixels
from trinoc.match import join_collinear, snap_corners
from trinoc.match.line_map.line_fit import LineFragments, fit_line
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tracks.matches import TRINOCULAR, Matches
from trinoc.numerics.vectors import complete_axes

from .made_tracks import (
    AS_STATED,
    VIEWS,
    matches_of,
    pieces_of,
    tracks_of,
)


def across_of(ends_mm: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> tuple:
    """Distances of both ends from a true line, mm (4,), and their covariance (4, 4)."""
    direction = truth[1] - truth[0]
    axes = complete_axes(direction / np.linalg.norm(direction))
    jacobian = np.kron(np.eye(2), axes)
    return ((ends_mm - truth[0]) @ axes.T).reshape(4), jacobian @ covariance @ jacobian.T


def same_lines(joined: JoinedLines, count: int) -> bool:
    """True if exactly the tracks k, k + count, ... are one line, for all k."""
    number = joined.line_of_track.reshape(-1, count)
    return bool((number == number[0]).all()) and len(joined) == count


def test_pieces_of_a_line_say_as_much_as_the_whole_line(rig) -> None:
    lines_mm = loose_lines(12, seed=4)
    pieces = tracks_of(rig, pieces_of(lines_mm, (0.0, 0.4), (0.4, 1.0)))
    joined = join_collinear(pieces, rig, tuning=AS_STATED)
    assert same_lines(joined, 12)
    unsplit = tracks_of(rig, lines_mm)
    matrices = np.stack([rig[name].matrix_px for name in VIEWS])
    assert unsplit.fragments_covariance_px2 is not None
    for line in range(12):
        shown = LineFragments(
            matrices, unsplit.fragments_px[line], unsplit.fragments_covariance_px2[line]
        )
        fit = fit_line(shown, joined.lines_mm[line])
        np.testing.assert_allclose(fit.ends_mm, joined.lines_mm[line], atol=1e-6)
        _, expected = across_of(fit.ends_mm, fit.covariance_mm2, lines_mm[line])
        _, joined_covariance = across_of(
            joined.lines_mm[line], joined.covariance_mm2[line], lines_mm[line]
        )
        np.testing.assert_allclose(
            joined_covariance, expected, rtol=0.02, atol=0.01 * np.trace(expected)
        )


def test_joined_lines_are_as_far_from_the_true_ones_as_their_covariance_says(rig) -> None:
    lines_mm = np.concatenate([loose_lines(40, seed=seed) for seed in (5, 6, 7)])
    squares, fits, degrees = [], 0.0, 0
    for part in np.split(lines_mm, 3):
        pieces = pieces_of(part, (0.0, 0.3), (0.35, 0.7), (0.72, 1.0))
        matches = tracks_of(rig, pieces, seed=len(squares))
        joined = join_collinear(matches, rig, tuning=AS_STATED)
        for line in np.flatnonzero(joined.pieces == 3):
            truth = part[joined.tracks_of(line)[0] % 40]
            error, covariance = across_of(joined.lines_mm[line], joined.covariance_mm2[line], truth)
            squares.append(error @ np.linalg.solve(covariance, error))
            fits, degrees = fits + joined.chi_square[line], degrees + joined.degrees[line]
    assert len(squares) > 100
    inside = float(np.mean(np.array(squares) < chi2.ppf(0.95, 4)))
    assert 0.88 < inside < 0.995
    # Of nine segments each, and large errors count for less than their square.
    assert degrees == 14 * len(squares)
    assert 0.75 < fits / degrees < 1.1


def test_what_is_not_known_along_a_segment_says_nothing_across(rig) -> None:
    lines_mm = loose_lines(10, seed=21)
    matches = tracks_of(rig, pieces_of(lines_mm, (0.0, 0.45), (0.5, 1.0)), seed=4)
    assert matches.fragments_covariance_px2 is not None
    direction = np.diff(matches.fragments_px, axis=2)[:, :, 0]
    direction = direction / np.linalg.norm(direction, axis=2, keepdims=True)
    # As where an epipolar plane cuts a segment: ten thousand pixels.
    free = 1e8 * np.einsum("ef,tvi,tvj->tveifj", np.eye(2), direction, direction).reshape(
        -1, 3, 4, 4
    )
    covariance = matches.fragments_covariance_px2 + free
    loose = dataclasses.replace(matches, fragments_covariance_px2=covariance)
    joined, loose_joined = join_collinear(matches, rig), join_collinear(loose, rig)
    np.testing.assert_array_equal(loose_joined.line_of_track, joined.line_of_track)
    np.testing.assert_allclose(loose_joined.lines_mm, joined.lines_mm, atol=1e-6)


def test_where_views_disagree_a_line_is_known_no_better_than_they_agree(rig) -> None:
    line = loose_lines(8, seed=22)
    matches = tracks_of(rig, line, sigma_px=0.2)
    off = matches.fragments_px.copy()
    direction = off[:, 0, 1] - off[:, 0, 0]
    normal = (
        np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        / np.linalg.norm(direction, axis=1)[:, None]
    )
    off[:, 0] += normal[:, None]
    agree = join_collinear(matches, rig)
    differ = join_collinear(dataclasses.replace(matches, fragments_px=off), rig)
    agreeing_traces, differing_traces = (
        [
            np.trace(across_of(*line_and_truth)[1])
            for line_and_truth in zip(joined.lines_mm, joined.covariance_mm2, line, strict=True)
        ]
        for joined in (agree, differ)
    )
    ratio = np.array(differing_traces) / agreeing_traces
    assert ratio.min() > 1
    assert np.median(ratio) > 3


def test_order_of_tracks_and_of_ends_changes_only_the_numbering(rig) -> None:
    pieces = pieces_of(loose_lines(30, seed=8), (0.0, 0.45), (0.5, 1.0))
    matches = tracks_of(rig, pieces, seed=3)
    rank = np.random.default_rng(1).permutation(60)
    assert matches.fragments_covariance_px2 is not None
    reordered = dataclasses.replace(
        matches,
        index=matches.index[rank][:, ::-1],
        views=VIEWS[::-1],
        fragments_px=matches.fragments_px[rank][:, ::-1],
        fragments_covariance_px2=matches.fragments_covariance_px2[rank][:, ::-1],
        lines_mm=matches.lines_mm[rank],
        covariance_mm2=matches.covariance_mm2[rank],
    )
    joined, turned = join_collinear(matches, rig), join_collinear(reordered, rig)
    assert len(joined) == len(turned)
    assert (joined.pieces > 1).sum() > 20
    line, other = joined.line_of_track[rank], turned.line_of_track
    np.testing.assert_array_equal(
        line[:, None] == line, other[:, None] == other, err_msg="other tracks are joined"
    )
    np.testing.assert_allclose(turned.lines_mm[other], joined.lines_mm[line], atol=1e-7)
    np.testing.assert_allclose(
        turned.covariance_mm2[other], joined.covariance_mm2[line], rtol=1e-5, atol=1e-9
    )


def test_parallel_edges_that_can_be_told_apart_are_never_joined(rig) -> None:
    # Pairs of edges, end to end or side by side, shifted by ten standard deviations or more.
    edges = loose_lines(30, seed=9)
    rng = np.random.default_rng(2)
    direction = edges[:, 1] - edges[:, 0]
    shift = np.cross(direction, rng.normal(size=direction.shape))
    shift *= rng.uniform(1.5, 6.0, (30, 1)) / np.linalg.norm(shift, axis=1, keepdims=True)
    along = rng.choice([0.0, 0.4, 1.02], (30, 1)) * direction
    joined = join_collinear(
        tracks_of(rig, np.concatenate([edges, edges + (shift + along)[:, None]])), rig
    )
    assert (joined.pieces == 1).all()
    assert len(joined) == 60


def test_a_segment_of_two_tracks_counts_once(rig) -> None:
    lines_mm = loose_lines(10, seed=10)
    matches = tracks_of(rig, pieces_of(lines_mm, (0.0, 0.45), (0.55, 1.0)))
    complete = tracks_of(rig, lines_mm)
    assert matches.fragments_covariance_px2 is not None
    assert complete.fragments_covariance_px2 is not None
    # One view shows the line in one segment, of which each track has the part that is its own.
    index, covariance = matches.index.copy(), matches.fragments_covariance_px2.copy()
    index[:, 0] = np.tile(np.arange(10), 2)
    fragments = matches.fragments_px[:, 0].reshape(2, 10, 2, 2)
    segment, segment_covariance = (
        complete.fragments_px[:, 0],
        complete.fragments_covariance_px2[:, 0],
    )
    step = segment[:, 1] - segment[:, 0]
    share = ((fragments - segment[:, 0, None]) * step[:, None]).sum(axis=3)
    share = share / (step**2).sum(axis=1)[:, None]
    weight = np.stack([1 - share, share], axis=3)
    spread = np.einsum("knef,ij->kneifj", weight, np.eye(2)).reshape(2, 10, 4, 4)
    covariance[:, 0] = (spread @ segment_covariance @ spread.mT).reshape(20, 4, 4)
    # Along the fitted covariance has room enough to be inverted.
    shared = matches_of(rig, index, matches.fragments_px, covariance)
    joined = join_collinear(shared, rig, tuning=AS_STATED)
    assert same_lines(joined, 10)
    assert (joined.degrees == 2 * 5 - 4).all()
    for line in range(10):
        separate = tracks_of(rig, pieces_of(lines_mm[line : line + 1], (0.0, 0.45), (0.55, 1.0)))
        expected = join_collinear(separate, rig, tuning=AS_STATED)
        _, separate_covariance = across_of(
            expected.lines_mm[0], expected.covariance_mm2[0], lines_mm[line]
        )
        _, shared_covariance = across_of(
            joined.lines_mm[line], joined.covariance_mm2[line], lines_mm[line]
        )
        # The one segment also shows what the others leave out, a tenth of it.
        assert 0.8 < np.trace(shared_covariance) / np.trace(separate_covariance) < 1.0 + 1e-9


def test_gaps_and_overlaps_are_where_tracks_leave_them(rig) -> None:
    lines_mm = loose_lines(1, seed=11)
    length = np.linalg.norm(lines_mm[0, 1] - lines_mm[0, 0])
    joined = join_collinear(
        tracks_of(rig, pieces_of(lines_mm, (0.0, 0.4), (0.35, 0.6), (0.7, 1.0))), rig
    )
    assert same_lines(joined, 1)
    np.testing.assert_allclose(joined.place_mm[:, 0].min(), 0.0, atol=1e-6)
    gaps, overlaps = joined.gaps_mm(0) / length, joined.overlaps_mm(0) / length
    if joined.tracks_of(0)[0] != 0:
        gaps, overlaps = 1 - gaps[:, ::-1], 1 - overlaps[:, ::-1]
    np.testing.assert_allclose(gaps, [[0.6, 0.7]], atol=1e-3)
    np.testing.assert_allclose(overlaps, [[0.35, 0.4]], atol=1e-3)


def test_fragments_are_taken_where_the_lens_shows_them(rig) -> None:
    pieces = pieces_of(loose_lines(10, seed=15), (0.0, 0.5), (0.55, 1.0))
    matches = tracks_of(rig, pieces, seed=4)
    bent = rig_of(*VIEWS, distortion=(-0.6, 0.1, 0.002, -0.002, 0.0))
    distorted_px = np.stack(
        [
            distort_pixels(bent[name].intrinsics, matches.fragments_px[:, view])
            for view, name in enumerate(VIEWS)
        ],
        axis=1,
    )
    assert np.abs(distorted_px - matches.fragments_px).max() > 1
    joined = join_collinear(matches, rig)
    bent_joined = join_collinear(dataclasses.replace(matches, fragments_px=distorted_px), bent)
    np.testing.assert_array_equal(bent_joined.line_of_track, joined.line_of_track)
    np.testing.assert_allclose(bent_joined.lines_mm, joined.lines_mm, atol=1e-5)


def test_of_nothing_nothing_is_joined(rig) -> None:
    none = np.zeros((0, 3), dtype=np.int64)
    empty = Matches(
        VIEWS,
        none,
        np.zeros((0, 3, 2, 2)),
        np.zeros((0, 2, 3)),
        np.zeros((0, 6, 6)),
        np.full(0, TRINOCULAR),
        np.zeros(0),
        np.zeros(0),
        {},
        {},
        np.zeros((0, 3, 4, 4)),
    )
    joined = join_collinear(empty, rig)
    assert len(joined) == 0
    assert len(snap_corners(joined)) == 0
    with pytest.raises(InputError, match="match the segments again"):
        join_collinear(dataclasses.replace(empty, fragments_covariance_px2=None), rig)
