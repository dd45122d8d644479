"""Laws of the whole detector: effects of changes of the picture on its segments."""

import numpy as np
import pytest
from scipy.special import erf

from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics, distort_pixels
from trinoc.geometry.segments import Segments
from trinoc.image.light import Light
from trinoc.segments import find_segments
from trinoc.segments.nevatia_babu.chains import order_chains
from trinoc.segments.nevatia_babu.line_fit import fit_lines, merge_collinear, refit_lines
from trinoc.segments.nevatia_babu.masks import combined_kernel
from trinoc.segments.nevatia_babu.neighbours import find_overlaps, without_neighbours
from trinoc.segments.nevatia_babu.runs import find_runs, full_level

HEIGHT, WIDTH = 120, 150


def soft_step(distance_px: np.ndarray, blur_px: float = 0.9) -> np.ndarray:
    return 0.5 * (1 + erf(distance_px / (np.sqrt(2) * blur_px)))


def polygon_image(
    shift_uv: tuple[float, float] = (0.0, 0.0), noise: float = 1.0, height: int = HEIGHT
) -> np.ndarray:
    """A bright convex quadrangle on a dark ground, as real numbers."""
    v, u = np.mgrid[:height, :WIDTH].astype(float)
    corners = np.array([[30.2, 25.4], [112.7, 34.1], [99.3, 88.8], [41.6, 80.3]]) + shift_uv
    inside = np.ones((height, WIDTH))
    for first, second in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        direction = (second - first) / np.linalg.norm(second - first)
        inside = inside * soft_step((v - first[1]) * direction[0] - (u - first[0]) * direction[1])
    grey = 60.0 + 90.0 * inside
    return grey + np.random.default_rng(3).normal(0.0, noise, grey.shape)


def as_bytes(grey: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def sorted_ends(endpoints_px: np.ndarray) -> np.ndarray:
    return endpoints_px[np.lexsort(np.round(endpoints_px.reshape(-1, 4).T, 1))]


def same_ends(one: np.ndarray, other: np.ndarray, atol: float) -> bool:
    """True if both hold the same segments, each with its ends in the same order."""
    if len(one) != len(other):
        return False
    distance = np.abs(one[:, None] - other[None]).max(axis=(2, 3))
    return bool((distance.min(axis=1) < atol).all() and (distance.min(axis=0) < atol).all())


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    return as_bytes(polygon_image())


@pytest.fixture(scope="module")
def segments(picture: np.ndarray) -> Segments:
    return find_segments(picture)


def test_the_sides_of_a_quadrangle_are_found_with_their_corners(segments: Segments) -> None:
    corners = np.array([[30.2, 25.4], [112.7, 34.1], [99.3, 88.8], [41.6, 80.3]])
    # Walking with the darker side on the right goes round a bright figure clockwise on the
    # picture when the figure is on the left: from each corner back to the one before.
    sides = np.stack([np.roll(corners, -1, axis=0), corners], axis=1)
    assert same_ends(np.asarray(segments.endpoints_px), sides, atol=0.3)


def test_ends_lie_within_their_sigmas(segments: Segments) -> None:
    corners = np.array([[30.2, 25.4], [112.7, 34.1], [99.3, 88.8], [41.6, 80.3]])
    ends = np.asarray(segments.endpoints_px).reshape(-1, 2)
    covariance = np.asarray(segments.covariance_px2)
    blocks = np.stack([covariance[:, :2, :2], covariance[:, 2:, 2:]], axis=1).reshape(-1, 2, 2)
    error = ends - corners[np.linalg.norm(ends[:, None] - corners, axis=-1).argmin(axis=1)]
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(blocks), error)
    assert (squared < 16).all()


def test_contrast_is_the_height_of_the_step(segments: Segments) -> None:
    assert np.allclose(segments.contrast, 90.0, rtol=0.06)


def test_corners_are_junctions_of_two_ends(segments: Segments) -> None:
    junctions = segments.junctions
    assert junctions is not None
    assert len(junctions) == 4
    assert (np.asarray(junctions.kind) == "L").all()
    assert (np.bincount(junctions.junction) == 2).all()


def test_every_polarity_is_positive_and_says_the_darker_side(
    picture: np.ndarray, segments: Segments
) -> None:
    assert (np.asarray(segments.polarity) == 1).all()
    ends = np.asarray(segments.endpoints_px)
    direction = ends[:, 1] - ends[:, 0]
    right = (
        np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
        / np.linalg.norm(direction, axis=1)[:, None]
    )
    middle = ends.mean(axis=1)
    for sign, is_darker in ((4.0, True), (-4.0, False)):
        column, row = np.rint(middle + sign * right).astype(int).T
        assert ((picture[row, column] < 105) == is_darker).all()


