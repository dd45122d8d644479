"""Mistakes in a first call in Python have messages that name the cause."""

import numpy as np
import pytest

from trinoc.calib.sheet_inputs import check_images
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError

PICTURE = np.zeros((4, 6), np.uint8)
SHEET = Pattern.circle_grid(rows=3, columns=4, pitch_mm=10.0, radius_mm=2.0)


@pytest.mark.parametrize(
    ("images", "pattern", "message"),
    [
        ({"left": None}, SHEET, 'camera "left" is None'),
        ({"left": "left.png"}, SHEET, "is a str, but must be an array"),
        ({"left": PICTURE[0]}, SHEET, "must be an array with height and width"),
        ([PICTURE], SHEET, "of type list. Give a dictionary"),
        ({"left": PICTURE}, "sheet.json", "of type str. Give a trinoc.Pattern"),
    ],
)
def test_slips_are_named(images, pattern, message):
    with pytest.raises(InputError, match=message):
        check_images(images, pattern)


def test_grey_and_colours_pass():
    check_images({"left": PICTURE, "right": np.zeros((4, 6, 3))}, SHEET)
