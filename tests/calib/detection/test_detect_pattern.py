"""Laws of the detection: changes of the image that leave the detected circles unchanged."""

import jax
import numpy as np
import pytest

from benchmarks.detection_scenes import round_things
from simulation.camera_picture.layers import cover_card
from simulation.camera_picture.light import Illumination
from simulation.camera_picture.render import render_sheet
from trinoc.calib import Detection, detect_pattern
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import DetectionError, InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.synth import table1_lens, table1_rig

SHEET = Pattern.default()
CAMERA = table1_rig()["right"]


def true_centres(camera: Camera, pattern: Pattern) -> np.ndarray:
    centres_of_circles = jax.jit(jax.vmap(image_of_circle_centre, in_axes=(None, 0, 0)))
    return np.asarray(centres_of_circles(camera, pattern.centres_mm, pattern.radius_mm))


def errors_px(detection: Detection, camera: Camera, pattern: Pattern) -> np.ndarray:
    return detection.centres_px - true_centres(camera, pattern)[detection.circle_index]


def by_index(detection: Detection) -> np.ndarray:
    """Centres in the order of the pattern, all of which must be there."""
    order = np.argsort(detection.circle_index)
    np.testing.assert_array_equal(detection.circle_index[order], np.arange(len(SHEET)))
    return detection.centres_px[order]


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    return render_sheet(SHEET, CAMERA, noise_sigma=2.0, seed=3)


@pytest.fixture(scope="module")
def detection(picture) -> Detection:
    return detect_pattern(picture, SHEET)


def test_all_circles_are_found_where_they_are(detection):
    error = errors_px(detection, CAMERA, SHEET)
    assert len(detection) == len(SHEET)
    assert detection.ambiguity is None
    assert np.sqrt(np.mean(error**2)) < 0.006
    assert np.abs(error).max() < 0.03


def test_lines_lie_where_they_are(detection):
    for axis in (0, 1):
        ends_mm = np.zeros((2, 4))
        ends_mm[:, 3] = 1.0
        ends_mm[:, axis] = (-80.0, 80.0)
        image = ends_mm @ np.asarray(CAMERA.matrix_px).T
        offset = (image[:, :2] / image[:, 2:]) @ detection.lines_px[axis, :2] + detection.lines_px[
            axis, 2
        ]
        assert np.abs(offset).max() < 0.05
    np.testing.assert_allclose(np.linalg.norm(detection.lines_px[:, :2], axis=1), 1.0)


def test_errors_are_as_large_as_claimed():
    clean = render_sheet(SHEET, CAMERA, supersampling=16, bits=None)
    random = np.random.default_rng(5)
    scaled = []
    for _ in range(8):
        noisy = np.rint(clean + random.normal(0.0, 2.0, clean.shape)).clip(0, 255)
        detection = detect_pattern(noisy.astype(np.uint8), SHEET)
        error = errors_px(detection, CAMERA, SHEET)
        inverse = np.linalg.inv(detection.covariance_px2)
        scaled.append(np.einsum("ni,nij,nj->n", error, inverse, error))
    assert 0.75 < np.mean(scaled) / 2 < 1.25


@pytest.mark.slow
def test_errors_of_large_circles_are_as_large_as_claimed():
    camera = table1_rig(resolution=4)["left"]
    picture = render_sheet(SHEET, camera, supersampling=8, noise_sigma=2.0, seed=1)
    detection = detect_pattern(picture, SHEET)
    assert len(detection) == len(SHEET)
    error = errors_px(detection, camera, SHEET)
    scaled = np.einsum("ni,nij,nj->n", error, np.linalg.inv(detection.covariance_px2), error)
    assert 0.7 < np.mean(scaled) / 2 < 1.4
    assert scaled.max() < 20.0


def test_quarter_turns_of_the_picture_keep_every_label(picture, detection):
    width = picture.shape[1]
    turned = by_index(detect_pattern(np.rot90(picture), SHEET))
    back = np.stack([width - 1 - turned[:, 1], turned[:, 0]], axis=1)
    np.testing.assert_allclose(back, by_index(detection), atol=5e-3)


