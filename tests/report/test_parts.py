"""The small pieces of the report, by their laws."""

import base64
import dataclasses
import math

import cv2
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from trinoc.errors import InputError
from trinoc.geometry.line_lengths import line_sigmas
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import Matches
from trinoc.report.numbers import (
    millimetres,
    plain,
    round_scale,
    significant_decimals,
    with_decimals,
    with_sigma,
    with_sign,
)
from trinoc.report.pictures import LONGEST_SIDE_PX, Window, clip_line, page_picture
from trinoc.report.space_content import PALETTE, content_box, distinct_neighbours, frusta
from trinoc.report.space_part import LETTER_SHARE, place_names

FINITE = st.floats(-1e4, 1e4, allow_nan=False)


@given(st.floats(1e-9, 1e3))
def test_a_sigma_is_shown_by_its_first_digits(sigma: float) -> None:
    shown = float(f"{sigma:.{significant_decimals(sigma)}f}")
    assert shown == pytest.approx(sigma, rel=0.051) or sigma > 10


@given(st.floats(1e-6, 1e6))
def test_a_round_scale_is_the_next_one_below(value: float) -> None:
    scale = round_scale(value)
    assert scale <= value * (1 + 1e-9) <= 2.5 * scale * (1 + 1e-9)
    assert float(plain(scale)) == pytest.approx(scale)
    assert plain(scale).strip("0.") in ("1", "2", "5")


@given(FINITE, st.integers(0, 6))
def test_signs_are_true_minus_signs(value: float, decimals: int) -> None:
    text = with_decimals(value, decimals)
    assert "-" not in text
    assert float(text.replace("\N{MINUS SIGN}", "-")) == pytest.approx(value, abs=10.0**-decimals)
    assert with_sign(value, decimals)[0] in "+\N{MINUS SIGN}0"


def test_what_is_not_known_is_said() -> None:
    assert with_sigma(1.25, math.nan) == "1.2500"
    assert with_sigma(math.nan, 0.1) == "not known ± 0.10"
    assert with_decimals(-0.00001, 3) == "0.000"


@given(st.integers(0, 2**32 - 1))
def test_near_tracks_take_distinct_colours(seed: int) -> None:
    midpoints = np.random.default_rng(seed).uniform(0, 500, size=(len(PALETTE), 2, 2))
    assert len(set(distinct_neighbours(midpoints).tolist())) == len(PALETTE)


def test_colours_ignore_views_that_see_nothing() -> None:
    midpoints = np.full((4, 3, 2), np.nan)
    midpoints[:, 0] = [[0, 0], [1, 0], [300, 300], [301, 300]]
    colours = distinct_neighbours(midpoints)
    assert colours[0] != colours[1]
    assert colours[2] != colours[3]


@given(FINITE, FINITE, st.floats(0, 2 * math.pi))
def test_a_clipped_line_lies_on_its_line_in_the_picture(u: float, v: float, turn: float) -> None:
    normal = np.array([math.cos(turn), math.sin(turn)])
    line = np.append(normal, -normal @ np.array([u, v]))
    ends = clip_line(line, (512, 480))
    if ends is not None:
        np.testing.assert_allclose(ends @ normal + line[2], 0, atol=1e-6)
        assert (ends > -0.5 - 1e-6).all()
        assert (ends < np.array([511.5, 479.5]) + 1e-6).all()
    elif 0 <= u <= 511 and 0 <= v <= 479:
        pytest.fail("a line through a pixel of the picture was lost")


@pytest.mark.parametrize("line", [(1.0, 0.0, -100.0), (0.0, 1.0, -100.0)])
def test_lines_along_the_axes_are_clipped_too(line: tuple[float, float, float]) -> None:
    ends = clip_line(np.array(line), (512, 480))
    assert ends is not None
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(480 if line[0] else 512)
    assert clip_line(np.array([*line[:2], 100.0]), (512, 480)) is None
    assert clip_line(np.full(3, np.nan), (512, 480)) is None


