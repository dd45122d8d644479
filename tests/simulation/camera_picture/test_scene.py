"""Edges share the cells that they cross by area."""

from itertools import pairwise

import numpy as np
import pytest

from simulation.camera_picture.layers import cover_card, coverage_of_cells, finger
from simulation.camera_picture.light import Illumination, Shadow
from simulation.camera_picture.paper import Paper
from simulation.camera_picture.scene import MARGIN_PX, SheetScene, radiance
from tests.simulation.camera_picture.views import CELLS, SHEET, camera_of, cells_of
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry import project
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics

PAPER, INK, TABLE = 0.8, 0.1, 0.3


def area_of_disc_in_box(radius, low, high):
    """Area of a disc about the origin within a box, from the integral of its chords."""
    (x0, y0), (x1, y1) = low, high

    def half_chord_integral(x):
        x = np.clip(x, -radius, radius)
        return (x * np.sqrt(radius**2 - x**2) + radius**2 * np.arcsin(x / radius)) / 2

    turns = [np.sqrt(radius**2 - y**2) for y in (y0, y1) if abs(y) < radius]
    breaks = np.array([x0, x1, -radius, radius, *turns, *(-turn for turn in turns)])
    breaks = np.unique(np.clip(breaks, x0, x1))
    area = 0.0
    for first, second in pairwise(breaks):
        middle = (first + second) / 2
        if abs(middle) >= radius:
            continue
        chord = np.sqrt(radius**2 - middle**2)
        curved = half_chord_integral(second) - half_chord_integral(first)
        if min(y1, chord) > max(y0, -chord):
            area += curved if chord < y1 else y1 * (second - first)
            area -= -curved if -chord > y0 else y0 * (second - first)
    return area


def test_cells_are_shared_as_segments_of_the_circle_are():
    # Straight above the sheet, two pixels to the millimetre, the disc's centre off the grid.
    centre = (29.3, 24.1)
    lens = Intrinsics(focal_length_px=600.0, image_size_px=(60, 50), principal_point_px=centre)
    camera = Camera.from_degrees(lens, pan_deg=0, tilt_deg=90, swing_deg=0, distance_mm=300.0)
    disc = Pattern.cross_grid(
        rows=1, columns=1, pitch_mm=40.0, radius_mm=9.0, line_width_mm=0.0, rings="none"
    )
    fine = cells_of(radiance(disc, camera, SheetScene(Paper(paper=PAPER, ink=INK))))
    share = (PAPER - fine) / (PAPER - INK)
    row, column = np.indices(fine.shape)
    # The first cell begins half a pixel before the centre of the margin's first pixel.
    corners = np.stack([column, row], axis=-1) / CELLS - 0.5 - MARGIN_PX - np.array(centre)
    cut = np.argwhere((share > 1e-6) & (share < 1 - 1e-6))
    assert len(cut) > 4 * 18
    for k, j in cut:
        low = corners[k, j]
        exact = area_of_disc_in_box(18.0, low, low + 1 / CELLS) * CELLS**2
        # An edge counts as straight within a cell: its bow is h / (8 r) of the cell at most.
        assert share[k, j] == pytest.approx(exact, abs=1 / (8 * CELLS * 18))
    assert share.sum() / CELLS**2 == pytest.approx(np.pi * 18.0**2, rel=1e-5)


def level_at(fine, camera, x, y):
    u, v = np.asarray(project(camera, np.array([x, y, 0.0])))
    row, column = ((np.array([v, u]) + MARGIN_PX + 0.5) * CELLS).astype(int)
    return fine[row, column]


def test_paper_ink_and_table_have_their_reflectance():
    camera = camera_of()
    paper = Paper(paper=PAPER, ink=INK, table=TABLE, size_mm=(90.0, 80.0))
    fine = cells_of(radiance(SHEET, camera, SheetScene(paper)))
    assert level_at(fine, camera, 22.0, 22.0) in (pytest.approx(INK), pytest.approx(PAPER))
    assert level_at(fine, camera, 4.0, -11.0) == pytest.approx(PAPER)
    assert level_at(fine, camera, 60.0, 0.0) == pytest.approx(TABLE, rel=0.1)


def test_light_covers_and_shadows_lie_where_they_are_put():
    camera, paper = camera_of(), Paper(paper=PAPER, ink=INK)
    light = Illumination(slope=(0.5, 0.0), shadows=(Shadow((-30.0, 0.0), 180.0, light_left=0.25),))
    covers = (finger((4.0, -30.0), -90.0, grey=0.5), cover_card((35.0, 10.0), size_mm=(6.0, 8.0)))
    fine = cells_of(radiance(SHEET, camera, SheetScene(paper, light, covers)))
    # The light over a whole pixel is that at its centre.
    assert level_at(fine, camera, 11.0, -11.0) == pytest.approx(PAPER * 1.055, rel=0.02)
    assert level_at(fine, camera, -40.0, 11.0) == pytest.approx(0.25 * PAPER * 0.8, rel=0.02)
    assert level_at(fine, camera, 4.0, -40.0) == pytest.approx(0.5 * 1.02, rel=0.02)
    assert level_at(fine, camera, 35.0, 10.0) == pytest.approx(0.55 * 1.175, rel=0.02)


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 4, 1.2, np.pi / 2])
@pytest.mark.parametrize("offset", [-0.9, -0.31, 0.0, 0.2, 0.66])
def test_a_straight_edge_shares_a_cell_exactly(turn, offset):
    rows, columns = np.indices((3, 3)) - 1.0
    level = np.cos(turn) * columns + np.sin(turn) * rows - offset
    fine = (np.arange(1000) + 0.5) / 1000 - 0.5
    u, v = np.meshgrid(fine, fine)
    counted = np.mean(np.cos(turn) * u + np.sin(turn) * v - offset < 0)
    assert coverage_of_cells(level[None])[0, 1, 1] == pytest.approx(counted, abs=1e-3)
