"""One description of a table, drawn on the page, in notebooks and in a terminal."""

import re
from html import unescape

import pytest

from tests.io.formats.bench import bench_rig
from tests.io.made_rims import made_rims
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import Matches
from trinoc.report.features_part import feature_table
from trinoc.report.html import ExtraTable, render_report
from trinoc.report.matches_part import reasons_table, tracks_table
from trinoc.report.notebook.cards import ROWS, make_card
from trinoc.report.parameter_table import rig_table
from trinoc.report.report_table import Cell, ReportTable, draw_table, draw_text

HOSTILE = '</td><script>alert("x")</script>&'


def cells_of(html: str) -> list[str]:
    """The texts of all cells of all tables, in order."""
    cells = re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", html, flags=re.DOTALL)
    return [unescape(re.sub(r"<[^>]+>", "", cell)) for cell in cells]


def texts_of(table: ReportTable, rows: int | None = None) -> list[str]:
    """The texts of a table's head and of its first rows."""
    return [*table.head, *(c.text for row in list(table.cells())[:rows] for c in row)]


def holds(html: str, texts: list[str]) -> bool:
    """Return True if HTML contains these cells of a table in this order."""
    cells = cells_of(html)
    return any(cells[k : k + len(texts)] == texts for k in range(len(cells)))


def test_page_and_card_draw_one_table(rig: Rig, matches: Matches) -> None:
    rims = made_rims()
    page = render_report(rig=rig, matches=matches)
    for table in (rig_table(rig), tracks_table(matches), reasons_table(matches)):
        assert holds(page, texts_of(table))
    assert holds(make_card(rig), texts_of(rig_table(rig)))
    assert holds(make_card(matches), texts_of(tracks_table(matches), ROWS))
    assert f"{len(matches) - ROWS} more rows: to_frame()" in make_card(matches)
    assert holds(make_card(rims), texts_of(feature_table(rims)))
    assert holds(render_report(rig=bench_rig(), features=(rims,)), texts_of(feature_table(rims)))


def test_a_table_in_a_terminal_has_the_same_cells(matches: Matches) -> None:
    table = reasons_table(matches)
    lines = [re.split(r"  +", line) for line in draw_text(table).splitlines()]
    assert [cell for line in lines for cell in line] == texts_of(table)


@pytest.mark.parametrize("column", ["head", "heading", "cell", "detail", "attribute", "note"])
def test_no_text_of_a_table_is_markup(column: str) -> None:
    cells: list[str | Cell] = [HOSTILE if column == "heading" else "name"]
    if column == "attribute":
        cells.append(Cell("1", "", {"title": HOSTILE}))
    else:
        cells.append(Cell(HOSTILE if column == "cell" else "1", HOSTILE * (column == "detail")))
    table = ReportTable(
        ("", HOSTILE if column == "head" else "x"), [cells], note=HOSTILE * (column == "note")
    )
    html = draw_table(table)
    assert "<script>" not in html
    assert "&lt;script&gt;" in html
    page = render_report(rig=bench_rig(), tables=[ExtraTable("T", table.head, [], table.note)])
    assert "<script>alert" not in page


def test_code_in_a_sentence_is_code_and_a_name_stays_as_it_is() -> None:
    html = draw_table(ReportTable((), [["`name`", "Run `trinoc check`."]]))
    assert "`name`" in html
    assert "Run <code>trinoc check</code>." in html
