"""One grey conversion for all: without an order of channels, exact where numbers are whole."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

import trinoc
from trinoc.image.grey import grey_image

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
    ("image", "said"),
    [
        (np.zeros((20, 20, 5)), "shape"),
        (np.zeros((8, 20)), "at least 16 px"),
        (np.full((20, 20), np.nan), "not finite"),
        (np.full((20, 20), "a"), "no grey levels"),
    ],
)
def test_what_is_no_picture_is_refused(image, said):
    with pytest.raises(trinoc.errors.InputError, match=said):
        grey_image(image)
