"""Collinear tracks joined, and ends snapped to corners: what holds whatever the scene."""

import dataclasses

import jax
import numpy as np
import pytest
from scipy.stats import chi2

from tests.match.made import loose_lines, rig_of
from trinoc.errors import InputError
from trinoc.geometry import Rig, triangulate_segment
from trinoc.match import (
    TRINOCULAR,
    Corners,
    JoinedLines,
    Matches,
    MatchTuning,
    join_collinear,
    snap_corners,
)
from trinoc.match.line_map.line_fit import LineFragments, fit_line
from trinoc.match.observations import distorted
from trinoc.numerics import axes_across, with_field

VIEWS = ("upper", "left", "right")
_triangulated = jax.jit(jax.vmap(triangulate_segment, in_axes=(None, 0, 0, 0)))
ROOM = 128
# For segments that err as they say, whatever those of pictures do.
AS_STATED = with_field(
    with_field(MatchTuning(), "collinear.error_shares", (1 - 2e-9, 1e-9, 1e-9)),
    "collinear.error_observations",
    1e9,
)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_of(*VIEWS)


def fitted_covariance(ends_px: np.ndarray, sigma_px: float) -> np.ndarray:
    """(n, 4, 4) of segments that are lines fitted to points, `sigma_px` each, a pixel apart."""
    way = ends_px[:, 1] - ends_px[:, 0]
    length = np.linalg.norm(way, axis=1)
    way = way / length[:, None]
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1)
    across = np.array([[4.0, -2.0], [-2.0, 4.0]]) * (sigma_px**2 / length)[:, None, None]
    spread = np.einsum("nef,ni,nj->neifj", across, normal, normal)
    along = np.einsum("ef,ni,nj->neifj", np.eye(2), way, way)
    return (spread + along).reshape(-1, 4, 4)


def tracks_of(
    rig: Rig, lines_mm: np.ndarray, *, sigma_px: float = 0.5, seed: int | None = None
) -> Matches:
    """A track of three segments for every line, which err as their covariances say."""
    count = len(lines_mm)
    fragments, covariance = np.zeros((count, 3, 2, 2)), np.zeros((count, 3, 4, 4))
    rng = np.random.default_rng(seed)
    for view, name in enumerate(VIEWS):
        matrix = rig[name].matrix_px
        image = lines_mm @ matrix[:, :3].T + matrix[:, 3]
        ends = image[..., :2] / image[..., 2:]
        covariance[:, view] = fitted_covariance(ends, sigma_px)
        noise = np.linalg.cholesky(covariance[:, view]) @ rng.normal(size=(count, 4, 1))
        fragments[:, view] = ends + (0 if seed is None else noise.reshape(-1, 2, 2))
    return _matches(rig, np.repeat(np.arange(count)[:, None], 3, axis=1), fragments, covariance)


def _matches(rig: Rig, index: np.ndarray, fragments: np.ndarray, covariance: np.ndarray) -> Matches:
    count = len(index)
    assert 0 < count <= ROOM
    rows = np.minimum(np.arange(ROOM), count - 1)
    matrices = np.stack([rig[name].matrix_px for name in VIEWS])
    found = _triangulated(matrices, fragments[rows], covariance[rows], index[rows] >= 0)
    return Matches(
        VIEWS,
        index,
        fragments,
        np.asarray(found.ends_mm)[:count],
        np.asarray(found.covariance_mm2)[:count],
        np.full(count, TRINOCULAR),
        np.ones(count),
        np.zeros(count),
        {},
        {},
        covariance,
    )


def pieces_of(lines_mm: np.ndarray, *borders: tuple[float, float]) -> np.ndarray:
    """Parts of all lines, from 0 to 1 along each: all first ones, then all second ones."""
    parts = [
        lines_mm[:, :1] + np.array(b)[:, None] * (lines_mm[:, 1:] - lines_mm[:, :1])
        for b in borders
    ]
    return np.concatenate(parts)


