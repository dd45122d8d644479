"""Guarantees of the matcher for every scene."""

import jax
import numpy as np
import pytest

from simulation import Detector, simulate_segments
from simulation.scenes import see_through_boxes
from tests.match.made import as_set, loose_lines, pictures, rig_of
from trinoc.errors import InputError, MatchError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.answers import unmatched_reasons
from trinoc.synth import table1_rig

VIEWS = ("upper", "left", "right")


@pytest.fixture(scope="module")
def noisy() -> tuple[Rig, np.ndarray, dict[str, np.ndarray]]:
    rig, lines = rig_of(*VIEWS), loose_lines(40, seed=1)
    return rig, lines, pictures(rig, lines, sigma_px=0.3, seed=2)


def test_exact_lines_are_all_found_and_placed() -> None:
    rig, lines = rig_of(*VIEWS), loose_lines(40, seed=3)
    matches = match_segments(pictures(rig, lines), rig, sigma_px=0.1)
    assert as_set(matches, VIEWS) == {(k, k, k) for k in range(40)}
    truth = lines[matches.index[:, 0]]
    swap = ((matches.lines_mm - truth) ** 2).sum((1, 2)) > (
        (matches.lines_mm[:, ::-1] - truth) ** 2
    ).sum((1, 2))
    lines_mm = np.where(swap[:, None, None], matches.lines_mm[:, ::-1], matches.lines_mm)
    np.testing.assert_allclose(lines_mm, truth, atol=1e-6)


def test_order_of_segments_of_ends_and_of_views_changes_only_the_numbering(noisy) -> None:
    rig, _, pictures_px = noisy
    rng = np.random.default_rng(5)
    matches = match_segments(pictures_px, rig)
    ranks = {name: rng.permutation(len(pictures_px[name])) for name in VIEWS}
    turned = {}
    for name in VIEWS[::-1]:
        ends = pictures_px[name][ranks[name]]
        swap = rng.random(len(ends)) < 0.5
        turned[name] = np.where(swap[:, None, None], ends[:, ::-1], ends)
    reordered = match_segments(turned, rig)
    assert reordered.views == VIEWS[::-1]
    numbered = np.stack(
        [ranks[n][reordered.index[:, reordered.views.index(n)]] for n in VIEWS], axis=1
    )
    numbered[reordered.index[:, ::-1] < 0] = -1
    order, reordered_order = np.lexsort(matches.index.T), np.lexsort(numbered.T)
    np.testing.assert_array_equal(matches.index[order], numbered[reordered_order])
    np.testing.assert_array_equal(matches.lines_mm[order], reordered.lines_mm[reordered_order])
    np.testing.assert_array_equal(matches.posterior[order], reordered.posterior[reordered_order])
    assert matches.viewpoint_dependent is not None
    assert reordered.viewpoint_dependent is not None
    np.testing.assert_array_equal(
        matches.viewpoint_dependent[order], reordered.viewpoint_dependent[reordered_order]
    )


def test_names_of_cameras_change_nothing(noisy) -> None:
    rig, _, pictures_px = noisy
    new = dict(zip(VIEWS, ("b", "c", "a"), strict=True))
    renamed = Rig({new[name]: rig[name] for name in VIEWS})
    matches = match_segments(pictures_px, rig)
    renamed_matches = match_segments({new[name]: pictures_px[name] for name in VIEWS}, renamed)
    assert renamed_matches.views == ("b", "c", "a")
    np.testing.assert_array_equal(matches.index, renamed_matches.index)
    np.testing.assert_array_equal(matches.lines_mm, renamed_matches.lines_mm)
    np.testing.assert_array_equal(matches.posterior, renamed_matches.posterior)


@pytest.fixture(scope="module")
def cornered() -> tuple[Rig, dict[str, Segments]]:
    """Boxes, whose edges meet at corners."""
    scene, detector = see_through_boxes(31, count=8), Detector(shortest_px=3.0)
    return table1_rig(), simulate_segments(scene, table1_rig(), detector, seed=31)[0]


