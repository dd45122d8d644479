"""Orientation tags turn no pixel and are named once; white as zero is read as it is meant."""

import io
import logging
import struct

import numpy as np
import pytest
from PIL import Image

from trinoc.errors import InputError
from trinoc.io import picture_tags
from trinoc.io.images import read_image, read_size_px
from trinoc.io.picture_tags import as_stored, read_orientation

RANDOM = np.random.default_rng(58)
GREY = RANDOM.integers(0, 256, (5, 7), dtype=np.uint8)
DEEP = RANDOM.integers(0, 65536, (5, 7), dtype=np.uint16)
COLOUR = RANDOM.integers(0, 256, (5, 7, 3), dtype=np.uint8)


def encode(pixels, kind, orientation=None, **options):
    file = io.BytesIO()
    if orientation is not None:
        exif = Image.Exif()
        exif[274] = orientation
        options["exif"] = exif
    Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()


def deep_colour_tiff(orientation):
    """A TIFF of 16-bit colours with most significant bytes first, which Pillow does not write."""
    data = COLOUR.astype(">u2") * 257
    head = 8 + 2 + 9 * 12 + 4
    bits = head + data.nbytes
    tags = [(256, 3, 1, 7), (257, 3, 1, 5), (258, 3, 3, bits), (259, 3, 1, 1), (262, 3, 1, 2)]
    tags += [(273, 4, 1, head), (274, 3, 1, orientation), (277, 3, 1, 3), (278, 3, 1, 5)]
    entries = b"".join(
        struct.pack(">HHI", tag, kind, count)
        + (struct.pack(">HH", value, 0) if kind == 3 and count == 1 else struct.pack(">I", value))
        for tag, kind, count, value in tags
    )
    directory = struct.pack(">H", len(tags)) + entries + struct.pack(">I", 0)
    return (
        b"MM"
        + struct.pack(">HI", 42, 8)
        + directory
        + data.tobytes()
        + struct.pack(">3H", *[16] * 3)
    )


@pytest.fixture(autouse=True)
def no_folder_named(monkeypatch):
    monkeypatch.setattr(picture_tags, "_named_folders", set())


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize(
    ("name", "pixels", "kind", "options"),
    [
        ("a.tif", GREY, "TIFF", {}),
        ("a.tif", DEEP, "TIFF", {}),
        ("a.tif", COLOUR, "TIFF", {}),
        ("a.tif", COLOUR, "TIFF", {"compression": "tiff_lzw"}),
        ("a.tif", DEEP, "TIFF", {"big_tiff": True}),
        ("a.png", GREY, "PNG", {}),
        ("a.png", DEEP, "PNG", {}),
        ("a.png", COLOUR, "PNG", {}),
        ("a.webp", COLOUR, "WEBP", {"lossless": True}),
    ],
)
def test_pixels_are_read_as_stored(tmp_path, caplog, name, pixels, kind, options, orientation):
    content = encode(pixels, kind, orientation, **options)
    assert read_orientation(content) == orientation
    assert read_orientation(as_stored(content)) == (1 if kind == "TIFF" else orientation)
    file = tmp_path / name
    file.write_bytes(content)
    with caplog.at_level(logging.WARNING, logger="trinoc"):
        image = read_image(file)
        assert read_size_px(file) == (7, 5)
    assert image.dtype == pixels.dtype
    np.testing.assert_array_equal(image, pixels)
    assert len(caplog.records) == (orientation != 1)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_deep_colours_of_a_tiff_are_read_as_stored(tmp_path, orientation):
    (tmp_path / "a.tif").write_bytes(deep_colour_tiff(orientation))
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), COLOUR.astype(np.uint16) * 257)


def test_a_jpeg_is_the_same_whatever_its_tag(tmp_path):
    for orientation in (1, 6):
        (tmp_path / f"{orientation}.jpg").write_bytes(encode(COLOUR, "JPEG", orientation))
    np.testing.assert_array_equal(read_image(tmp_path / "1.jpg"), read_image(tmp_path / "6.jpg"))


def test_one_warning_for_a_folder_names_its_first_picture(tmp_path, caplog):
    for folder in ("left", "right"):
        (tmp_path / folder).mkdir()
        for number in range(3):
            tag = None if number == 0 else 3
            (tmp_path / folder / f"{number}.jpg").write_bytes(encode(GREY, "JPEG", tag))
    with caplog.at_level(logging.WARNING, logger="trinoc"):
        for file in sorted(tmp_path.rglob("*.jpg")):
            read_image(file)
    first = [record.getMessage().partition(" has a tag ")[0] for record in caplog.records]
    assert first == [str(tmp_path / folder / "1.jpg") for folder in ("left", "right")]


@pytest.mark.parametrize("pixels", [GREY, DEEP])
def test_white_as_zero_is_read_as_it_is_meant(tmp_path, pixels):
    white = np.iinfo(pixels.dtype).max
    content = bytearray(encode(white - pixels, "TIFF"))
    offset = picture_tags._tiff_value_at(bytes(content), 262)
    assert offset is not None
    content[offset : offset + 2] = b"\0\0"
    (tmp_path / "a.tif").write_bytes(bytes(content))
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), pixels)


def test_a_picture_drawn_in_its_transparency_is_refused(tmp_path):
    black = np.zeros((5, 7, 4), dtype=np.uint8)
    black[..., 3] = GREY
    Image.fromarray(black).save(tmp_path / "a.png")
    with pytest.raises(
        InputError, match=r"a\.png has a drawing in its transparency only.* on white"
    ):
        read_image(tmp_path / "a.png")
    black[..., 3] = 255
    Image.fromarray(black).save(tmp_path / "b.png")
    assert not read_image(tmp_path / "b.png").any()


def test_a_tiff_that_is_cut_anywhere_is_read_or_refused(tmp_path):
    content = encode(GREY, "TIFF", 6)
    for length in range(1, len(content)):
        (tmp_path / "a.tif").write_bytes(content[:length])
        try:
            read_image(tmp_path / "a.tif")
        except InputError:
            continue
