"""Segments that do not belong to their rig are SUSPECT; segments that do are not."""

import re
from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

from simulation import Detector, loose_segments, simulate_segments
from simulation.scenes import see_through_boxes
from tests.io.formats.bench import bench_matches
from tests.match.made import loose_lines, pictures
from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.batch import match_many
from trinoc.match.decoys import (
    SureTracks,
    check_set,
    count_sure,
    is_above_chance,
)
from trinoc.match.explanations import (
    MIRRORED,
    TURNED,
    UPSIDE_DOWN,
    change_view,
    estimate_shift,
    seems_shifted,
    take_longest,
)
from trinoc.match.matcher import check_verification, match_segments
from trinoc.match.observations.match_input import prepare_frame
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, MatchStatus
from trinoc.match.tracks.reliability import depth_range_remedy
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.synth import table1_rig

RIG = table1_rig()
SIZE = np.array([512.0, 480.0])
DETECTOR = Detector(shortest_px=8.0)


def made(scene, seed):
    return dict(simulate_segments(scene, RIG, DETECTOR, seed=seed)[0])


@pytest.fixture(scope="module")
def boxes():
    return made(see_through_boxes(31, count=5), seed=31)


def test_a_right_set_is_matched(boxes):
    assert match_segments(boxes, RIG).status is MatchStatus.MATCHED


def test_exchanged_views_are_suspect_by_name_and_nothing_in_them_is_sure(boxes):
    exchanged = boxes | {"upper": boxes["left"], "left": boxes["upper"]}
    matches = match_segments(exchanged, RIG)
    assert matches.status is MatchStatus.SUSPECT
    assert "are exchanged" in matches.notes[0]
    assert '"right"' not in matches.notes[0]
    assert (matches.posterior < 0.9).all()


def test_a_quick_check_refuses_a_set_without_the_mistake_and_none_refuses_nothing(boxes):
    exchanged = boxes | {"upper": boxes["left"], "left": boxes["upper"]}
    quick = match_segments(exchanged, RIG, verify="quick")
    assert quick.status is MatchStatus.SUSPECT
    assert "Probably" not in quick.notes[0]
    unchecked = match_segments(exchanged, RIG, verify="off")
    assert unchecked.status is not MatchStatus.SUSPECT
    np.testing.assert_array_equal(unchecked.index, quick.index)
    with pytest.raises(InputError, match='verify is "never": give "full", "quick" or "off"'):
        check_verification("never")


def test_of_many_sets_of_a_rig_the_mistake_is_looked_for_once(boxes):
    exchanged = boxes | {"upper": boxes["left"], "left": boxes["upper"]}
    batch = match_many([boxes, exchanged, exchanged], RIG)
    checked = [matches for matches in batch.matches if matches is not None]
    assert [m.status for m in checked] == [MatchStatus.MATCHED] + 2 * [MatchStatus.SUSPECT]
    named = ["Probably" in m.notes[0] for m in checked[1:]]
    assert named == [True, False]


def with_clutter(segments, count):
    """The same segments and `count` more in each view that show no line."""
    rng, cluttered = np.random.default_rng(7), {}
    for name, view_segments in segments.items():
        middle, angle = rng.uniform(20, 450, (count, 1, 2)), rng.uniform(0, np.pi, count)
        half = 15 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        strays = middle + np.stack([-half, half], axis=1)
        cluttered[name] = Segments.from_endpoints(
            np.concatenate([view_segments.endpoints_px, strays])
        )
    return cluttered


def test_lines_that_are_next_to_certain_clear_a_cluttered_set_without_another_matching(boxes):
    """This holds however small their share of the segments is."""
    cluttered = with_clutter(boxes, 400)
    frame = prepare_frame(cluttered, RIG, None)
    matches = match_segments(cluttered, RIG, verify="off")
    sure = count_sure(matches)
    assert sure.three_view < DEFAULT.decoys.clear_share * min(map(len, cluttered.values()))
    assert sure.near_certain >= DEFAULT.decoys.clear_certain

    def match(frame, **kwargs):
        raise AssertionError("matched again")

    checked = check_set(frame, RIG.names, matches, match, DEFAULT.decoys)
    assert checked.status is MatchStatus.MATCHED


