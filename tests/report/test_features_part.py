"""Cylinders in space: one layer, with words, and a table of them on the page."""

import numpy as np

from tests.io.formats.bench import bench_rig
from tests.io.made_cylinders import made_cylinders
from trinoc.report.features_part import features_figure
from trinoc.report.html import render_report

CYLINDERS = made_cylinders()


def test_the_figure_has_every_wire_with_its_words() -> None:
    figure = features_figure(CYLINDERS, bench_rig())
    layer = figure.layers[0]
    assert layer.name == "cylinders (2)"
    assert len(layer.parts) == len(layer.words) == 2 * 6
    assert "radius 12.0 ± 0.2 mm" in layer.words[0] or "12.00" in layer.words[0]
    assert "upper 3, 4; left 0, 9; right 2, 7" in layer.words[0]
    box = figure.views[0].box
    every = np.concatenate(layer.parts)
    assert (every > box.low_mm).all()
    assert (every < box.high_mm).all()


def test_the_page_has_a_table_of_them() -> None:
    page = render_report(rig=bench_rig(), features=(CYLINDERS,))
    assert "Cylinders" in page
    assert "cylinders (2)" in page