def _decoded(uri: str) -> np.ndarray:
    data = np.frombuffer(base64.b64decode(uri.split(",")[1]), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


def test_a_picture_keeps_its_grey_levels() -> None:
    ramp = np.tile(np.arange(0, 256, dtype=np.uint8), (64, 1))
    picture = page_picture("a", ramp, (1, 1))
    assert (picture.width_px, picture.height_px) == (256, 64)
    np.testing.assert_allclose(_decoded(picture.uri), ramp, atol=8)


def test_deep_colour_and_large_pictures_are_shown() -> None:
    deep = (np.tile(np.arange(256, dtype=np.uint16), (64, 1)) * 40) + 1000
    assert np.ptp(_decoded(page_picture("a", deep, (1, 1)).uri)) > 240
    red = np.zeros((32, 32, 3), np.uint8)
    red[..., 0] = 255
    assert _decoded(page_picture("a", red, (1, 1)).uri)[16, 16].argmax() == 2
    large = page_picture("a", np.zeros((1000, 4000), np.uint8), (1, 1))
    assert _decoded(large.uri).shape == (400, LONGEST_SIDE_PX)
    assert large.width_px == 4000


def test_no_picture_keeps_its_size_and_a_wrong_one_is_refused() -> None:
    assert page_picture("a", None, (512, 480)).uri == ""
    with pytest.raises(InputError, match="has shape"):
        page_picture("a", np.zeros(5), (1, 1))


def test_a_window_holds_its_points_and_stays_in_the_picture() -> None:
    picture = page_picture("a", None, (512, 480))
    points = np.array([[5.0, 10.0], [200.0, 150.0]])
    window = Window.around(points, picture)
    assert window.left >= -0.5
    assert window.top >= -0.5
    assert (points >= [window.left, window.top]).all()
    assert (points <= [window.left + window.width, window.top + window.height]).all()
    assert window.width / window.height == pytest.approx(512 / 480)
    assert Window.around(np.zeros((0, 2)), picture) == picture.window


def test_sigmas_of_tracks_agree_with_many_draws(matches: Matches) -> None:
    sigmas, random = line_sigmas(matches.lines_mm, matches.covariance_mm2), np.random.default_rng(3)
    ends, covariance = np.asarray(matches.lines_mm)[5], np.asarray(matches.covariance_mm2)[5]
    drawn = random.multivariate_normal(ends.reshape(6), covariance, size=20_000).reshape(-1, 2, 3)
    lengths = np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=1)
    assert sigmas.length_sigma_mm[5] == pytest.approx(float(lengths.std()), rel=0.03)
    np.testing.assert_allclose(sigmas.ends_sigma_mm[5], drawn.std(axis=0), rtol=0.03)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    middle = drawn.mean(axis=1)
    across = np.cov((middle - middle @ along[:, None] * along).T)
    assert sigmas.across_sigma_mm[5] == pytest.approx(
        float(np.sqrt(np.linalg.eigvalsh(across)[-1])), rel=0.03
    )


def test_frusta_open_toward_what_the_cameras_see(rig: Rig) -> None:
    for outline, (_, camera) in zip(frusta(rig), rig.items(), strict=True):
        depths = (outline - camera.centre_world_mm) @ np.asarray(camera.pose.rotation)[2]
        assert depths.min() == pytest.approx(0.0, abs=1e-9)
        assert np.sum(depths > 1.0) >= 8


def test_a_far_segment_does_not_shrink_the_view(matches: Matches) -> None:
    before = content_box(None, matches)
    lines = np.array(matches.lines_mm)
    lines[0] += 1e5
    after = content_box(None, dataclasses.replace(matches, lines_mm=lines))
    assert before is not None
    assert after is not None
    assert np.max(after.high_mm) < 2 * np.max(before.high_mm)


@given(
    st.lists(st.tuples(st.floats(0, 20), st.floats(10, 30), st.text("abc", min_size=1)), max_size=9)
)
def test_no_two_names_of_cameras_meet(names: list[tuple[float, float, str]]) -> None:
    placements = place_names(names, 2.0, 5.0)
    for k, (x, y, name) in enumerate(placements):
        assert (x, name) == (names[k][0], names[k][2])
        assert y >= 5.0
        assert k or y == names[k][1]
        for u, v, other in placements[:k]:
            reach = LETTER_SHARE * 2.0 * (len(name) + len(other)) / 2
            assert abs(x - u) >= reach or abs(y - v) >= 1.9


@given(st.floats(1e-6, 100.0))
def test_small_lengths_are_read_back_from_two_digits(value: float) -> None:
    number, unit = millimetres(value).split()
    shown = float(number) * (1e-3 if unit == "µm" else 1.0)
    assert shown == pytest.approx(value, rel=0.051, abs=5.1e-7) or value > 10