def across_of(ends_mm: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> tuple:
    """(distances of both ends from a true line, their covariance)."""
    way = truth[1] - truth[0]
    axes = axes_across(way / np.linalg.norm(way))
    jacobian = np.kron(np.eye(2), axes)
    return ((ends_mm - truth[0]) @ axes.T).reshape(4), jacobian @ covariance @ jacobian.T


def same_lines(joined: JoinedLines, count: int) -> bool:
    """Whether tracks k, k + count, ... are one line, for all k, and nothing else is."""
    number = joined.line_of_track.reshape(-1, count)
    return bool((number == number[0]).all()) and len(joined) == count


def test_pieces_of_a_line_say_as_much_as_the_whole_line(rig) -> None:
    whole = loose_lines(12, seed=4)
    pieces = tracks_of(rig, pieces_of(whole, (0.0, 0.4), (0.4, 1.0)))
    joined = join_collinear(pieces, rig, tuning=AS_STATED)
    assert same_lines(joined, 12)
    unsplit = tracks_of(rig, whole)
    matrices = np.stack([rig[name].matrix_px for name in VIEWS])
    assert unsplit.fragments_covariance_px2 is not None
    for line in range(12):
        shown = LineFragments(
            matrices, unsplit.fragments_px[line], unsplit.fragments_covariance_px2[line]
        )
        fit = fit_line(shown, joined.lines_mm[line])
        np.testing.assert_allclose(fit.ends_mm, joined.lines_mm[line], atol=1e-6)
        _, expected = across_of(fit.ends_mm, fit.covariance_mm2, whole[line])
        _, found = across_of(joined.lines_mm[line], joined.covariance_mm2[line], whole[line])
        np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.01 * np.trace(expected))


def test_joined_lines_are_as_far_from_the_true_ones_as_their_covariance_says(rig) -> None:
    whole = np.concatenate([loose_lines(40, seed=seed) for seed in (5, 6, 7)])
    squares, fits, degrees = [], 0.0, 0
    for part in np.split(whole, 3):
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
    whole = loose_lines(10, seed=21)
    matches = tracks_of(rig, pieces_of(whole, (0.0, 0.45), (0.5, 1.0)), seed=4)
    assert matches.fragments_covariance_px2 is not None
    way = np.diff(matches.fragments_px, axis=2)[:, :, 0]
    way = way / np.linalg.norm(way, axis=2, keepdims=True)
    # As where an epipolar plane cuts a segment: ten thousand pixels.
    free = 1e8 * np.einsum("ef,tvi,tvj->tveifj", np.eye(2), way, way).reshape(-1, 3, 4, 4)
    covariance = matches.fragments_covariance_px2 + free
    loose = dataclasses.replace(matches, fragments_covariance_px2=covariance)
    joined, again = join_collinear(matches, rig), join_collinear(loose, rig)
    np.testing.assert_array_equal(again.line_of_track, joined.line_of_track)
    np.testing.assert_allclose(again.lines_mm, joined.lines_mm, atol=1e-6)


def test_where_views_disagree_a_line_is_known_no_better_than_they_agree(rig) -> None:
    line = loose_lines(8, seed=22)
    matches = tracks_of(rig, line, sigma_px=0.2)
    off = matches.fragments_px.copy()
    way = off[:, 0, 1] - off[:, 0, 0]
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.linalg.norm(way, axis=1)[:, None]
    off[:, 0] += normal[:, None]
    agree = join_collinear(matches, rig)
    differ = join_collinear(dataclasses.replace(matches, fragments_px=off), rig)
    own, wider = (
        [
            np.trace(across_of(*each)[1])
            for each in zip(joined.lines_mm, joined.covariance_mm2, line, strict=True)
        ]
        for joined in (agree, differ)
    )
    ratio = np.array(wider) / own
    assert ratio.min() > 1
    assert np.median(ratio) > 3


