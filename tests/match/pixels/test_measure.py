"""Lines measured in pictures of exact steps: as exact as claimed, whatever the order of views."""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.stats import chi2

from tests.match.pixels.made import (
    RIG,
    VIEWS,
    image_px,
    light_of,
    lines_of,
    matches_of,
    noisy,
)
from trinoc.errors import InputError
from trinoc.geometry import distort_pixels
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.image.response import PowerResponse
from trinoc.io.saving import load_matches, save
from trinoc.match import measure_lines
from trinoc.match.pixels.tuning import PixelTuning
from trinoc.match.tracks.unequal_errors import degrees_of_misfit, fit_tail, variance_factor
from trinoc.match.tuning.selection import NoiseTuning
from trinoc.numerics.vectors import complete_axes


def across(found, lines):
    """(errors of both ends across the true line (t, 4), their covariances)."""
    way = lines[:, 1] - lines[:, 0]
    axes = complete_axes(way / np.linalg.norm(way, axis=1)[:, None])
    error = ((found.lines_mm - lines[:, :1]) @ axes.mT).reshape(-1, 4)
    turn = np.zeros((len(lines), 4, 6))
    turn[:, :2, :3] = turn[:, 2:, 3:] = axes
    return error, turn @ found.covariance_mm2 @ turn.mT


def words_of(found):
    return found.marks["measure"]


def chi_square(found, lines):
    error, spread = across(found, lines)
    return (error * np.linalg.solve(spread, error[..., None])[..., 0]).sum(axis=1)


@functools.cache
def setting(seed):
    generator = np.random.default_rng(seed)
    lines = lines_of(seed)
    pictures = {view: noisy(light_of(view, lines), generator) for view in VIEWS}
    return lines, pictures, *matches_of(lines, generator)


def test_errors_are_those_claimed_and_far_smaller_than_the_segments():
    squares, errors, before = [], [], []
    for seed in range(3):
        lines, pictures, segments, matches = setting(seed)
        found = measure_lines(matches, segments, RIG, pictures)
        assert (words_of(found) == "pixels").mean() > 0.95
        squares.append(chi_square(found, lines))
        errors.append(np.abs(across(found, lines)[0]))
        before.append(np.abs(across(matches, lines)[0]))
    square = np.concatenate(squares)
    inside = np.mean(square < chi2.ppf(0.95, 4))
    assert 0.9 <= inside <= 1.0
    # Few lines do not outweigh that errors in pictures are known to be unequal.
    assert 0.3 < square.mean() / 4 < 1.3
    assert np.median(np.concatenate(errors)) < 0.5 * np.median(np.concatenate(before))


def test_the_order_of_views_and_of_a_segments_ends_does_not_matter():
    _lines, pictures, segments, matches = setting(1)
    found = measure_lines(matches, segments, RIG, pictures)
    order = [2, 0, 1]
    turned = dataclasses.replace(
        matches,
        views=tuple(VIEWS[k] for k in order),
        index=matches.index[:, order],
        fragments_px=matches.fragments_px[:, order],
        fragments_covariance_px2=np.asarray(matches.fragments_covariance_px2)[:, order],
    )
    other = {
        name: dataclasses.replace(own, endpoints_px=own.endpoints_px[:, ::-1])
        for name, own in segments.items()
    }
    again = measure_lines(turned, other, RIG, pictures)
    np.testing.assert_allclose(again.lines_mm, found.lines_mm, atol=1e-8)
    np.testing.assert_allclose(again.covariance_mm2, found.covariance_mm2, atol=1e-10)
    np.testing.assert_array_equal(words_of(again), words_of(found)[:, order])


def test_a_view_that_shows_no_clean_step_keeps_its_segment():
    lines, pictures, segments, matches = setting(1)
    blur = np.full(len(lines), 0.9)
    blur[5] = 2.2
    spoiled = noisy(light_of("left", lines, blur_px=blur), np.random.default_rng(20))
    found = measure_lines(matches, segments, RIG, {**pictures, "left": spoiled})
    left = VIEWS.index("left")
    assert words_of(found)[5].tolist().count("pixels") == 2
    assert words_of(found)[5, left] == "no clean step"
    np.testing.assert_array_equal(found.fragments_px[5, left], matches.fragments_px[5, left])
    assert chi_square(found, lines)[5] < chi2.ppf(0.999, 4)


def test_an_edge_that_hides_a_second_one_is_as_far_off_as_its_covariance_says():
    """Both make one profile, which is wider than others and lies between them."""
    lines, _, segments, matches = setting(1)
    beside = np.zeros(len(lines))
    doubled = [2, 5, 9]
    beside[doubled] = 1.0
    light = 0.7 * light_of("left", lines) + 0.3 * light_of("left", lines, beside_px=beside)
    random = np.random.default_rng(4)
    shown = {view: noisy(light_of(view, lines), random) for view in VIEWS}
    found = measure_lines(matches, segments, RIG, {**shown, "left": noisy(light, random)})
    left = VIEWS.index("left")
    assert (words_of(found)[doubled, left] == "pixels").all()
    true = image_px("left", lines)
    way = true[:, 1] - true[:, 0]
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.linalg.norm(way, axis=1)[:, None]
    off = np.einsum("tei,ti->te", found.fragments_px[:, left] - true, normal)
    blocks = np.asarray(found.fragments_covariance_px2)[:, left].reshape(-1, 2, 2, 2, 2)
    sigma = np.sqrt(np.einsum("teiej,ti,tj->te", blocks, normal, normal))
    assert (np.abs(off[doubled]) > 0.2).all()
    assert (np.abs(off[doubled]) < 3 * sigma[doubled]).all()
    assert (np.delete(sigma, doubled, axis=0) < 0.1).all()