@pytest.mark.parametrize("view", range(3))
def test_a_shift_shows_in_what_segments_miss_the_lines_of_the_other_views_by(view):
    """Noise of any size does not seem a shift."""
    lines_mm, random = loose_lines(40, seed=3), np.random.default_rng(4)
    index = np.tile(np.arange(40)[:, None], (1, 3))
    for noise_px, shift_px, shifted in ((12.0, (0, 0), False), (0.3, (6, -4), True)):
        pictures_px = pictures(RIG, lines_mm, noise_px, seed=5)
        name = RIG.names[view]
        pictures_px[name] = pictures_px[name] + shift_px
        frame = prepare_frame(pictures_px, RIG, None)
        numbers = [np.argsort(order) for order in frame.order]
        rows = np.stack([number[index[:, 0]] for number in numbers], axis=1)
        rows = random.permutation(rows)
        assert seems_shifted(frame, rows, DEFAULT.decoys) is shifted


def test_depths_that_leave_out_the_scene_are_named_and_not_the_rig(boxes):
    matches = match_segments(boxes, RIG, depth_range_mm=(0.3, 0.6))
    assert matches.status is MatchStatus.SUSPECT
    assert "Check depth_range_mm" in matches.notes[0]
    assert depth_range_remedy(match_segments(boxes, RIG)) is None


@pytest.mark.parametrize(
    "matrix",
    [
        pytest.param(-np.eye(2), id="turned"),
        pytest.param(np.diag([-1.0, 1.0]), id="mirrored"),
    ],
)
def test_a_view_that_is_turned_is_suspect_by_name(boxes, matrix):
    ends = np.asarray(boxes["right"].endpoints_px) @ matrix.T + (SIZE - 1) * (np.diag(matrix) < 0)
    matches = match_segments(boxes | {"right": Segments.from_endpoints(ends)}, RIG)
    assert matches.status is MatchStatus.SUSPECT
    word = "mirrored" if np.linalg.det(matrix) < 0 else "upside down"
    assert f'the image of "right" is {word}' in matches.notes[0]


def changed(segments, scale, shift_px):
    ends = scale * np.asarray(segments.endpoints_px) + shift_px
    inside = ((ends > -0.5) & (ends < SIZE - 0.5)).all(axis=(1, 2))
    return Segments.from_endpoints(ends[inside])


@pytest.mark.parametrize(
    "shift_px", [(-4, 3), pytest.param((37, 23), marks=pytest.mark.slow)], ids=str
)
def test_a_shifted_view_is_suspect_by_name_and_by_how_much(boxes, shift_px):
    matches = match_segments(boxes | {"left": changed(boxes["left"], 1, shift_px)}, RIG)
    assert matches.status is MatchStatus.SUSPECT
    reported_shift = re.search(
        r'"left" is shifted by about \((-?\d+), (-?\d+)\) px', matches.notes[0]
    )
    assert reported_shift is not None
    np.testing.assert_allclose(
        [int(number) for number in reported_shift.groups()], shift_px, atol=1
    )
    assert (matches.posterior <= 0.5).all()


def test_segments_of_a_picture_of_half_the_size_are_suspect_by_name(boxes):
    matches = match_segments(boxes | {"left": changed(boxes["left"], 0.5, -0.25)}, RIG)
    assert matches.status is MatchStatus.SUSPECT
    assert '"left" come from an image of half the size' in matches.notes[0]
    assert (matches.posterior <= 0.5).all()


@pytest.mark.slow
def test_all_pictures_of_half_the_size_are_suspect_by_name(boxes):
    matches = match_segments({v: changed(s, 0.5, -0.25) for v, s in boxes.items()}, RIG)
    assert matches.status is MatchStatus.SUSPECT
    assert "pictures of half the size of the cameras'" in matches.notes[0]
    assert (matches.posterior <= 0.5).all()