def test_order_of_tracks_and_of_ends_changes_only_the_numbering(rig) -> None:
    pieces = pieces_of(loose_lines(30, seed=8), (0.0, 0.45), (0.5, 1.0))
    matches = tracks_of(rig, pieces, seed=3)
    rank = np.random.default_rng(1).permutation(60)
    assert matches.fragments_covariance_px2 is not None
    again = dataclasses.replace(
        matches,
        index=matches.index[rank][:, ::-1],
        views=VIEWS[::-1],
        fragments_px=matches.fragments_px[rank][:, ::-1],
        fragments_covariance_px2=matches.fragments_covariance_px2[rank][:, ::-1],
        lines_mm=matches.lines_mm[rank],
        covariance_mm2=matches.covariance_mm2[rank],
    )
    joined, turned = join_collinear(matches, rig), join_collinear(again, rig)
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
    one = loose_lines(30, seed=9)
    rng = np.random.default_rng(2)
    way = one[:, 1] - one[:, 0]
    shift = np.cross(way, rng.normal(size=way.shape))
    shift *= rng.uniform(1.5, 6.0, (30, 1)) / np.linalg.norm(shift, axis=1, keepdims=True)
    along = rng.choice([0.0, 0.4, 1.02], (30, 1)) * way
    joined = join_collinear(
        tracks_of(rig, np.concatenate([one, one + (shift + along)[:, None]])), rig
    )
    assert (joined.pieces == 1).all()
    assert len(joined) == 60


def test_a_segment_of_two_tracks_counts_once(rig) -> None:
    whole = loose_lines(10, seed=10)
    matches = tracks_of(rig, pieces_of(whole, (0.0, 0.45), (0.55, 1.0)))
    complete = tracks_of(rig, whole)
    assert matches.fragments_covariance_px2 is not None
    assert complete.fragments_covariance_px2 is not None
    # One view shows the line in one segment, of which each track has the part that is its own.
    index, covariance = matches.index.copy(), matches.fragments_covariance_px2.copy()
    index[:, 0] = np.tile(np.arange(10), 2)
    fragments = matches.fragments_px[:, 0].reshape(2, 10, 2, 2)
    segment, own = complete.fragments_px[:, 0], complete.fragments_covariance_px2[:, 0]
    step = segment[:, 1] - segment[:, 0]
    place = ((fragments - segment[:, 0, None]) * step[:, None]).sum(axis=3)
    place = place / (step**2).sum(axis=1)[:, None]
    weight = np.stack([1 - place, place], axis=3)
    spread = np.einsum("knef,ij->kneifj", weight, np.eye(2)).reshape(2, 10, 4, 4)
    covariance[:, 0] = (spread @ own @ spread.mT).reshape(20, 4, 4)
    # Along the fitted covariance has room enough to be inverted.
    shared = _matches(rig, index, matches.fragments_px, covariance)
    joined = join_collinear(shared, rig, tuning=AS_STATED)
    assert same_lines(joined, 10)
    assert (joined.degrees == 2 * 5 - 4).all()
    for line in range(10):
        apart = tracks_of(rig, pieces_of(whole[line : line + 1], (0.0, 0.45), (0.55, 1.0)))
        expected = join_collinear(apart, rig, tuning=AS_STATED)
        _, most = across_of(expected.lines_mm[0], expected.covariance_mm2[0], whole[line])
        _, found = across_of(joined.lines_mm[line], joined.covariance_mm2[line], whole[line])
        # The one segment also shows what the others leave out, a tenth of it.
        assert 0.8 < np.trace(found) / np.trace(most) < 1.0 + 1e-9


def test_gaps_and_overlaps_are_where_tracks_leave_them(rig) -> None:
    whole = loose_lines(1, seed=11)
    length = np.linalg.norm(whole[0, 1] - whole[0, 0])
    joined = join_collinear(
        tracks_of(rig, pieces_of(whole, (0.0, 0.4), (0.35, 0.6), (0.7, 1.0))), rig
    )
    assert same_lines(joined, 1)
    np.testing.assert_allclose(joined.place_mm[:, 0].min(), 0.0, atol=1e-6)
    gaps, overlaps = joined.gaps_mm(0) / length, joined.overlaps_mm(0) / length
    if joined.tracks_of(0)[0] != 0:
        gaps, overlaps = 1 - gaps[:, ::-1], 1 - overlaps[:, ::-1]
    np.testing.assert_allclose(gaps, [[0.6, 0.7]], atol=1e-3)
    np.testing.assert_allclose(overlaps, [[0.35, 0.4]], atol=1e-3)


