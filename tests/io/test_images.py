"""Pictures keep their depth and their colours; everything else is refused in a sentence."""

import cv2
import numpy as np
import pytest

from trinoc.errors import InputError
from trinoc.io import read_image, read_views
from trinoc.io.images import is_whole_picture, load_shots

RANDOM = np.random.default_rng(5)
GREY = RANDOM.integers(0, 256, (12, 17), dtype=np.uint8)
DEEP = RANDOM.integers(0, 65536, (12, 17), dtype=np.uint16)
COLOUR = RANDOM.integers(0, 256, (12, 17, 3), dtype=np.uint8)


@pytest.mark.parametrize(
    ("name", "pixels"),
    [("a.png", GREY), ("a.tif", GREY), ("a.png", DEEP), ("a.tiff", DEEP), ("é b.png", DEEP)],
)
def test_grey_pictures_keep_every_bit(tmp_path, name, pixels):
    path = tmp_path / name
    path.write_bytes(cv2.imencode(path.suffix, pixels)[1].tobytes())
    image = read_image(path)
    assert image.dtype == pixels.dtype
    np.testing.assert_array_equal(image, pixels)


def test_colours_come_as_red_green_blue_without_transparency(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), COLOUR[..., ::-1])
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), COLOUR)
    transparent = np.concatenate([COLOUR[..., ::-1], GREY[..., None]], axis=2)
    cv2.imwrite(str(tmp_path / "b.png"), transparent)
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), COLOUR)


def test_what_is_no_picture_is_refused(tmp_path, capfd):
    cut = cv2.imencode(".png", GREY)[1].tobytes()[:40]
    for name, content, message in [
        ("empty.png", b"", "is empty: copy"),
        ("text.png", b"hello", "is not a readable picture"),
        ("cut.png", cut, "is a PNG file that is incomplete"),
        ("left.mp4", b"hello", "is a video: write its frames"),
    ]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=f"{name} {message}"):
            read_image(tmp_path / name)
    with pytest.raises(InputError, match="does not exist"):
        read_image(tmp_path / "none.png")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_a_picture_that_was_not_written_to_its_end_is_refused(tmp_path, capfd, ending):
    path = tmp_path / f"cut{ending}"
    content = cv2.imencode(ending, GREY)[1].tobytes()
    for length in (0, 40, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        assert not is_whole_picture(path)
        if length > 8:
            with pytest.raises(
                InputError, match=r"not a readable picture|is incomplete|that is incomplete"
            ):
                read_image(path)
    path.write_bytes(content + b"what cameras add")
    assert is_whole_picture(path)
    np.testing.assert_allclose(read_image(path), GREY, atol=0 if ending == ".png" else 60)
    assert capfd.readouterr() == ("", "")


def test_folder_is_refused_with_a_picture_to_take(tmp_path):
    with pytest.raises(InputError, match="is a folder without pictures"):
        read_image(tmp_path)
    cv2.imwrite(str(tmp_path / "one.png"), GREY)
    with pytest.raises(InputError, match=r"give one picture in it, such as .*one\.png"):
        read_image(tmp_path)


def test_one_picture_for_two_views_is_refused_whatever_the_file(tmp_path):
    cv2.imwrite(str(tmp_path / "one.png"), GREY)
    cv2.imwrite(str(tmp_path / "same.tif"), GREY)
    cv2.imwrite(str(tmp_path / "other.png"), DEEP)
    views = read_views({"upper": tmp_path / "one.png", "left": tmp_path / "other.png"})
    assert list(views) == ["upper", "left"]
    with pytest.raises(InputError, match='"upper" and "left" are the same picture'):
        read_views({"upper": tmp_path / "one.png", "left": tmp_path / "same.tif"})


def test_a_folder_of_shots_that_is_not_there_or_empty_is_called_so(tmp_path):
    (tmp_path / "empty").mkdir()
    for folder, message in (
        ("none", "does not exist"),
        ("empty", "holds no picture"),
        ("n*", "holds"),
    ):
        with pytest.raises(InputError, match=message):
            load_shots({"left": tmp_path / folder})


@pytest.mark.parametrize("name", ["dark", "twelve"])
def test_levels_of_a_16_bit_file_are_kept_whatever_part_they_fill(tmp_path, name):
    """12 bit in 16, and a dark picture: nothing stretches or cuts them."""
    pixels = DEEP >> 4 if name == "twelve" else DEEP % 300
    for suffix in (".png", ".tif"):
        path = tmp_path / f"{name}{suffix}"
        path.write_bytes(cv2.imencode(suffix, pixels)[1].tobytes())
        np.testing.assert_array_equal(read_image(path), pixels)