def test_a_shifted_picture_shifts_the_centres(picture, detection):
    shifted = detect_pattern(np.pad(picture, ((7, 0), (13, 0)), mode="edge"), SHEET)
    np.testing.assert_allclose(
        by_index(shifted) - by_index(detection), [[13.0, 7.0]] * len(SHEET), atol=5e-3
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda grey: grey.astype(np.uint16) * 257,
        lambda grey: grey / 255.0,
        lambda grey: 3.0 * grey.astype(float) + 1000.0,
        lambda grey: 255 - grey,
        lambda grey: np.stack([grey] * 3, axis=-1),
        lambda grey: np.stack([grey] * 4, axis=-1),
        lambda grey: grey[..., None],
    ],
    ids=["16 bit", "unit", "gain and offset", "negative", "colour", "alpha", "one channel"],
)
def test_grey_scale_does_not_matter(picture, detection, change):
    other = detect_pattern(change(picture), SHEET)
    np.testing.assert_allclose(by_index(other), by_index(detection), atol=5e-3)


def test_a_mirrored_picture_is_refused(picture):
    for mirrored in (picture[:, ::-1], picture[::-1], picture.T):
        with pytest.raises(DetectionError, match="mirrored"):
            detect_pattern(np.ascontiguousarray(mirrored), SHEET)


def test_two_sheets_are_refused(picture):
    with pytest.raises(DetectionError, match="more than once"):
        detect_pattern(np.concatenate([picture, picture], axis=1), SHEET)


def test_another_sheet_is_refused(picture):
    other = Pattern.cross_grid(
        rows=8, columns=8, pitch_mm=20, radius_mm=6, rings=np.eye(8, dtype=bool), name="other"
    )
    with pytest.raises(DetectionError, match=r"fit the pattern 'other'.*focus the camera"):
        detect_pattern(picture, other)


@pytest.mark.parametrize("kind", ["blank", "noise", "round things"])
def test_no_sheet_is_said_to_be_none(kind):
    random = np.random.default_rng(1)
    if kind == "blank":
        empty = np.full((480, 512), 200, dtype=np.uint8)
    elif kind == "noise":
        empty = random.integers(0, 256, (480, 512)).astype(np.uint8)
    else:
        speck = Pattern.circle_grid(rows=1, columns=1, pitch_mm=20, radius_mm=1)
        things = round_things(random, count=40, reach_mm=150.0)
        empty = render_sheet(speck, CAMERA, supersampling=2, covers=things)
    with pytest.raises(DetectionError, match=r"No sheet|Only"):
        detect_pattern(empty, SHEET)


def test_a_corner_too_small_to_name_its_place_is_refused(picture, detection):
    first = detection.centres_px[np.isin(detection.circle_index, [0, 1, 8, 9])]
    low, high = first.min(axis=0).astype(int) - 16, first.max(axis=0).astype(int) + 16
    cut = np.full_like(picture, 228)
    cut[low[1] : high[1], low[0] : high[0]] = picture[low[1] : high[1], low[0] : high[0]]
    with pytest.raises(DetectionError):
        detect_pattern(cut, SHEET)


@pytest.mark.parametrize("seed", range(4))
def test_a_covered_sheet_keeps_right_labels(seed):
    random = np.random.default_rng(seed)
    cards = tuple(
        cover_card(random.uniform(-60, 60, 2), turn_deg=random.uniform(0, 180), grey=150.0)
        for _ in range(2)
    )
    covered = render_sheet(SHEET, CAMERA, noise_sigma=2.0, supersampling=4, covers=cards, seed=seed)
    detection = detect_pattern(covered, SHEET)
    assert len(detection) > 25
    assert np.abs(errors_px(detection, CAMERA, SHEET)).max() < 0.5


