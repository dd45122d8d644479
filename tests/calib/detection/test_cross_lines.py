"""The crossed lines lie where they were drawn, also where something dark touches them."""

import numpy as np
import pytest

from trinoc.calib.detection.cross_lines import fit_cross_lines
from trinoc.calib.detection.plane_mapping import PlaneMapping
from trinoc.calib.detection.search_image import SearchImage
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING

# Lines between the circles of eight rows and columns, 3 pixels a millimetre, turned.
SHEET = Pattern.cross_grid(rows=8, columns=8, pitch_mm=20.0, radius_mm=6.0)
PX_PER_MM, TURN, MIDDLE_PX = 3.0, np.radians(3.0), np.array([300.4, 299.7])
ROTATION = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]])
PAPER, INK, NOISE, BLUR_PX = 220.0, 40.0, 1.0, 0.8


def mapping() -> PlaneMapping:
    homography = np.eye(3)
    homography[:2, :2], homography[:2, 2] = PX_PER_MM * ROTATION, MIDDLE_PX
    return PlaneMapping(homography, np.zeros((10, 2)), np.zeros(2), 1.0)


def drawn_lines() -> SearchImage:
    """Image of the two lines alone."""
    rows, columns = np.mgrid[:600, :600]
    offset_px = np.stack([columns, rows], axis=-1) - MIDDLE_PX
    x, y = np.moveaxis(offset_px @ ROTATION, -1, 0)
    half_px = 0.5 * SHEET.line_width_mm * PX_PER_MM
    along_x, along_y = (
        1 / (1 + np.exp(1.7 * (np.abs(across) - half_px) / BLUR_PX)) for across in (y, x)
    )
    grey = PAPER - (PAPER - INK) * np.maximum(along_x, along_y)
    return SearchImage(grey + np.random.default_rng(0).normal(0, NOISE, grey.shape), NOISE)


def errors_px(image: SearchImage) -> np.ndarray:
    """Distances of points of the true lines along X and Y from the fitted ones."""
    lines = fit_cross_lines(image, SHEET, mapping(), BLUR_PX, TUNING)
    reach_px = 0.8 * PX_PER_MM * np.array(SHEET.line_half_length_mm)
    steps = np.linspace(-1, 1, 9)[:, None]
    return np.array(
        [
            np.abs((MIDDLE_PX + reach * steps * ROTATION[:, axis]) @ line[:2] + line[2]).max()
            for axis, (line, reach) in enumerate(zip(lines, reach_px, strict=True))
        ]
    )


def test_lines_lie_where_they_were_drawn() -> None:
    assert errors_px(drawn_lines()).max() < 0.03


@pytest.mark.parametrize("side", [-1, 1])
def test_a_dark_thing_beside_a_line_does_not_turn_it(side: int) -> None:
    """A label touches the line along X over a seventh of its length, at one end."""
    image = drawn_lines()
    half_px = SHEET.line_half_length_mm[0] * PX_PER_MM
    rows, columns = np.mgrid[:600, :600]
    x, y = np.moveaxis((np.stack([columns, rows], axis=-1) - MIDDLE_PX) @ ROTATION, -1, 0)
    label = (x > 0.68 * half_px) & (x < 0.95 * half_px) & (side * y > 0) & (side * y < 5)
    image.grey[label] = INK
    assert errors_px(image).max() < 0.15
