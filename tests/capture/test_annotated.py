"""The annotated picture of a failed detection marks possible circles."""

import cv2
import numpy as np
import pytest

from trinoc.capture.annotated import failure_picture

CENTRES = [(100, 80), (300, 120), (220, 300), (420, 360)]
RADIUS = 16


def discs(dtype: type, scale: int = 1) -> np.ndarray:
    picture = np.full((480 * scale, 640 * scale), 220, np.uint8)
    for u, v in CENTRES:
        cv2.circle(picture, (u * scale, v * scale), RADIUS * scale, 30, -1, cv2.LINE_AA)
    return picture if dtype is np.uint8 else (picture / 255).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("scale", [1, 4])
def test_rings_stand_around_what_could_be_circles_and_nowhere_else(dtype, scale) -> None:
    drawn = failure_picture(discs(dtype, scale), ["no sheet"])
    height = round(drawn.shape[1] * 480 / 640)
    picture = drawn[len(drawn) - height :].astype(int)
    coloured = np.argwhere(picture[..., 0] - picture[..., 2] > 60)[:, ::-1]
    zoom = drawn.shape[1] / 640
    distance = np.linalg.norm(coloured[:, None] / zoom - np.array(CENTRES), axis=2)
    nearest = distance.min(axis=1)
    assert (np.abs(nearest - RADIUS) < 7).all()
    assert set(distance.argmin(axis=1)) == set(range(len(CENTRES)))


def test_words_take_the_room_that_they_need() -> None:
    picture = discs(np.uint8)
    short, long = (failure_picture(picture, ["word " * count]) for count in (3, 60))
    assert len(long) > len(short)
    assert (short[0] == 255).all()
    assert short.shape[1] == long.shape[1] == 640