@pytest.mark.parametrize("style", ["stop", "through", "white"])
def test_lines_may_cross_circles(style):
    pattern = Pattern.cross_grid(rows=5, columns=5, pitch_mm=20, radius_mm=6, line_style=style)
    detection = detect_pattern(render_sheet(pattern, CAMERA, noise_sigma=2.0), pattern)
    assert len(detection) >= 23
    assert np.abs(errors_px(detection, CAMERA, pattern)).max() < 0.1
    assert np.all(np.isfinite(detection.lines_px))


@pytest.mark.parametrize(
    ("blur_px", "noise_sigma", "ink"), [(4.0, 2.0, 25.0), (0.7, 15.0, 25.0), (0.7, 2.0, 210.0)]
)
def test_bad_pictures_still_show_the_sheet(blur_px, noise_sigma, ink):
    poor = render_sheet(
        SHEET, CAMERA, ink=ink, blur_px=blur_px, noise_sigma=noise_sigma, supersampling=4, seed=9
    )
    detection = detect_pattern(poor, SHEET)
    assert len(detection) >= 60
    assert np.abs(errors_px(detection, CAMERA, SHEET)).max() < 0.3


def test_slanting_light_does_not_move_the_centres():
    light = Illumination(slope=(0.4, -0.3))
    lit = render_sheet(SHEET, CAMERA, paper=150.0, noise_sigma=1.0, light=light)
    error = errors_px(detect_pattern(lit, SHEET), CAMERA, SHEET)
    assert np.abs(error.mean(axis=0)).max() < 3e-3


@pytest.mark.parametrize("obliquity_deg", [60.0, 75.0])
def test_a_sheet_seen_at_a_slant_is_found(obliquity_deg):
    camera = Camera.from_degrees(
        table1_lens(),
        pan_deg=30.0,
        tilt_deg=90.0 - obliquity_deg,
        swing_deg=20.0,
        distance_mm=450.0,
    )
    picture = render_sheet(SHEET, camera, noise_sigma=2.0, table=90.0)
    detection = detect_pattern(picture, SHEET)
    assert len(detection) >= 60
    assert np.abs(errors_px(detection, camera, SHEET)).max() < 0.1


def test_a_plain_grid_names_its_other_labellings():
    pattern = Pattern.circle_grid(rows=5, columns=7, pitch_mm=20, radius_mm=6)
    detection = detect_pattern(render_sheet(pattern, CAMERA, noise_sigma=2.0), pattern)
    assert detection.ambiguity is not None
    assert detection.ambiguity.shape == (1, 35)
    np.testing.assert_array_equal(np.sort(detection.circle_index), np.arange(35))
    np.testing.assert_array_equal(detection.ambiguity[0], 34 - detection.circle_index)
    first, last = (detection.centres_px[detection.circle_index == k][0] for k in (0, 6))
    assert last[0] > first[0]
    assert np.abs(errors_px(detection, CAMERA, pattern)).max() < 0.05


def test_an_asymmetric_grid_has_one_labelling():
    pattern = Pattern.asymmetric_circle_grid(rows=11, columns=4, spacing_mm=14, radius_mm=5)
    detection = detect_pattern(render_sheet(pattern, CAMERA, noise_sigma=2.0), pattern)
    assert detection.ambiguity is None
    assert len(detection) == 44
    assert np.abs(errors_px(detection, CAMERA, pattern)).max() < 0.05


def test_a_plain_grid_with_a_column_missing_is_refused():
    pattern = Pattern.circle_grid(rows=6, columns=6, pitch_mm=20, radius_mm=6)
    shown = Pattern.circle_grid(rows=6, columns=5, pitch_mm=20, radius_mm=6)
    with pytest.raises(DetectionError, match="more than one position"):
        detect_pattern(render_sheet(shown, CAMERA, noise_sigma=2.0), pattern)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 4)),
        np.zeros(100),
        np.zeros((50, 50, 7)),
        np.full((50, 50), np.nan),
        np.array([["a"] * 50] * 50),
    ],
    ids=["tiny", "a line", "seven channels", "nan", "letters"],
)
def test_what_is_no_picture_is_said_to_be_none(image):
    with pytest.raises(InputError):
        detect_pattern(image, SHEET)
