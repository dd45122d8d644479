"""Rims in space: one layer, with words, and a table of them on the page."""

import numpy as np

from tests.io.formats.bench import bench_rig
from tests.io.made_rims import made_rims
from trinoc.report.features_part import features_figure
from trinoc.report.html import render_report

RIMS = made_rims()


def test_the_figure_has_every_wire_with_its_words() -> None:
    figure = features_figure(RIMS, bench_rig())
    layer = figure.layers[0]
    assert layer.name == "rims (2)"
    assert len(layer.parts) == len(layer.descriptions) == 2
    assert "radius 15.0" in layer.descriptions[0]
    first, second = RIMS.views[:2]
    assert f"{first} 3; {second} 4, 0" in layer.descriptions[0]
    box = figure.views[0].box
    every = np.concatenate(layer.parts)
    assert (every > box.low_mm).all()
    assert (every < box.high_mm).all()


def test_the_page_has_a_table_of_them() -> None:
    page = render_report(rig=bench_rig(), features=(RIMS,))
    assert "Rims" in page
    assert "rims (2)" in page
