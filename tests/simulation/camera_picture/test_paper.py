"""Ink spreads beyond the drawing, everywhere by the same width."""

import numpy as np
import pytest

from simulation.camera_picture.layers import Paint
from simulation.camera_picture.paper import Paper, TableTop, printed_layers
from simulation.camera_picture.scene import SheetScene, radiance
from simulation.camera_picture.shapes import ConvexPolygon, FilledCircle
from tests.simulation.camera_picture.views import SHEET, camera_of


def figures(kind, gain_mm: float) -> list:
    """The figures of one kind of the print, lowest first."""
    layers = printed_layers(SHEET, paper=0.85, ink=0.09, ink_gain_mm=gain_mm)
    shapes = [layer.shape for layer in layers if isinstance(layer, Paint)]
    return [shape for shape in shapes if isinstance(shape, kind)]


def test_ink_gains_on_every_edge():
    rings = (SHEET.inner_radius_mm > 0).sum()
    lines = zip(figures(ConvexPolygon, 0.0), figures(ConvexPolygon, 0.2), strict=True)
    for drawn, inked in lines:
        grown = np.ptp(inked.corners_mm, axis=0) - np.ptp(drawn.corners_mm, axis=0)
        np.testing.assert_allclose(grown, 0.4)
    discs = zip(figures(FilledCircle, 0.0), figures(FilledCircle, 0.2), strict=True)
    change = [inked.radius_mm - drawn.radius_mm for drawn, inked in discs]
    # Circles grow; their holes and the white that ends the lines before them shrink.
    gaps = len(change) - len(SHEET) - rings
    assert gaps > 0
    np.testing.assert_allclose(change[:gaps], -0.2)
    np.testing.assert_allclose(change[gaps : gaps + len(SHEET)], 0.2)
    np.testing.assert_allclose(change[gaps + len(SHEET) :], -0.2)


def test_a_stretched_sheet_is_as_large_as_it_was():
    paper = Paper(print_scale=(1.02, 0.99), size_mm=(200.0, 100.0))
    table = paper.layers(SHEET)[0]
    assert isinstance(table, TableTop)
    assert isinstance(table.sheet, ConvexPolygon)
    size = np.ptp(table.sheet.corners_mm, axis=0) * paper.print_scale
    np.testing.assert_allclose(size, [200.0, 100.0])


def test_above_the_horizon_there_is_paper_or_table():
    camera = camera_of(tilt_deg=4.0)
    bare, on_table = (
        radiance(SHEET, camera, SheetScene(Paper(table=table))).by_pixel[0, 0]
        for table in (None, 0.3)
    )
    assert bare == pytest.approx(0.85)
    assert on_table == pytest.approx(0.3)
