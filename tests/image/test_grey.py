"""The grey conversion does not depend on the order of the channels and is exact for integers."""

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import trinoc
from trinoc.image.grey import (
    describe_interlacing,
    describe_mixed_pixels,
    describe_mosaic,
    grey_image,
)
from trinoc.io.demo import demo_images

SHAPE = (16, 17, 3)
COLOURS = st.sampled_from((np.uint8, np.uint16, np.float32)).flatmap(
    lambda kind: (
        arrays(kind, SHAPE, elements=st.floats(0, 1e3, width=32))
        if kind is np.float32
        else arrays(kind, SHAPE)
    )
)


@given(COLOURS)
def test_the_order_of_channels_does_not_matter_to_the_last_bit(image):
    np.testing.assert_array_equal(grey_image(image).grey, grey_image(image[..., ::-1]).grey)


@given(arrays(np.uint16, SHAPE[:2]))
def test_equal_channels_are_grey(image):
    alone, three = grey_image(image), grey_image(np.stack([image] * 3, axis=-1))
    np.testing.assert_array_equal(alone.grey, three.grey)
    assert (alone.quantum, alone.white) == (three.quantum, three.white)


def test_alpha_says_nothing():
    image = np.random.default_rng(1).integers(0, 256, SHAPE, dtype=np.uint8)
    with_alpha = np.concatenate([image, np.zeros((*SHAPE[:2], 1), np.uint8)], axis=2)
    np.testing.assert_array_equal(grey_image(image).grey, grey_image(with_alpha).grey)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((20, 20, 5)), "shape"),
        (np.zeros((8, 20)), "at least 16 px"),
        (np.full((20, 20), np.nan), "not finite"),
        (np.full((20, 20), "a"), "no grey levels"),
    ],
)
def test_what_is_no_picture_is_refused(image, message):
    with pytest.raises(trinoc.errors.InputError, match=message):
        grey_image(image)


def with_fields(picture, moved_px):
    """An interlaced picture: its odd rows show the scene after a motion along the rows."""
    interlaced = picture.copy()
    interlaced[1::2] = np.roll(picture, moved_px, axis=1)[1::2]
    return interlaced


@pytest.mark.parametrize("kind", ["scene", "sheet"])
@pytest.mark.parametrize("moved_px", [-1, 2, 8])
def test_an_interlaced_picture_is_named_whatever_its_levels(kind, moved_px):
    picture = with_fields(demo_images(kind)["left"], moved_px)
    for scaled in (picture, picture // 2, picture.astype(np.uint16) * 16, picture / 255.0):
        description = describe_interlacing(grey_image(scaled))
        assert description is not None
        assert "interlaced" in description


def test_a_picture_of_one_moment_is_not_called_interlaced():
    noise = np.random.default_rng(3)
    for kind in ("scene", "sheet"):
        for picture in demo_images(kind).values():
            assert describe_interlacing(grey_image(picture)) is None
            assert describe_interlacing(grey_image(with_fields(picture, 8).T)) is None
            assert describe_interlacing(grey_image(with_fields(picture, 0))) is None
            noisy = np.clip(picture + noise.normal(0, 20, picture.shape), 0, 255)
            assert describe_interlacing(grey_image(noisy.astype(np.uint8))) is None
    assert (
        describe_interlacing(grey_image(noise.integers(0, 256, (90, 120), dtype=np.uint8))) is None
    )
    assert describe_interlacing(grey_image(np.zeros((16, 16), np.uint8))) is None


def as_mosaic(picture, red, blue):
    """RGGB mosaic of a grey scene, with red and blue pixels darker than green by these factors."""
    raw = picture.astype(float)
    raw[::2, ::2] *= red
    raw[1::2, 1::2] *= blue
    return raw.astype(picture.dtype)


@pytest.mark.parametrize(("red", "blue"), [(0.6, 0.5), (0.5, 1.0), (1.0, 0.85)])
@pytest.mark.parametrize("kind", ["scene", "sheet"])
def test_a_raw_mosaic_is_named_whatever_its_levels_and_first_colour(kind, red, blue):
    picture = as_mosaic(demo_images(kind)["left"], red, blue)
    for variant in (
        picture,
        picture[1:],
        picture[:, 1:],
        picture.astype(np.uint16) * 16,
        picture / 255,
    ):
        assert "bayer=" in (describe_mosaic(grey_image(variant)) or "")
        assert describe_mixed_pixels(grey_image(variant)) is not None
    colours = cv2.cvtColor(picture, cv2.COLOR_BayerRGGB2RGB)
    assert describe_mosaic(grey_image(colours)) is None


def test_grey_pictures_are_no_mosaics():
    noise = np.random.default_rng(4)
    for kind in ("scene", "sheet"):
        for picture in demo_images(kind).values():
            assert describe_mixed_pixels(grey_image(picture)) is None
            assert describe_mosaic(grey_image(as_mosaic(picture, 0.98, 1.0))) is None
    for size in (16, 33, 90):
        assert (
            describe_mosaic(grey_image(noise.integers(0, 256, (size, size), dtype=np.uint8)))
            is None
        )
    assert describe_mosaic(grey_image(np.zeros((16, 16), np.uint8))) is None


def test_fine_texture_that_alternates_both_ways_is_of_one_moment():
    texture = np.zeros((90, 120), np.uint8)
    texture[::2, :60] = 200
    assert describe_interlacing(grey_image(texture)) is not None
    texture[:, 60::2] = 200
    assert describe_interlacing(grey_image(texture)) is None