def corners_of_lines(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(corner of each of `count`, three lines from each (3 count, 2, 3) whose first end it is)."""
    rng = np.random.default_rng(seed)
    point = rng.uniform([-60, -50, 0], [60, 50, 40], (count, 3))
    way = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    far = point[:, None] + rng.uniform(18, 30, (count, 3, 1)) * way
    lines = np.stack([np.broadcast_to(point[:, None], far.shape), far], axis=2)
    return point, lines.reshape(-1, 2, 3)


def lines_alone(matches: Matches, rig: Rig) -> JoinedLines:
    joined = join_collinear(matches, rig, tuning=AS_STATED)
    assert len(joined) == len(matches)
    return joined


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
        way = joined.lines_mm[line, 1] - joined.lines_mm[line, 0]
        axes = axes_across(way / np.linalg.norm(way))
        own, snapped = (
            axes @ covariance[line].reshape(2, 3, 2, 3)[end, :, end] @ axes.T
            for covariance in (joined.covariance_mm2, corners.lines_covariance_mm2)
        )
        # But for the few pixels by which the end has moved out.
        assert np.linalg.eigvalsh(1.3 * own - snapped).min() > 0


def _at_one_corner(corners: Corners) -> np.ndarray:
    line, count = np.unique(corners.line, return_counts=True)
    return line[count == 1]


def test_snapping_what_is_snapped_moves_nothing(rig) -> None:
    _, lines = corners_of_lines(10, seed=14)
    joined = lines_alone(tracks_of(rig, lines, seed=9), rig)
    corners = snap_corners(joined)
    again = snap_corners(dataclasses.replace(joined, lines_mm=corners.lines_mm))
    assert len(again) >= len(corners) > 7
    table = {
        (int(a), int(b)): c for a, b, c in zip(again.line, again.end, again.corner, strict=True)
    }
    for line, end, corner in zip(corners.line, corners.end, corners.corner, strict=True):
        np.testing.assert_allclose(
            again.points_mm[table[int(line), int(end)]], corners.points_mm[corner], atol=1e-7
        )


def test_ends_that_pass_each_other_do_not_meet(rig) -> None:
    # Two lines cross at a right angle, 3 mm apart, which is ten standard deviations and more.
    one = np.array([[0.0, 0.0, 10.0], [25.0, 0.0, 10.0]])
    other = np.array([[0.0, 0.0, 13.0], [0.0, 25.0, 13.0]])
    joined = lines_alone(tracks_of(rig, np.stack([one, other])), rig)
    assert len(snap_corners(joined)) == 0
    met = lines_alone(tracks_of(rig, np.stack([one, other - [0.0, 0.0, 3.0]])), rig)
    corners = snap_corners(met)
    np.testing.assert_allclose(corners.points_mm, [[0.0, 0.0, 10.0]], atol=1e-5)


def test_fragments_are_taken_where_the_lens_shows_them(rig) -> None:
    pieces = pieces_of(loose_lines(10, seed=15), (0.0, 0.5), (0.55, 1.0))
    matches = tracks_of(rig, pieces, seed=4)
    bent = rig_of(*VIEWS, distortion=(-0.6, 0.1, 0.002, -0.002, 0.0))
    seen = np.stack(
        [
            distorted(bent[name].intrinsics, matches.fragments_px[:, view])
            for view, name in enumerate(VIEWS)
        ],
        axis=1,
    )
    assert np.abs(seen - matches.fragments_px).max() > 1
    joined = join_collinear(matches, rig)
    again = join_collinear(dataclasses.replace(matches, fragments_px=seen), bent)
    np.testing.assert_array_equal(again.line_of_track, joined.line_of_track)
    np.testing.assert_allclose(again.lines_mm, joined.lines_mm, atol=1e-5)


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
