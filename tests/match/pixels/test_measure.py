"""Lines measured in pictures of exact steps: errors agree with the reported covariance."""

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


def across(matches, lines):
    """Errors of both ends across the true line, mm (t, 4), and their covariances."""
    direction = lines[:, 1] - lines[:, 0]
    axes = complete_axes(direction / np.linalg.norm(direction, axis=1)[:, None])
    error = ((matches.lines_mm - lines[:, :1]) @ axes.mT).reshape(-1, 4)
    turn = np.zeros((len(lines), 4, 6))
    turn[:, :2, :3] = turn[:, 2:, 3:] = axes
    return error, turn @ matches.covariance_mm2 @ turn.mT


def measure_marks(matches):
    return matches.marks["measure"]


def chi_square(matches, lines):
    error, spread = across(matches, lines)
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
        measured = measure_lines(matches, segments, RIG, pictures)
        assert (measure_marks(measured) == "pixels").mean() > 0.95
        squares.append(chi_square(measured, lines))
        errors.append(np.abs(across(measured, lines)[0]))
        before.append(np.abs(across(matches, lines)[0]))
    square = np.concatenate(squares)
    inside = np.mean(square < chi2.ppf(0.95, 4))
    assert 0.9 <= inside <= 1.0
    # Few lines do not outweigh that errors in pictures are known to be unequal.
    assert 0.3 < square.mean() / 4 < 1.3
    assert np.median(np.concatenate(errors)) < 0.5 * np.median(np.concatenate(before))


def test_the_order_of_views_and_of_a_segments_ends_does_not_matter():
    _lines, pictures, segments, matches = setting(1)
    measured = measure_lines(matches, segments, RIG, pictures)
    order = [2, 0, 1]
    turned = dataclasses.replace(
        matches,
        views=tuple(VIEWS[k] for k in order),
        index=matches.index[:, order],
        fragments_px=matches.fragments_px[:, order],
        fragments_covariance_px2=np.asarray(matches.fragments_covariance_px2)[:, order],
    )
    other = {
        name: dataclasses.replace(view_segments, endpoints_px=view_segments.endpoints_px[:, ::-1])
        for name, view_segments in segments.items()
    }
    reordered = measure_lines(turned, other, RIG, pictures)
    np.testing.assert_allclose(reordered.lines_mm, measured.lines_mm, atol=1e-8)
    np.testing.assert_allclose(reordered.covariance_mm2, measured.covariance_mm2, atol=1e-10)
    np.testing.assert_array_equal(measure_marks(reordered), measure_marks(measured)[:, order])


def test_a_view_that_shows_no_clean_step_keeps_its_segment():
    lines, pictures, segments, matches = setting(1)
    blur = np.full(len(lines), 0.9)
    blur[5] = 2.2
    spoiled = noisy(light_of("left", lines, blur_px=blur), np.random.default_rng(20))
    measured = measure_lines(matches, segments, RIG, {**pictures, "left": spoiled})
    left_view = VIEWS.index("left")
    assert measure_marks(measured)[5].tolist().count("pixels") == 2
    assert measure_marks(measured)[5, left_view] == "no clean step"
    np.testing.assert_array_equal(
        measured.fragments_px[5, left_view], matches.fragments_px[5, left_view]
    )
    assert chi_square(measured, lines)[5] < chi2.ppf(0.999, 4)


def test_an_edge_that_hides_a_second_one_is_as_far_off_as_its_covariance_says():
    """Both edges make one profile, which is wider than others and lies between them."""
    lines, _, segments, matches = setting(1)
    offset_px = np.zeros(len(lines))
    doubled = [2, 5, 9]
    offset_px[doubled] = 1.0
    light = 0.7 * light_of("left", lines) + 0.3 * light_of("left", lines, beside_px=offset_px)
    random = np.random.default_rng(4)
    shown = {view: noisy(light_of(view, lines), random) for view in VIEWS}
    measured = measure_lines(matches, segments, RIG, {**shown, "left": noisy(light, random)})
    left_view = VIEWS.index("left")
    assert (measure_marks(measured)[doubled, left_view] == "pixels").all()
    true = image_px("left", lines)
    direction = true[:, 1] - true[:, 0]
    normal = (
        np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        / np.linalg.norm(direction, axis=1)[:, None]
    )
    off = np.einsum("tei,ti->te", measured.fragments_px[:, left_view] - true, normal)
    blocks = np.asarray(measured.fragments_covariance_px2)[:, left_view].reshape(-1, 2, 2, 2, 2)
    sigma = np.sqrt(np.einsum("teiej,ti,tj->te", blocks, normal, normal))
    assert (np.abs(off[doubled]) > 0.2).all()
    assert (np.abs(off[doubled]) < 3 * sigma[doubled]).all()
    assert (np.delete(sigma, doubled, axis=0) < 0.1).all()