@pytest.mark.parametrize("scale", [3.0, 1e3, 1e-3])
def test_lines_follow_a_change_of_the_world_and_of_its_unit(cornered, scale) -> None:
    rig, segments = cornered
    angle, shift = 0.7, scale * np.array([30.0, -10.0, 300.0])
    turn = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    to_old = np.eye(4)
    to_old[:3, :3], to_old[:3, 3] = turn.T / scale, -turn.T @ shift / scale
    rigs = [
        Rig.from_matrices(dict(zip(rig.names, matrices, strict=True)), (512, 480))
        for matrices in (rig.matrices_px, rig.matrices_px @ to_old)
    ]
    matches, moved = (match_segments(segments, world_rig) for world_rig in rigs)
    np.testing.assert_array_equal(matches.index, moved.index)
    expected = matches.lines_mm @ turn.T + shift / scale
    np.testing.assert_allclose(moved.lines_mm / scale, expected, atol=1e-5)
    np.testing.assert_allclose(matches.posterior, moved.posterior, atol=1e-6)


def test_pictures_that_all_stand_on_their_heads_give_the_same_lines(cornered) -> None:
    rig, segments = cornered
    corner = np.array([511.0, 479.0])
    turn = np.array([[-1.0, 0.0, corner[0]], [0.0, -1.0, corner[1]], [0.0, 0.0, 1.0]])
    upright = {
        name: np.asarray(view_segments.endpoints_px) for name, view_segments in segments.items()
    }
    turned = {name: corner - ends for name, ends in upright.items()}
    answers = [
        match_segments(ends, Rig.from_matrices(dict(zip(rig.names, matrices)), (512, 480)))
        for ends, matrices in ((upright, rig.matrices_px), (turned, turn @ rig.matrices_px))
    ]
    np.testing.assert_array_equal(answers[0].index, answers[1].index)
    np.testing.assert_allclose(answers[0].posterior, answers[1].posterior, atol=1e-4)


def test_fragments_lie_on_their_segments_and_image_the_line(noisy) -> None:
    rig, _, pictures_px = noisy
    matches = match_segments(pictures_px, rig)
    assert len(matches) >= 35
    for view, name in enumerate(matches.views):
        on = matches.index[:, view] >= 0
        ends = pictures_px[name][matches.index[on, view]]
        fragment = matches.fragments_px[on, view]
        assert np.isnan(matches.fragments_px[~on, view]).all()
        direction = np.diff(ends, axis=1)[:, 0]
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        across = (fragment - ends[:, :1]) @ np.array([[0, -1], [1, 0]]) @ direction[:, :, None]
        np.testing.assert_allclose(across, 0, atol=1e-9)
        image = matches.lines_mm[on] @ rig[name].matrix_px[:, :3].T + rig[name].matrix_px[:, 3]
        # The line is fitted to all views: a few sigma from each.
        np.testing.assert_allclose(image[..., :2] / image[..., 2:], fragment, atol=3.0)


def test_every_unmatched_segment_has_a_reason(noisy) -> None:
    rig, _, pictures_px = noisy
    stray = np.array([[[20.0, 30.0], [60.0, 32.0]], [[400.0, 30.0], [420.0, 80.0]]])
    pictures_px = {name: np.concatenate([ends, stray]) for name, ends in pictures_px.items()}
    matches = match_segments(pictures_px, rig)
    for view, name in enumerate(matches.views):
        matched = np.zeros(len(pictures_px[name]), dtype=bool)
        matched[matches.index[matches.index[:, view] >= 0, view]] = True
        reasons = matches.reasons[name]
        assert len(reasons) == len(pictures_px[name])
        np.testing.assert_array_equal(reasons == "matched", matched)
        assert (reasons != "").all()
    total = sum(n for word, n in matches.counts.items() if word.startswith("segments "))
    assert total == sum(len(ends) for ends in pictures_px.values())


