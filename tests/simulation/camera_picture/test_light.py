"""Light: the mirror law, the lens's corners."""

import numpy as np
import pytest

from simulation.camera_picture.light import (
    GlareLamp,
    Illumination,
    light_on_sheet,
    passed_by_lens,
    reflection,
)
from simulation.camera_picture.paper import Paper
from simulation.camera_picture.sheet_view import SheetView
from tests.simulation.camera_picture.views import camera_of


def seen_in_world(camera):
    view = SheetView(camera, Paper())
    return view.points_world_mm(view.centres_mm(0))


def test_the_lamp_is_brightest_where_a_mirror_would_show_it():
    camera = camera_of()
    world = seen_in_world(camera)
    lamp = GlareLamp((12.0, -7.0), roughness=0.02, strength=0.6)
    spot = reflection(lamp, camera, world)
    row, column = np.unravel_index(spot.argmax(), spot.shape)
    assert np.hypot(*(world[row, column, :2] - lamp.spot_mm)) < 2.0
    assert spot.max() == pytest.approx(0.6, rel=0.02)


def test_a_rougher_sheet_spreads_the_lamp_and_a_tilted_one_moves_it():
    camera = camera_of()
    world = seen_in_world(camera)
    narrow, wide = (
        reflection(GlareLamp((0.0, 0.0), roughness=roughness), camera, world)
        for roughness in (0.03, 0.06)
    )
    # Areas grow with the square of the width.
    assert wide.sum() / narrow.sum() == pytest.approx(4.0, rel=0.2)
    tilted = world.copy()
    tilted[..., 2] += 0.02 * tilted[..., 0]
    moved = reflection(GlareLamp((0.0, 0.0), roughness=0.03), camera, tilted)
    middle, there = (np.average(world[..., 0], weights=spot) for spot in (narrow, moved))
    # A normal that leans to -X sees the lamp's mirror image further along X.
    assert abs(there - middle) > 2.0


def test_the_lens_dims_the_corners_and_not_the_middle():
    passed = passed_by_lens(Illumination(vignetting=0.4), (97, 91), 0)
    assert passed[45, 48] == 1.0
    np.testing.assert_allclose(passed[[0, 0, -1, -1], [0, -1, 0, -1]], 0.6)


def test_a_quadratic_field_is_one_in_the_middle_and_where_there_is_no_sheet():
    light = Illumination((0.2, 0.0), (0.1, 0.0, -0.3))
    points = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, -100.0], [np.nan, np.nan]])
    np.testing.assert_allclose(light_on_sheet(light, points), [1.0, 1.3, 0.7, 1.0])