def test_a_line_whose_views_disagree_is_known_the_worse_for_it():
    """By the factor that such a misfit makes likely among lines that err as these do."""
    lines, pictures, segments, matches = setting(1)
    place, factor = np.zeros(len(lines)), []
    for beside_px in (0.0, 0.12):
        place[7] = beside_px
        light = light_of("left", lines, beside_px=place)
        shown = {**pictures, "left": noisy(light, np.random.default_rng(20))}
        found = measure_lines(matches, segments, RIG, shown)
        assert (words_of(found)[7] == "pixels").all()
        assert found.misfit is not None
        degrees = degrees_of_misfit(found.index)
        rules = NoiseTuning(tail_of_images=PixelTuning().tail)
        sure = matches.posterior > PixelTuning().sure_posterior
        known = found.misfit[sure], degrees[sure]
        tail = fit_tail(*known, has_images=True, tuning=rules)
        factor.append((variance_factor(found.misfit, degrees, tail), across(found, lines)[1]))
    (before, narrow), (after, wide) = factor
    assert after[7] > 1.5 * before[7]
    trace = [np.trace(each, axis1=1, axis2=2) for each in (narrow, wide)]
    # The grey levels of a view say as much of a place as of another near it.
    np.testing.assert_allclose(trace[1] / trace[0], after / before, rtol=0.1)


def test_a_place_beside_another_segment_is_not_asked():
    _lines, pictures, segments, matches = setting(2)
    own = segments["upper"]
    beside = own.endpoints_px[4:5] + np.array([1.0, 1.0])
    crowded = type(own).from_endpoints(np.concatenate([own.endpoints_px, beside]), sigma_px=0.15)
    found = measure_lines(matches, {**segments, "upper": crowded}, RIG, pictures)
    assert words_of(found)[4, VIEWS.index("upper")] == "neighbours"
    assert (np.delete(words_of(found), 4, axis=0) == "pixels").mean() > 0.9


def test_a_picture_without_edges_changes_nothing():
    _, pictures, segments, matches = setting(0)
    flat = {view: np.full_like(picture, 90) for view, picture in pictures.items()}
    found = measure_lines(matches, segments, RIG, flat)
    assert (words_of(found) != "pixels").all()
    np.testing.assert_array_equal(found.lines_mm, matches.lines_mm)
    np.testing.assert_array_equal(found.covariance_mm2, matches.covariance_mm2)


def test_levels_of_srgb_are_placed_in_the_light():
    lines, _, segments, matches = setting(3)
    generator = np.random.default_rng(40)
    srgb = PowerResponse(1.0)
    shown = {
        view: np.rint(
            255 * np.asarray(srgb.level_of(light_of(view, lines, low=8, high=220) / 255))
            + 0.5 * generator.normal(size=RIG[view].image_size_px[::-1])
        ).astype(np.uint8)
        for view in VIEWS
    }
    off = {
        response: np.median(
            np.abs(
                across(measure_lines(matches, segments, RIG, shown, response=response), lines)[0]
            )
        )
        for response in ("linear", "srgb")
    }
    assert off["srgb"] < 0.5 * off["linear"]


def test_a_lens_that_bends_the_picture_changes_nothing():
    lens = Intrinsics(
        focal_length_mm=16,
        pixel_pitch_mm=(0.0162, 0.0134),
        image_size_px=(512, 480),
        distortion=(-0.25, 0.1, 0.0, 0.0, 0.0),
    )
    rig = Rig({view: dataclasses.replace(RIG[view], intrinsics=lens) for view in VIEWS})
    generator = np.random.default_rng(50)
    lines, _, segments, matches = setting(0)
    pictures = {view: noisy(light_of(view, lines, lens=lens), generator) for view in VIEWS}
    bent = {
        view: dataclasses.replace(
            own, endpoints_px=distort_pixels(lens, np.asarray(own.endpoints_px))
        )
        for view, own in segments.items()
    }
    fragments = np.stack([bent[view].endpoints_px for view in VIEWS], axis=1)
    matches = dataclasses.replace(matches, fragments_px=fragments)
    found = measure_lines(matches, bent, rig, pictures)
    assert (words_of(found) == "pixels").mean() > 0.9
    assert np.mean(chi_square(found, lines) < chi2.ppf(0.95, 4)) > 0.8
    assert np.abs(found.fragments_px - fragments).max() < 1.0


def test_words_and_lines_are_kept_in_a_file(tmp_path):
    _, pictures, segments, matches = setting(0)
    found = measure_lines(matches, segments, RIG, pictures)
    save(found, tmp_path / "measured.npz")
    again = load_matches(tmp_path / "measured.npz")
    np.testing.assert_array_equal(words_of(again), words_of(found))
    np.testing.assert_array_equal(again.lines_mm, found.lines_mm)
    assert found.counts["measured: lines by their pixels"] == 12


def test_what_cannot_be_measured_is_refused():
    _lines, pictures, segments, matches = setting(0)
    with pytest.raises(InputError, match="needs the image of every view"):
        measure_lines(matches, segments, RIG, {"upper": pictures["upper"]})
    small = {**pictures, "left": pictures["left"][:100]}
    with pytest.raises(InputError, match="its camera has"):
        measure_lines(matches, segments, RIG, small)
    with pytest.raises(InputError, match="response is"):
        measure_lines(matches, segments, RIG, pictures, response=3.0)