def test_two_views_give_pairs(noisy) -> None:
    rig, _, pictures_px = noisy
    matches = match_segments({name: pictures_px[name] for name in ("left", "right")}, rig)
    assert (matches.stage == "binocular").all()
    right = matches.index[:, 0] == matches.index[:, 1]
    assert right.sum() >= 15
    assert right.mean() > 0.7
    # Two views cannot disagree.
    assert matches.misfit is not None
    assert not matches.misfit.any()


def test_five_views_give_one_track_per_line() -> None:
    views = ("upper", "left", "right", "low", "east")
    rig, lines = rig_of(*views), loose_lines(20, seed=11)
    matches = match_segments(pictures(rig, lines), rig, sigma_px=0.1)
    assert as_set(matches, views) == {(k,) * 5 for k in range(20)}
    assert (matches.stage == "trinocular").all()


@pytest.mark.slow
def test_eight_views_give_one_track_per_line() -> None:
    pans = {f"view {k}": (-50.0 + 14 * k, 45.0 + 8 * (-1) ** k, 0.0, 470.0 + k) for k in range(8)}
    rig, lines = rig_of(**pans), loose_lines(20, seed=23)
    matches = match_segments(pictures(rig, lines), rig, sigma_px=0.1)
    assert as_set(matches, tuple(pans)) == {(k,) * 8 for k in range(20)}
    image = (
        matches.lines_mm @ rig.matrices_px[:, None, :, :3].mT + rig.matrices_px[:, None, None, :, 3]
    )
    fragments = np.swapaxes(matches.fragments_px, 0, 1)
    np.testing.assert_allclose(image[..., :2] / image[..., 2:], fragments, atol=1e-5)


def test_a_line_hidden_in_one_view_is_matched_in_the_other_two() -> None:
    rig = rig_of(*VIEWS)
    corner = np.array([0.0, 0.0, 20.0])
    ends = np.array([[30, 0, 20], [0, 30, 20], [0, 0, -5], [-25, -20, 20]], dtype=float)
    lines = np.concatenate(
        [np.stack([np.broadcast_to(corner, (4, 3)), ends], axis=1), loose_lines(30, seed=13)]
    )
    pictures_px = pictures(rig, lines, sigma_px=0.1)
    pictures_px["upper"] = np.delete(pictures_px["upper"], 1, axis=0)
    matches = match_segments(pictures_px, rig, sigma_px=0.1)
    tracks = as_set(matches, VIEWS)
    assert (-1, 1, 1) in tracks
    row = np.flatnonzero((matches.index[:, 1] == 1) & (matches.index[:, 0] < 0))
    assert matches.stage[row] == "binocular"


def test_depth_range_excludes_and_says_so(noisy) -> None:
    rig, _, pictures_px = noisy
    matches = match_segments(pictures_px, rig, depth_range_mm=(10.0, 20.0))
    assert len(matches) == 0
    assert (matches.reasons["upper"] == "outside depth").sum() >= 30


def test_what_a_third_view_should_show_and_does_not_is_marked() -> None:
    # Segment 0 in nothing, 1 in a weak pair, 2 in one that the third view turned down, 3 matched.
    false, third = np.zeros(4, dtype=bool), np.array([False, False, True, True])
    reasons = unmatched_reasons(
        np.array([1, 2, 3]),
        np.array([-2.0, -1.0, 2.0]),
        false,
        false,
        np.arange(4) == 3,
        third,
        false,
    )
    assert reasons.tolist() == [
        "no partner in the zone",
        "evidence too weak",
        "missing in a third view",
        "matched",
    ]


