"""The scale of grey levels follows from the picture's range, and empty results are explained."""

import cv2
import numpy as np
import pytest

import trinoc
from trinoc.image.grey import grey_image
from trinoc.io import demo_images
from trinoc.segments import why_nothing
from trinoc.segments.nothing_found import why_short


def scene():
    """A bright block on a dark ground, with a little noise."""
    grey = np.full((96, 112), 60.0)
    grey[30:70, 25:90] = 190.0
    noise = np.random.default_rng(4).normal(0, 1, grey.shape)
    return np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8)


def ends(image):
    return np.asarray(trinoc.find_segments(image).endpoints_px)


@pytest.mark.parametrize(
    "delivered",
    [
        lambda a: a / 255.0,
        lambda a: (a / 255.0).astype(np.float32),
        lambda a: a.astype(float),
        lambda a: a.astype(np.uint16),
        lambda a: a.astype(np.int64),
        lambda a: a.astype(np.uint16) * 257,
        lambda a: a.astype(float) * 257,
        lambda a: np.rint(a * (1023 / 255)).astype(np.uint16),
        lambda a: np.rint(a * (4095 / 255)).astype(np.uint16),
        lambda a: np.rint(a * (16383 / 255)).astype(np.uint16),
    ],
)
def test_however_the_levels_are_delivered_the_segments_are_those_of_8_bit(delivered):
    # White somewhere, as in a picture that is well exposed.
    picture = scene()
    picture[0, 0] = 255
    expected = ends(picture)
    assert len(expected) == 4
    np.testing.assert_allclose(ends(delivered(picture)), expected, atol=0.02)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_pictures_that_fill_their_type_are_as_they_were_to_the_last_bit(kind):
    image = np.random.default_rng(1).integers(0, np.iinfo(kind).max + 1, (40, 50)).astype(kind)
    scaled = grey_image(image).in_255ths()
    scale = 1.0 if kind is np.uint8 else 1 / 257
    np.testing.assert_array_equal(scaled.grey, image.astype(np.float32) * np.float32(scale))
    assert (scaled.quantum, scaled.white) == (scale, 254.0)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.full((40, 50), 7, np.uint8), "same grey level"),
        (np.tile(np.repeat([100, 103], 25), (40, 1)).astype(np.uint8), "least_contrast is 7"),
        (np.random.default_rng(2).normal(120, 12, (90, 90)), "noise"),
    ],
)
def test_nothing_is_explained(image, message):
    assert len(ends(image)) == 0
    assert message in why_nothing(image)


def test_a_disc_is_sharp_but_not_straight():
    v, u = np.mgrid[:90, :90] - 45.0
    image = 40 + 160 / (1 + np.exp(2 * (np.hypot(u, v) - 12)))
    assert len(ends(image)) == 0
    assert "none is straight" in why_nothing(image)


@pytest.mark.parametrize("times", [4, 8])
def test_of_a_picture_that_was_enlarged_it_is_said_by_how_much_it_is_soft(times):
    picture = demo_images("scene")["upper"]
    assert why_short(picture) is None
    # Whatever the exposure, and whichever way round the picture lies.
    for variant in (picture, picture.T // 2):
        enlarged = cv2.resize(variant, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)
        explanation = why_short(enlarged)
        assert explanation is not None
        # The demo's lens blurs by .7 px, and so many pixels lie within one of the picture's.
        assert any(f"about {blur} px" in explanation for blur in range(times // 2, times + 1))
    assert why_short(np.full((40, 50), 7, np.uint8)) is None
    assert why_short(picture[:16, :40]) is None