def test_a_negative_has_the_same_segments_walked_the_other_way(
    picture: np.ndarray, segments: Segments
) -> None:
    negative = find_segments(255 - picture)
    swapped = np.asarray(segments.endpoints_px)[:, ::-1]
    assert same_ends(np.asarray(negative.endpoints_px), swapped, atol=0.02)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_picture_has_turned_segments(
    picture: np.ndarray, segments: Segments, quarters: int
) -> None:
    ends = np.asarray(segments.endpoints_px)
    height, width = picture.shape
    for _ in range(quarters):
        # np.rot90 takes (u, v) to (v, width - 1 - u).
        ends = np.stack([ends[..., 1], width - 1 - ends[..., 0]], axis=-1)
        height, width = width, height
    turned = find_segments(np.ascontiguousarray(np.rot90(picture, quarters)))
    assert same_ends(np.asarray(turned.endpoints_px), ends, atol=0.05)


def test_a_mirrored_picture_has_mirrored_segments_walked_the_other_way(
    picture: np.ndarray, segments: Segments
) -> None:
    ends = np.asarray(segments.endpoints_px)[:, ::-1] * [-1, 1] + [picture.shape[1] - 1, 0]
    mirrored = find_segments(np.ascontiguousarray(picture[:, ::-1]))
    assert same_ends(np.asarray(mirrored.endpoints_px), ends, atol=0.05)


def test_a_transposed_picture_has_transposed_segments_walked_the_other_way(
    picture: np.ndarray, segments: Segments
) -> None:
    ends = np.asarray(segments.endpoints_px)[:, ::-1, ::-1]
    transposed = find_segments(np.ascontiguousarray(picture.T))
    assert same_ends(np.asarray(transposed.endpoints_px), ends, atol=0.05)


@pytest.mark.parametrize("shift_uv", [(0.25, 0.0), (0.0, 0.4), (0.37, -0.61)])
def test_segments_follow_a_shift_by_part_of_a_pixel(shift_uv: tuple[float, float]) -> None:
    here = find_segments(polygon_image(noise=0.01).astype(np.float32))
    there = find_segments(polygon_image(shift_uv, noise=0.01).astype(np.float32))
    moved = np.asarray(here.endpoints_px) + shift_uv
    assert same_ends(np.asarray(there.endpoints_px), moved, atol=0.03)


def test_eight_and_sixteen_bits_say_the_same(picture: np.ndarray, segments: Segments) -> None:
    wide = find_segments(picture.astype(np.uint16) * 257)
    assert same_ends(np.asarray(wide.endpoints_px), np.asarray(segments.endpoints_px), atol=0.01)


def test_a_grey_picture_in_three_channels_says_the_same(
    picture: np.ndarray, segments: Segments
) -> None:
    colour = find_segments(np.repeat(picture[:, :, None], 3, axis=2))
    assert same_ends(np.asarray(colour.endpoints_px), np.asarray(segments.endpoints_px), atol=0.01)


def test_a_lens_moves_segments_to_where_it_would_show_them_undistorted(
    picture: np.ndarray, segments: Segments
) -> None:
    lens = Intrinsics(image_size_px=(WIDTH, HEIGHT), focal_length_px=400.0, distortion=[-0.05, 0.0])
    straight = find_segments(picture, intrinsics=lens)
    expected = np.array(
        [
            [np.asarray(lens.undistort_pixel(end)) for end in ends]
            for ends in np.asarray(segments.endpoints_px)
        ]
    )
    assert same_ends(np.asarray(straight.endpoints_px), expected, atol=0.25)


def test_a_lens_of_another_size_is_refused(picture: np.ndarray) -> None:
    lens = Intrinsics(image_size_px=(640, 480), focal_length_px=400.0)
    with pytest.raises(InputError, match="640 x 480"):
        find_segments(picture, intrinsics=lens)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((40, 40), dtype=np.uint8),
        np.full((60, 80), 255, dtype=np.uint8),
        np.full((60, 80), 0.5),
    ],
)
def test_a_blank_picture_has_no_segments(image: np.ndarray) -> None:
    blank = find_segments(image)
    assert len(blank) == 0
    assert blank.junctions is not None
    assert len(blank.junctions) == 0


