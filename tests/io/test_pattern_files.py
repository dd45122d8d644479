"""Layout files and drawings of sheets."""

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from trinoc.calib.targets.pattern import LINE_STYLES, Pattern
from trinoc.errors import InputError
from trinoc.io.board_json import load_pattern, save_pattern
from trinoc.io.pattern_page import Polygon, lay_out, pattern_pdf, pattern_svg

READY = Path(__file__).parents[2] / "patterns"
FIELDS = ("centres_mm", "radius_mm", "inner_radius_mm", "lattice")


def assert_same(first: Pattern, second: Pattern) -> None:
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(first, field), getattr(second, field))
    assert (first.name, first.line_style) == (second.name, second.line_style)
    assert first.line_half_length_mm == second.line_half_length_mm
    assert (first.line_width_mm, first.line_gap_mm) == (second.line_width_mm, second.line_gap_mm)


@given(
    rows=st.integers(1, 6),
    columns=st.integers(1, 6),
    pitch_mm=st.floats(1, 100),
    style=st.sampled_from(LINE_STYLES),
    name=st.text(max_size=10),
)
def test_a_saved_layout_comes_back_to_the_last_digit(
    tmp_path_factory, rows, columns, pitch_mm, style, name
):
    path = tmp_path_factory.mktemp("layout") / "sheet.json"
    pattern = Pattern.cross_grid(
        rows=rows,
        columns=columns,
        pitch_mm=pitch_mm,
        radius_mm=0.3 * pitch_mm,
        line_style=style,
        name=name or "sheet",
    )
    save_pattern(pattern, path)
    assert_same(load_pattern(path), pattern)


def test_the_ready_sheet_is_the_default_one():
    assert_same(load_pattern(READY / "cross_8x8_20mm.json"), Pattern.default())


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_ready_drawings_are_those_of_the_layout(paper):
    page = lay_out(Pattern.default(), paper)
    svg = (READY / f"cross_8x8_20mm_{paper}.svg").read_text(encoding="utf-8")
    assert svg == pattern_svg(page)
    pytest.importorskip("reportlab", reason="PDF drawings need the extra `print`")
    committed = (READY / f"cross_8x8_20mm_{paper}.pdf").read_bytes()
    media_box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", committed)
    assert media_box is not None
    points = np.array([float(value) for value in media_box.groups()])
    np.testing.assert_allclose(points / 72 * 25.4, page.size_mm, atol=1e-4)
    assert b"/PrintScaling /None" in committed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda layout: layout.update(version=2), "version"),
        (lambda layout: layout.update(format="trinoc-rig"), "format"),
        (lambda layout: layout.update(lins={}), "lines"),
        (lambda layout: layout["circles"].pop("lattice"), "lattice"),
        (lambda layout: layout["circles"].update(radius_mm=-1), "not positive"),
        (lambda layout: layout["circles"].update(radius_mm=[6.0]), "radius_mm"),
        (lambda layout: layout["circles"]["lattice"][0].__setitem__(0, 0.5), "whole"),
        (lambda layout: layout["circles"]["lattice"][1].__setitem__(0, 5), "lattice"),
        (lambda layout: layout["lines"].update(style="dashed"), "line style"),
    ],
)
def test_a_bad_layout_is_refused_by_file_and_key(tmp_path, change, message):
    path = tmp_path / "sheet.json"
    save_pattern(Pattern.default(), path)
    layout = json.loads(path.read_text(encoding="utf-8"))
    change(layout)
    path.write_text(json.dumps(layout), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        load_pattern(path)
    assert str(path) in str(caught.value)


def test_one_radius_stands_for_all_and_lines_may_be_missing(tmp_path):
    path = tmp_path / "plain.json"
    pattern = Pattern.circle_grid(rows=3, columns=4, pitch_mm=20, radius_mm=5, name="plain")
    save_pattern(pattern, path)
    layout = json.loads(path.read_text(encoding="utf-8"))
    layout["circles"]["radius_mm"] = 5
    del layout["circles"]["inner_radius_mm"], layout["lines"]
    path.write_text(json.dumps(layout), encoding="utf-8")
    assert_same(load_pattern(path), pattern)


def test_svg_draws_every_circle_where_it_is():
    pattern = Pattern.default()
    page = lay_out(pattern, "a4")
    root = ElementTree.fromstring(pattern_svg(page))
    assert root.attrib["width"] == "210mm"
    assert root.attrib["viewBox"] == "0 0 210 297"
    circles = [node.attrib for node in root if node.tag.endswith("circle")]
    outer = np.array([[float(c["cx"]), float(c["cy"])] for c in circles if c["fill"] == "black"])
    drawn_mm = outer - outer.mean(axis=0)
    np.testing.assert_allclose(drawn_mm * np.array([1, -1]), pattern.centres_mm, atol=1e-4)
    assert sum(c["fill"] == "white" for c in circles) == pattern.is_ring.sum()


@pytest.mark.parametrize("paper", ["a4", "letter", "a3"])
def test_bars_have_their_nominal_length_and_all_lies_on_the_page(paper):
    page = lay_out(Pattern.default(), paper)
    half = np.array(page.size_mm) / 2 - 4.9
    corners = [figure.corners_mm for figure in page.figures if isinstance(figure, Polygon)]
    assert all(np.all(np.abs(each) <= half) for each in corners)
    bars = corners[-6:]
    for ticks, axis in ((bars[:3], 0), (bars[3:], 1)):
        ends = np.concatenate(ticks)[:, axis]
        np.testing.assert_allclose(np.ptp(ends), page.bars_mm[axis])


def test_white_cuts_stay_inside_their_circles():
    pattern = Pattern.cross_grid(rows=5, columns=5, pitch_mm=20, radius_mm=6, line_style="white")
    page = lay_out(pattern)
    cuts = [f.corners_mm for f in page.figures if isinstance(f, Polygon) and not f.is_ink]
    assert len(cuts) == 10
    shift = lay_out_shift(page, pattern)
    for corners in cuts:
        distance = np.linalg.norm(corners[:, None] - (pattern.centres_mm + shift)[None], axis=2)
        assert np.all(distance.min(axis=1) <= 6.0 + 1e-9)


def lay_out_shift(page, pattern: Pattern) -> np.ndarray:
    discs = [figure.centre_mm for figure in page.figures if hasattr(figure, "radius_mm")]
    return np.mean(np.unique(discs, axis=0), axis=0) - pattern.centres_mm.mean(axis=0)


def test_too_large_sheets_and_unknown_paper_are_refused():
    large = Pattern.cross_grid(rows=10, columns=14, pitch_mm=25, radius_mm=7, rings="none")
    with pytest.raises(InputError, match="larger paper"):
        lay_out(large, "a4")
    with pytest.raises(InputError, match="unknown"):
        lay_out(large, "a9")
    assert lay_out(large, "a2").size_mm == (420.0, 594.0)


def test_a_page_gives_the_same_pdf_every_time():
    pytest.importorskip("reportlab", reason="PDF drawings need the extra `print`")
    page = lay_out(Pattern.default())
    assert pattern_pdf(page) == pattern_pdf(page)
