"""A wire frame shows itself: as a card, a plot, a figure to turn and a table."""

import numpy as np
import pytest

from tests.io.formats.bench import bench_rig
from tests.io.made_wireframe import made_wireframe
from trinoc.report.features_part import features_figure

FRAME = made_wireframe()


def test_the_figure_has_every_edge_vertex_and_face_once() -> None:
    figure = features_figure(FRAME, bench_rig())
    sizes = {layer.name: len(layer.parts) for layer in figure.layers}
    assert sizes.pop("cameras") >= 3
    assert sizes == {
        "edges seen in three or more views (5)": 5,
        "edges seen in two views (2)": 2,
        "planar faces (2)": 2,
        "corners (5)": 5,
        "free ends (2)": 2,
    }
    words = [word for layer in figure.layers for word in layer.words]
    assert len(words) == len(FRAME) + len(FRAME.vertices_mm)
    assert any(word.startswith("edge 0: length 30") and "tracks 0, 1" in word for word in words)
    low, high = figure.views[0].box
    assert (low < FRAME.vertices_mm.min(axis=0)).all()
    assert (high > FRAME.vertices_mm.max(axis=0)).all()


def test_it_shows_itself_in_notebooks() -> None:
    card = FRAME._repr_html_()
    assert (
        "7 edges, 2 of them seen by two views only; 5 corners, 2 free ends, 2 planar faces" in card
    )
    assert "<svg" in card
    pytest.importorskip("pandas")
    table = FRAME.to_frame()
    assert len(table) == 7
    np.testing.assert_allclose(table["length_mm"][:2], [30, 20])
    assert (table["length_sigma_mm"] > 0).all()


def test_it_is_drawn(tmp_path) -> None:
    plt = pytest.importorskip("matplotlib.pyplot")
    axes = FRAME.plot(rig=bench_rig())
    lines = [c for c in axes.collections if type(c).__name__ == "Line3DCollection"]
    assert [len(c._segments3d) for c in lines[:2]] == [5, 2]
    plt.close("all")
    page = FRAME.show(rig=bench_rig()).html
    assert "planar faces (2)" in page
    assert "cameras" in page