def test_noise_alone_makes_hardly_any_segment() -> None:
    count = 0
    for seed in range(12):
        noise = np.random.default_rng(seed).normal(128.0, 10.0, (300, 300))
        count += len(find_segments(as_bytes(noise), false_alarms=1.0))
    # One per picture is what the knob allows.
    assert count <= 12


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((40, 40, 5), np.uint8), "shape"),
        (np.zeros((8, 40), np.uint8), "at least"),
        (np.zeros((40, 40), np.complex64), "no grey levels"),
        (np.full((40, 40), np.nan), "not finite"),
    ],
)
def test_what_is_no_picture_is_refused(image: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        find_segments(image)


@pytest.mark.parametrize("name", ["tolerance_px", "false_alarms"])
def test_a_knob_that_is_not_positive_is_refused(picture: np.ndarray, name: str) -> None:
    with pytest.raises(InputError, match=name):
        find_segments(picture, **{name: 0.0})  # pyright: ignore[reportArgumentType]


def test_chords_of_arcs_are_kept_where_asked_for() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    disc = as_bytes(60.0 + 90.0 * soft_step(40.0 - np.hypot(u - 75.0, v - 60.0)))
    chords = find_segments(disc, arcs=True)
    assert len(chords) > len(find_segments(disc)) + 5
    ends = np.asarray(chords.endpoints_px)
    # Chords of a circle of 40 px that deviate from it by the tolerance at most.
    assert np.abs(np.hypot(*(ends.mean(axis=1) - [75.0, 60.0]).T) - 40.0).max() < 1.6


def test_the_levels_beside_segments_are_those_of_the_picture(segments: Segments) -> None:
    levels = segments.side_levels
    assert levels is not None
    np.testing.assert_allclose(levels, [[60.0, 150.0]] * len(segments), atol=2.0)


def test_what_is_fitted_again_is_all_that_changed() -> None:
    """Refits of joined lines and of lines with removed points equal new fits to the last bit."""
    grey = polygon_image(noise=2.0, height=180)
    # Two edges beside each other, one far from all, and gaps, which joined lines go across.
    grey[:110, 120:124] += 25
    grey[150:] += 40
    grey[:110, 60:64] = grey[:110, 60:64].mean()
    level = full_level(Light.from_picture(as_bytes(grey)), combined_kernel())
    single = find_runs(level, 1.6, 7.0)
    runs, lines = merge_collinear(single, fit_lines(single), 1.6)
    assert len(runs.first) < len(single.first)
    for column, refitted in zip(lines, fit_lines(runs), strict=True):
        np.testing.assert_array_equal(column, refitted)
    overlaps = find_overlaps(runs, lines, level.kernel_variance_px2 + 1)
    points = without_neighbours(runs.points, lines, 1.0, overlaps)
    cleaned = runs._replace(points=points)
    changed = cleaned.differ_from(runs)
    assert 0 < changed.sum() < len(changed)
    for column, refitted in zip(
        refit_lines(cleaned, lines, changed), fit_lines(cleaned), strict=True
    ):
        np.testing.assert_array_equal(column, refitted)


@pytest.mark.parametrize("seed", range(4))
def test_chains_are_those_of_walking_along_them_and_rings_begin_at_their_least(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.permutation(60)
    successor = np.full(60, -1)
    # Rings of 1 to 20 points, of which every third is cut open.
    for k, chain in enumerate(np.split(points, np.sort(rng.choice(np.arange(1, 60), 9, False)))):
        successor[chain] = np.roll(chain, -1)
        successor[chain[-1:]] = -1 if k % 3 == 0 or len(chain) == 1 else chain[0]
    order, starts = order_chains(successor)
    for chain in np.split(order, starts[1:]):
        np.testing.assert_array_equal(successor[chain[:-1]], chain[1:])
        assert successor[chain[-1]] == -1 or successor[chain[-1]] == chain[0] == chain.min()
    assert sorted(order.tolist()) == list(range(60))


def test_beyond_the_fold_of_its_lens_no_line_is_found() -> None:
    """A line that crosses the radius ends there; a line beyond it is not found."""
    lens = Intrinsics(image_size_px=(640, 480), focal_length_px=500.0, distortion=[-0.3])
    radius_px = lens.valid_radius_px
    assert 345 < radius_px < 355
    image = np.full((480, 640), 60, dtype=np.uint8)
    # One edge through the middle of the image, one toward a corner, one in the corner alone.
    image[200:280, 240:400] = 120
    image[430:480, 560:640] = 180
    image[:12, :20] = 220
    straight = find_segments(image, intrinsics=lens)
    plain = np.asarray(find_segments(image).endpoints_px)
    away_px = np.linalg.norm(plain - lens.principal_point_px, axis=2)
    beyond = (away_px > radius_px).all(axis=1)
    assert beyond.any()
    assert ((away_px > radius_px).any(axis=1) & ~beyond).any()
    ends = distort_pixels(lens, np.asarray(straight.endpoints_px))
    assert np.isfinite(np.asarray(straight.endpoints_px)).all()
    assert len(straight) == (~beyond).sum()
    away_px = np.linalg.norm(ends - lens.principal_point_px, axis=2)
    assert (away_px[np.isfinite(away_px)] < radius_px + 1).all()
    assert np.isfinite(np.asarray(straight.side_levels)).all()
