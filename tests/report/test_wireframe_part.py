"""A wireframe has a notebook card, a plot, a 3-D figure and a table."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import trinoc
from tests.io.formats.bench import bench_rig
from tests.io.made_rims import made_rims
from tests.io.made_wireframe import made_wireframe
from trinoc.geometry.features import Feature
from trinoc.io.formats.registry import FORMATS
from trinoc.match.rims.rims import Rims
from trinoc.match.tracks.matches import Matches
from trinoc.match.wire_frame.frame import LetGo, Wireframe
from trinoc.report.features_part import features_figure, features_record, features_text
from trinoc.report.html import render_report

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
    descriptions = [description for layer in figure.layers for description in layer.descriptions]
    assert len(descriptions) == len(FRAME) + len(FRAME.vertices_mm)
    assert any(
        description.startswith("edge 0: length 30") and "tracks 0, 1" in description
        for description in descriptions
    )
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


def squares(count: int) -> Wireframe:
    """A wireframe of `count` squares in one plane, with four edges each."""
    corners = np.array([[0.0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]])
    vertices_mm = (corners + np.arange(count)[:, None, None] * [20.0, 0, 0]).reshape(-1, 3)
    first = 4 * np.arange(count)[:, None]
    edges = np.stack(
        [first + np.array([0, 1, 2, 0]), first + np.array([1, 2, 3, 3])], axis=2
    ).reshape(-1, 2)
    vertices, lines = 4 * count, 4 * count
    return Wireframe(
        vertices_mm=vertices_mm,
        corner=np.ones(vertices, dtype=bool),
        vertex_chi_square=np.zeros(vertices),
        vertex_degrees=np.zeros(vertices, dtype=np.int64),
        part=np.repeat(np.arange(count), 4),
        joint_covariance_mm2=(np.eye(12),) * count,
        edges=edges,
        posterior=np.full(lines, 0.9),
        views=np.where(np.arange(lines) % 2, 3, 2),
        viewpoint_dependent=np.zeros(lines, dtype=bool),
        chi_square=np.zeros(lines),
        degrees=np.zeros(lines, dtype=np.int64),
        edge_of_track=np.arange(lines),
        face=np.repeat(np.arange(count), 4),
        face_vertex=np.arange(vertices),
        planes=np.tile([0.0, 0, 1, 0], (count, 1)),
        planes_covariance=np.tile(np.eye(4), (count, 1, 1)),
        face_chi_square=np.zeros(count),
        face_degrees=np.zeros(count, dtype=np.int64),
        facing=np.ones(count, dtype=bool),
        let_go=LetGo(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0, "<U1")),
    )


def several_rims(count: int) -> Rims:
    """The rims of `made_rims`, repeated."""
    return made_rims().take(np.arange(count) % 2)


@pytest.mark.parametrize("make", [squares, several_rims])
def test_no_loop_reads_what_a_property_computes(make, tmp_path, monkeypatch) -> None:
    """Each output of features reads a property equally often for many features as for few."""
    reads = Counter()

    def count_reads(kind: type, name: str, compute: Callable) -> property:
        def read(value: Feature) -> Any:
            reads[f"{kind.__name__}.{name}"] += 1
            return compute(value)

        return property(read)

    for kind in (Wireframe, Rims, Matches):
        for name, member in vars(kind).items():
            if isinstance(member, property) and name != "checked":
                assert member.fget is not None
                monkeypatch.setattr(kind, name, count_reads(kind, name, member.fget))

    def reads_of(features: Feature) -> Counter:
        reads.clear()
        render_report(rig=bench_rig(), features=(features,))
        features_text(features)
        features_record(features)
        features._repr_html_()
        for name in ("ply", "obj", "dxf", "gltf", *(["json"] if make is squares else [])):
            file_format = FORMATS[name]
            path = tmp_path / f"{len(features)}-{name}{file_format.endings[0]}"
            file_format.save(features, path)
        trinoc.save(features, tmp_path / f"{len(features)}.npz")
        return Counter(reads)

    few, many = reads_of(make(2)), reads_of(make(9))
    assert few == many
    assert sum(few.values()) > 0
