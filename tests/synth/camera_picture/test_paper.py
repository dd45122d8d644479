"""Ink spreads beyond the drawing, everywhere by the same width."""

import numpy as np
import pytest

from tests.synth.camera_picture.views import SHEET
from trinoc.synth.camera_picture import Paper
from trinoc.synth.camera_picture.paper import InkedLayout
from trinoc.synth.camera_picture.table import Table
from trinoc.synth.shapes import ConvexPolygon


def test_ink_gains_on_every_edge():
    inked = InkedLayout.of(SHEET, 0.2)
    np.testing.assert_allclose(inked.radius_mm, SHEET.radius_mm + 0.2)
    rings = SHEET.inner_radius_mm > 0
    np.testing.assert_allclose(inked.inner_radius_mm[rings], SHEET.inner_radius_mm[rings] - 0.2)
    assert not inked.inner_radius_mm[~rings].any()
    assert inked.line_width_mm == pytest.approx(SHEET.line_width_mm + 0.4)
    # From a circle's nominal edge to the line's end there is less white by one gain.
    reach = inked.radius_mm[0] + inked.line_gap_mm
    assert reach == pytest.approx(SHEET.radius_mm[0] + SHEET.line_gap_mm - 0.2)


def test_a_stretched_sheet_is_as_large_as_it_was():
    paper = Paper(print_scale=(1.02, 0.99), size_mm=(200.0, 100.0))
    table = paper.layers(SHEET)[0]
    assert isinstance(table, Table)
    assert isinstance(table.sheet, ConvexPolygon)
    size = np.ptp(table.sheet.corners_mm, axis=0) * paper.print_scale
    np.testing.assert_allclose(size, [200.0, 100.0])
