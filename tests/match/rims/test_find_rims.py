"""Rims from chords: exact chords, noisy chords, no chords, and the changed matches."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from simulation.solids import Cylinder
from tests.match.made import loose_lines, pictures, rig_of
from tests.match.rims.made_rims import Ring, chords_seen, projected
from trinoc.errors import InputError
from trinoc.match import MatchTuning, add_rims, find_rims
from trinoc.match.matcher import match_segments
from trinoc.match.rims import rim_search as search, rim_support as support
from trinoc.match.rims.circles import Circles, image_circles
from trinoc.match.tuning.rims import RimTuning

VIEWS = ("upper", "left", "right")
FLAT = Ring((20.0, -15.0, 30.0), (0.0, 0.0, 1.0), 14.0)
TILTED = Ring((-35.0, 12.0, 15.0), (0.2, -0.1, 1.0), 9.0)


@pytest.fixture(scope="module")
def rig():
    return rig_of(*VIEWS)


def test_exact_chords_leave_their_circles(rig) -> None:
    lines = loose_lines(8, seed=1)
    segments = chords_seen(rig, [FLAT, TILTED], lines)
    matches = match_segments(segments, rig)
    rims = find_rims(matches, segments, rig)
    assert len(rims) == 2
    for row, ring in enumerate((FLAT, TILTED)):
        # A chord crosses its ellipse where it crosses the parabola, to the third order.
        np.testing.assert_allclose(rims.centre_mm[row], ring.centre_mm, atol=0.05)
        assert abs(rims.normal[row] @ ring.normal) > 1 - 1e-5
        assert rims.radius_mm[row] == pytest.approx(ring.radius_mm, abs=0.02)
        assert rims.covered[row] > 0.9
        for chords in rims.segments_of(row).values():
            assert sorted(chords.tolist()) == list(range(14 * row, 14 * (row + 1)))
    # Pieces lie on their rims, and do not overlap; tracks of lines are as they were.
    pieces = rims.matches.lines_mm[len(rims.kept) :]
    off = [
        np.abs(np.linalg.norm(pieces - ring.centre_mm, axis=2) - ring.radius_mm)
        for ring in (FLAT, TILTED)
    ]
    assert np.minimum(*off).max() < 0.06
    round_mm = 2 * np.pi * (FLAT.radius_mm + TILTED.radius_mm)
    assert 0.85 * round_mm < np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).sum() < round_mm
    np.testing.assert_array_equal(
        rims.matches.lines_mm[: len(rims.kept)], matches.lines_mm[rims.kept]
    )
    for view in range(3):
        piece_segments = rims.matches.index[len(rims.kept) :, view]
        assert set(piece_segments.tolist()) <= {-1, *range(28)}
        on = np.flatnonzero(piece_segments >= 0) + len(rims.kept)
        image = projected(np.asarray(rig[matches.views[view]].matrix_px), rims.matches.lines_mm[on])
        assert np.abs(rims.matches.fragments_px[on, view] - image).max() < 2.0


def test_few_neighbours_and_small_parts_find_the_same(rig, monkeypatch) -> None:
    segments = chords_seen(rig, [FLAT, TILTED], loose_lines(8, seed=1))
    matches = match_segments(segments, rig)
    rims = find_rims(matches, segments, rig)
    for room in (search, support):
        monkeypatch.setattr(room, "ENTRIES_AT_A_TIME", 1000)
    monkeypatch.setattr(search, "MAX_NEIGHBOURS", 12)
    rims_by_parts = find_rims(matches, segments, rig)
    assert len(matches) > 13
    np.testing.assert_allclose(rims_by_parts.centre_mm, rims.centre_mm, atol=1e-6)
    np.testing.assert_array_equal(rims_by_parts.segment, rims.segment)


def test_errors_are_those_of_their_covariance(rig) -> None:
    exact = chords_seen(rig, [FLAT])
    matches, squares = match_segments(exact, rig), []
    for seed in range(4):
        segments = chords_seen(rig, [FLAT], sigma_px=0.2, seed=seed)
        rims = find_rims(matches, segments, rig)
        assert len(rims) == 1
        error = np.array([*(rims.centre_mm[0] - FLAT.centre_mm), rims.radius_mm[0] - 14.0])
        rows = np.array([0, 1, 2, 6])
        covariance = rims.covariance_mm2[0][np.ix_(rows, rows)]
        squares.append(error @ np.linalg.solve(covariance, error))
    # Four numbers of each of four.
    assert chi2.ppf(0.001, 16) < np.sum(squares) < chi2.ppf(0.999, 16)


def test_lines_make_no_rims(rig) -> None:
    segments = chords_seen(rig, [], loose_lines(60, seed=3))
    matches = match_segments(segments, rig)
    rims = find_rims(matches, segments, rig)
    assert len(rims) == 0
    assert len(rims.matches) == len(matches)
    assert not rims.matches.marks["silhouette"].any()


def test_views_and_segments_in_another_order_leave_the_same(rig) -> None:
    segments = chords_seen(rig, [FLAT], loose_lines(8, seed=1), sigma_px=0.1)
    rims = find_rims(match_segments(segments, rig), segments, rig)
    turned = {
        name: np.asarray(segments[name].endpoints_px)[::-1, ::-1].reshape(-1, 4)
        for name in reversed(VIEWS)
    }
    reordered = find_rims(match_segments(turned, rig, sigma_px=0.2), turned, rig)
    np.testing.assert_allclose(reordered.centre_mm, rims.centre_mm, atol=1e-3)
    np.testing.assert_allclose(reordered.radius_mm, rims.radius_mm, atol=1e-3)


def test_outlines_below_a_rim_are_marked(rig) -> None:
    body = Cylinder(np.zeros(3), 14.0, 30.0)
    ring = Ring((0.0, 0.0, 30.0), (0.0, 0.0, 1.0), 14.0)
    segments = chords_seen(rig, [ring])
    outlines = {
        name: projected(
            np.asarray(camera.matrix_px), body.silhouette_mm(np.asarray(camera.centre_world_mm))
        )
        for name, camera in rig.items()
    }
    both = {
        name: np.concatenate([np.asarray(segments[name].endpoints_px), outlines[name]]).reshape(
            -1, 4
        )
        for name in segments
    }
    # The outlines of a thick body do not match; wrong tracks of theirs, and of one with a chord.
    matches = match_segments(both, rig)
    wrong = np.array([[-1, 14, 14], [15, 15, -1], [14, -1, 3]])
    last = np.full(len(wrong), len(matches) - 1)
    rows = {
        name: np.concatenate([value, value[last]])
        for name, value in vars(matches).items()
        if isinstance(value, np.ndarray)
    }
    rows["index"] = np.concatenate([matches.index, wrong])
    rims = find_rims(dataclasses.replace(matches, **rows), both, rig)
    assert len(rims) == 1
    has_outlines = (rims.matches.index >= 14).sum(axis=1) >= 2
    assert has_outlines.sum() == 2
    np.testing.assert_array_equal(rims.matches.marks["silhouette"] > 0.5, has_outlines)


def test_views_without_segments_are_named(rig) -> None:
    segments = chords_seen(rig, [FLAT])
    matches = match_segments(segments, rig)
    with pytest.raises(InputError, match='"right" has none'):
        find_rims(matches, {name: segments[name] for name in VIEWS[:2]}, rig)


def test_rims_stand_beside_matches_of_straight_edges(rig) -> None:
    chords = chords_seen(rig, [FLAT], loose_lines(8, seed=1), sigma_px=0.1)
    # The other detector keeps the lines, and of the ring the first two chords.
    segments = {
        name: np.asarray(view_chords.endpoints_px)[[0, 1, *range(14, len(view_chords))]].reshape(
            -1, 4
        )
        for name, view_chords in chords.items()
    }
    rims = find_rims(match_segments(chords, rig), chords, rig)
    matches = match_segments(segments, rig)
    joined = add_rims(matches, segments, rims, chords, rig)
    first = len(joined.kept)
    np.testing.assert_array_equal(joined.matches.lines_mm[:first], matches.lines_mm[joined.kept])
    np.testing.assert_array_equal(joined.matches.index[:first], matches.index[joined.kept])
    assert (joined.matches.index[:first] >= 2)[joined.matches.index[:first] >= 0].all()
    pieces, rim_pieces = joined.matches.index[first:], rims.matches.index[len(rims.kept) :]
    assert len(pieces) == len(rim_pieces) > 0
    for view, name in enumerate(matches.views):
        shown = rim_pieces[:, view] >= 0
        np.testing.assert_array_equal(
            joined.segments[name].endpoints_px[pieces[shown, view]],
            chords[name].endpoints_px[rim_pieces[shown, view]],
        )
        assert len(joined.matches.reasons[name]) == len(joined.segments[name])
        np.testing.assert_array_equal(
            joined.segments[name].endpoints_px[: len(segments[name])].reshape(-1, 4), segments[name]
        )


def test_rims_of_other_views_are_refused(rig) -> None:
    segments = chords_seen(rig, [FLAT])
    rims = find_rims(match_segments(segments, rig), segments, rig)
    two = {name: segments[name] for name in VIEWS[:2]}
    with pytest.raises(
        InputError, match="upper, left, right, but the matches are of the views upper, left"
    ):
        add_rims(match_segments(two, rig), two, rims, segments, rig)


def brick_wall(seed: int) -> np.ndarray:
    """(200, 2, 3) short level lines, in rows, of a wall in front of the cameras."""
    random = np.random.default_rng(seed)
    height = np.repeat(np.linspace(-60, 60, 25), 8)
    begin = random.uniform(-80, 60, len(height))
    length = random.uniform(5, 14, len(height))
    ends = [np.stack([x, height, np.full(len(x), 20.0)], axis=1) for x in (begin, begin + length)]
    return np.stack(ends, axis=1)


def test_rows_of_bricks_are_no_circles_seen_edge_on(rig) -> None:
    segments = pictures(rig, brick_wall(seed=1), sigma_px=0.5)
    matches = match_segments(segments, rig, sigma_px=0.5)
    assert len(matches) > 100
    edge_on = MatchTuning(rims=RimTuning(min_axis_ratio=0.0))
    assert len(find_rims(matches, segments, rig, tuning=edge_on)) > 0
    assert len(find_rims(matches, segments, rig)) == 0


def test_a_circle_facing_the_camera_is_round_and_one_in_a_plane_through_it_flat(rig) -> None:
    camera = rig["upper"]
    centre = np.asarray(camera.centre_world_mm)
    sight = centre / np.linalg.norm(centre)
    across = np.cross(sight, [0.3, 0.5, 0.8])
    normals = np.stack([sight, across / np.linalg.norm(across)])
    circles = Circles(np.zeros((2, 3)), normals, np.array([10.0, 10.0]))
    ratio = image_circles(circles, np.asarray(camera.matrix_px)).axis_ratio
    # Pixels are wider than high.
    along_x, along_y = np.asarray(camera.intrinsics.focal_length_px)
    np.testing.assert_allclose(ratio, [along_x / along_y, 0.0], atol=0.02)


def test_two_views_make_a_rim_of_a_circle_and_none_of_short_arcs(rig) -> None:
    all_views = chords_seen(rig, [FLAT], loose_lines(8, seed=1))
    two = {name: all_views[name] for name in VIEWS[:2]}
    matches = match_segments(two, rig)
    rims = find_rims(matches, two, rig)
    assert len(rims) == 1
    pieces = rims.matches.posterior[len(rims.kept) :]
    np.testing.assert_array_equal(pieces, RimTuning().posterior)
    # A third of each ring, and the lines.
    part = {
        name: view_chords.take(np.r_[0:5, 14 : len(view_chords)])
        for name, view_chords in two.items()
    }
    lax_tuning = dataclasses.replace(RimTuning(), min_covered_share=0.1)
    lax = find_rims(match_segments(part, rig), part, rig, tuning=MatchTuning(rims=lax_tuning))
    assert len(lax) == 1
    assert len(find_rims(match_segments(part, rig), part, rig)) == 0


def test_one_of_many_equal_circles_in_a_row_is_not_guessed_by_two_views(rig) -> None:
    # Left and right stand side by side, so that their epipolar planes run along the row.
    row = [Ring((20.0 * x, 5.0, 10.0), (0.0, 0.0, 1.0), 7.0) for x in (-1.5, -0.5, 0.5, 1.5)]
    chords = chords_seen(rig, row, sigma_px=0.1)
    matches = match_segments(chords, rig)
    assert len(find_rims(matches, chords, rig)) == 4
    two = {name: chords[name] for name in VIEWS[1:]}
    alone = find_rims(match_segments(two, rig), two, rig)
    assert len(alone) == 0
    assert alone.counts["rims of two views that fit another as well"] > 0