def test_a_line_whose_views_disagree_is_known_the_worse_for_it():
    """Its variance grows by the factor that this misfit makes likely among such lines."""
    lines, pictures, segments, matches = setting(1)
    offset_px, factor = np.zeros(len(lines)), []
    for beside_px in (0.0, 0.12):
        offset_px[7] = beside_px
        light = light_of("left", lines, beside_px=offset_px)
        shown = {**pictures, "left": noisy(light, np.random.default_rng(20))}
        measured = measure_lines(matches, segments, RIG, shown)
        assert (measure_marks(measured)[7] == "pixels").all()
        assert measured.misfit is not None
        degrees = degrees_of_misfit(measured.index)
        rules = NoiseTuning(tail_of_images=PixelTuning().tail)
        sure = matches.posterior > PixelTuning().sure_posterior
        sure_misfits = measured.misfit[sure], degrees[sure]
        tail = fit_tail(*sure_misfits, has_images=True, tuning=rules)
        factor.append((variance_factor(measured.misfit, degrees, tail), across(measured, lines)[1]))
    (before, narrow), (after, wide) = factor
    assert after[7] > 1.5 * before[7]
    trace = [np.trace(covariance, axis1=1, axis2=2) for covariance in (narrow, wide)]
    # The grey levels of a view say as much of a place as of another near it.
    np.testing.assert_allclose(trace[1] / trace[0], after / before, rtol=0.1)


def test_a_place_beside_another_segment_is_not_asked():
    _lines, pictures, segments, matches = setting(2)
    upper_segments = segments["upper"]
    neighbour_px = upper_segments.endpoints_px[4:5] + np.array([1.0, 1.0])
    crowded = type(upper_segments).from_endpoints(
        np.concatenate([upper_segments.endpoints_px, neighbour_px]), sigma_px=0.15
    )
    measured = measure_lines(matches, {**segments, "upper": crowded}, RIG, pictures)
    assert measure_marks(measured)[4, VIEWS.index("upper")] == "neighbours"
    assert (np.delete(measure_marks(measured), 4, axis=0) == "pixels").mean() > 0.9


def test_a_picture_without_edges_changes_nothing():
    _, pictures, segments, matches = setting(0)
    flat = {view: np.full_like(picture, 90) for view, picture in pictures.items()}
    measured = measure_lines(matches, segments, RIG, flat)
    assert (measure_marks(measured) != "pixels").all()
    np.testing.assert_array_equal(measured.lines_mm, matches.lines_mm)
    np.testing.assert_array_equal(measured.covariance_mm2, matches.covariance_mm2)


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
            view_segments, endpoints_px=distort_pixels(lens, np.asarray(view_segments.endpoints_px))
        )
        for view, view_segments in segments.items()
    }
    fragments = np.stack([bent[view].endpoints_px for view in VIEWS], axis=1)
    matches = dataclasses.replace(matches, fragments_px=fragments)
    measured = measure_lines(matches, bent, rig, pictures)
    assert (measure_marks(measured) == "pixels").mean() > 0.9
    assert np.mean(chi_square(measured, lines) < chi2.ppf(0.95, 4)) > 0.8
    assert np.abs(measured.fragments_px - fragments).max() < 1.0


def test_words_and_lines_are_kept_in_a_file(tmp_path):
    _, pictures, segments, matches = setting(0)
    measured = measure_lines(matches, segments, RIG, pictures)
    save(measured, tmp_path / "measured.npz")
    loaded = load_matches(tmp_path / "measured.npz")
    np.testing.assert_array_equal(measure_marks(loaded), measure_marks(measured))
    np.testing.assert_array_equal(loaded.lines_mm, measured.lines_mm)
    assert measured.counts["measured: lines by their pixels"] == 12


def test_what_cannot_be_measured_is_refused():
    _lines, pictures, segments, matches = setting(0)
    with pytest.raises(InputError, match="needs the image of every view"):
        measure_lines(matches, segments, RIG, {"upper": pictures["upper"]})
    small = {**pictures, "left": pictures["left"][:100]}
    with pytest.raises(InputError, match="its camera has"):
        measure_lines(matches, segments, RIG, small)
    with pytest.raises(InputError, match="response is"):
        measure_lines(matches, segments, RIG, pictures, response=3.0)