def test_known_sides_tell_partners_from_strangers(noisy) -> None:
    rig, _, pictures_px = noisy
    dark = {}
    for name in VIEWS:
        segments = Segments.from_endpoints(pictures_px[name])
        ones = np.ones(len(segments), dtype=np.int64)
        dark[name] = Segments(
            segments.endpoints_px, segments.covariance_px2, ones, segments.contrast,
            segments.support, None,
        )  # fmt: skip
    plain, sided = match_segments(pictures_px, rig), match_segments(dark, rig)
    assert as_set(sided, VIEWS) >= as_set(plain, VIEWS) & {(k, k, k) for k in range(40)}
    both = [np.flatnonzero((m.index == k).all(axis=1)) for k in range(40) for m in (plain, sided)]
    pairs = [(p[0], s[0]) for p, s in zip(both[::2], both[1::2], strict=True) if len(p) and len(s)]
    gain = [sided.posterior[s] - plain.posterior[p] for p, s in pairs]
    assert min(gain) > -1e-3


def test_lens_distortion_is_taken_out_and_put_back() -> None:
    coefficients = (-0.2, 0.05)
    straight, bent = rig_of(*VIEWS), rig_of(*VIEWS, distortion=coefficients)
    pictures_px = pictures(straight, loose_lines(30, seed=17))
    warped = {
        name: np.stack(
            [
                np.stack([np.asarray(bent[name].intrinsics.distort_pixel(p)) for p in e])
                for e in ends
            ]
        )
        for name, ends in pictures_px.items()
    }
    matches, bent_matches = match_segments(pictures_px, straight), match_segments(warped, bent)
    np.testing.assert_array_equal(matches.index, bent_matches.index)
    np.testing.assert_allclose(matches.lines_mm, bent_matches.lines_mm, atol=1e-3)
    segment_px = warped["upper"][bent_matches.index[:, 0]]
    order = np.abs(bent_matches.fragments_px[:, 0] - segment_px).max((1, 2)) > 1
    segment_px = np.where(order[:, None, None], segment_px[:, ::-1], segment_px)
    np.testing.assert_allclose(bent_matches.fragments_px[:, 0], segment_px, atol=0.05)


@pytest.fixture(scope="module")
def compilations() -> list[str]:
    """Names of compiled programs. The list grows with every compilation."""
    names: list[str] = []

    def listen(event: str, duration_secs: float, **metadata: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            names.append(str(metadata["fun_name"]))

    jax.monitoring.register_event_duration_secs_listener(listen)
    return names


def test_another_picture_of_about_as_many_segments_compiles_nothing(noisy, compilations) -> None:
    rig, _, pictures_px = noisy
    match_segments(pictures_px, rig)
    others = pictures(rig, loose_lines(55, seed=19), sigma_px=0.3)
    compilations.clear()
    match_segments(others, rig)
    # The messages have a size by conflicts, which differ more than segments do.
    assert {name for name in compilations if "_propagated" not in name} == set()
    jax.jit(lambda number: number + len(others))(1.0)
    assert "<lambda>" in compilations[-1]


def test_nothing_to_match_is_no_error() -> None:
    rig = rig_of(*VIEWS)
    empty = match_segments({name: np.zeros((0, 4)) for name in VIEWS}, rig)
    assert len(empty) == 0
    assert empty.lines_mm.shape == (0, 2, 3)
    one = match_segments({name: np.array([[10.0, 10, 60, 20]]) for name in VIEWS}, rig)
    assert len(one.reasons["left"]) == 1


def test_what_cannot_be_matched_is_refused_in_one_sentence(noisy) -> None:
    rig, _, pictures_px = noisy
    with pytest.raises(MatchError, match="two cameras"):
        match_segments({"left": pictures_px["left"]}, rig)
    with pytest.raises(MatchError, match='"top"'):
        match_segments({"top": pictures_px["left"], "left": pictures_px["left"]}, rig)
    with pytest.raises(InputError, match="shape"):
        match_segments({"left": np.zeros((3, 5)), "right": pictures_px["right"]}, rig)
    broken = pictures_px["left"].copy()
    broken[4, 1, 0] = np.nan
    with pytest.raises(InputError, match="Segment 4"):
        match_segments({"left": broken, "right": pictures_px["right"]}, rig)