def test_a_right_set_with_noise_far_above_what_is_stated_is_not_suspect(boxes):
    matches = match_segments(boxes, RIG, sigma_px=0.15)
    assert matches.noise_scale > DEFAULT.decoys.noisy_above
    assert matches.status is MatchStatus.UNCERTAIN
    assert (matches.posterior > 0.9).mean() > 0.9


def test_a_shift_is_where_ends_differ_alike():
    rng = np.random.default_rng(3)
    middle, half = rng.uniform(50, 450, (80, 1, 2)), rng.uniform(-30, 30, (80, 1, 2))
    expected = np.concatenate([middle - half, middle + half], axis=1)
    shift = np.array([-21.0, 34.0])
    shifted_px = expected + shift + rng.normal(0, 0.3, expected.shape)
    # In another order, with ends the other way round, half of them gone and as many of no line.
    shifted_px = np.concatenate([shifted_px[::-2, ::-1], rng.uniform(50, 450, (40, 2, 2))])
    estimate = estimate_shift(expected, shifted_px, DEFAULT.decoys)
    assert estimate is not None
    np.testing.assert_allclose(estimate, shift, atol=0.3)
    assert estimate_shift(expected, np.zeros((0, 2, 2)), DEFAULT.decoys) is None


def test_the_longest_segments_are_a_set_of_their_own(boxes):
    frame = prepare_frame(boxes, RIG, None)
    part = take_longest(frame, 30)
    for all_ends, part_ends, order in zip(frame.ends_px, part.ends_px, part.order, strict=True):
        length, part_length = (
            np.linalg.norm(np.diff(e, axis=1)[:, 0], axis=1) for e in (all_ends, part_ends)
        )
        np.testing.assert_array_equal(np.sort(part_length), np.sort(length)[-30:])
        np.testing.assert_array_equal(order, np.arange(30))


@pytest.mark.slow
def test_a_view_of_another_scene_is_suspect(boxes):
    other = made(loose_segments(32, count=100), seed=32)
    matches = match_segments(boxes | {"left": other["left"]}, RIG)
    assert matches.status is MatchStatus.SUSPECT
    assert (matches.posterior < 0.9).all()


def test_segments_that_are_chance_alone_are_suspect():
    rng, segments = np.random.default_rng(5), {}
    for view in RIG.names:
        middle, angle = rng.uniform(20, 450, (120, 1, 2)), rng.uniform(0, np.pi, 120)
        half = 8 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        segments[view] = Segments.from_endpoints(middle + np.stack([-half, half], axis=1))
    matches = match_segments(segments, RIG)
    assert matches.status is MatchStatus.SUSPECT
    assert (matches.posterior < 0.9).mean() > 0.99


def test_a_few_tracks_that_are_next_to_certain_tell_where_chance_gives_none():
    chance = [SureTracks(4, 0), SureTracks(5, 1), SureTracks(3, 0)]
    for certain, above in ((0, False), (2, False), (10, True)):
        tracks = SureTracks(11, certain)
        assert is_above_chance(tracks, chance, 0.2, DEFAULT.decoys) is above
    assert is_above_chance(SureTracks(60, 0), chance, 0.6, DEFAULT.decoys)
    # The same number is no more than chance where decoys have as many.
    as_many = [tracks_of_decoy._replace(near_certain=10) for tracks_of_decoy in chance]
    assert not is_above_chance(SureTracks(11, 10), as_many, 0.2, DEFAULT.decoys)


@pytest.mark.parametrize("change", [MIRRORED, UPSIDE_DOWN, TURNED])
def test_a_view_turned_twice_is_as_it_was(boxes, change):
    frame = prepare_frame(boxes, RIG, None)
    turned_twice = change_view(change_view(frame, 1, change), 1, change)
    assert (frame.ends_px[1] != change_view(frame, 1, change).ends_px[1]).any()
    for name in ("order", "ends_px", "covariance_px2", "polarity", "sides"):
        np.testing.assert_allclose(
            getattr(turned_twice, name)[1], getattr(frame, name)[1], atol=1e-9
        )


def test_a_turned_view_and_a_camera_turned_alike_give_the_same_lines(boxes):
    """If picture and camera matrix are turned about the middle, the lines stay the same."""
    middle, turn = (SIZE - 1) / 2, np.eye(3)
    turn[:2, :2], turn[:2, 2] = TURNED, middle - TURNED @ middle
    matrices = {name: np.asarray(RIG[name].matrix_px) for name in RIG.names}
    rig = Rig.from_matrices(matrices, (512, 480))
    frame = prepare_frame(boxes, rig, None)
    view = frame.names.index("upper")
    turned = change_view(frame, view, TURNED)
    back = np.argsort(turned.order[view])
    turned_segments = eqx.tree_at(
        lambda s: (s.endpoints_px, s.covariance_px2, s.polarity),
        boxes["upper"],
        tuple(
            column[view][back]
            for column in (turned.ends_px, turned.covariance_px2, turned.polarity)
        ),
    )
    other = Rig.from_matrices(matrices | {"upper": turn @ matrices["upper"]}, (512, 480))
    plain, turned_matches = (
        match_segments(boxes, rig),
        match_segments(boxes | {"upper": turned_segments}, other),
    )
    np.testing.assert_array_equal(turned_matches.index, plain.index)
    sorted_ends_mm = np.sort(turned_matches.lines_mm, axis=1), np.sort(plain.lines_mm, axis=1)
    np.testing.assert_allclose(sorted_ends_mm[0], sorted_ends_mm[1], atol=1e-3)


def test_the_darker_side_stays_on_the_right_where_picture_and_ends_are_both_turned():
    ends = np.array([[[100.0, 200.0], [300.0, 240.0]], [[50.0, 50.0], [50.0, 90.0]]])
    dark = eqx.tree_at(lambda s: s.polarity, Segments.from_endpoints(ends), np.array([1, 1]))
    views = {name: Segments.from_endpoints(ends + 9 * k) for k, name in enumerate(RIG.names)}
    frame = prepare_frame(views | {"upper": dark}, RIG, None)
    view = frame.names.index("upper")
    for change in (MIRRORED, UPSIDE_DOWN, TURNED):
        changed_frame = change_view(frame, view, change)
        for ends_px, sign, row in zip(
            changed_frame.ends_px[view], changed_frame.polarity[view], changed_frame.order[view]
        ):
            # A point beside the segment on its dark side stays on the dark side.
            first, second = ends[row]
            across = np.array([-(second - first)[1], (second - first)[0]])
            dark_point = (first + second) / 2 + across / np.linalg.norm(across)
            dark_point = change @ (dark_point - (SIZE - 1) / 2) + (SIZE - 1) / 2
            direction = ends_px[1] - ends_px[0]
            side = (
                direction[0] * (dark_point - ends_px[0])[1]
                - direction[1] * (dark_point - ends_px[0])[0]
            )
            assert np.sign(side) == sign


def test_the_share_in_three_views_is_of_the_view_that_shows_least() -> None:
    """A segment counts once, however many tracks it has, and only in sure tracks of three views."""
    matches = bench_matches(6)
    index = np.array([[0, 0, 0], [1, 0, 1], [2, 2, 2], [3, 3, -1], [4, 4, 4], [5, 5, 5]])
    stage = np.where((index >= 0).all(axis=1), TRINOCULAR, BINOCULAR)
    posterior = np.array([0.99, 0.99, 0.95, 0.99, 0.5, 0.89])
    segments = {name: np.full(count, "matched") for name, count in zip(matches.views, (6, 8, 10))}
    matches = replace(matches, index=index, stage=stage, posterior=posterior, reasons=segments)
    # Segments 0, 1, 2 of 6; 0, 2 of 8; 0, 1, 2 of 10.
    assert matches.share_in_three_views == pytest.approx(2 / 8)
