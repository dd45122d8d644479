"""Tables described once, drawn as HTML on the page and in notebooks, and as text in a terminal."""

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from markupsafe import Markup, escape


class Cell(NamedTuple):
    """Cell of a table.

    Attributes
    ----------
    text : str
        Content.
    detail : str
        Second line in smaller letters.
    attributes : mapping of str to str
        Attributes of the HTML element.
    """

    text: str
    detail: str = ""
    attributes: Mapping[str, str] = {}


class ReportTable(NamedTuple):
    """Table with a heading in the first cell of each row.

    Attributes
    ----------
    head : sequence of str
        Names of the columns; empty for a table without names.
    rows : sequence of rows
        Cells of each row, the heading first.
    caption, note : str
        Sentences above and below the table.
    look : str
        CSS class.
    row_attributes : sequence of mappings
        Attributes of the rows' HTML elements, in order; further rows have none.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[Cell | str]]
    caption: str = ""
    note: str = ""
    look: str = ""
    row_attributes: Sequence[Mapping[str, str]] = ()

    def cells(self) -> Iterator[list[Cell]]:
        """Yield the cells of each row. A plain text becomes a cell without a detail."""
        for row in self.rows:
            yield [cell if isinstance(cell, Cell) else Cell(cell) for cell in row]


def draw_table(table: ReportTable) -> Markup:
    """Return the table as HTML, with its caption and note."""
    parts = [f'<div class="scroll"><table{_attributes({"class": table.look})}>']
    parts.append(f"<caption>{escape(table.caption)}</caption>" if table.caption else "")
    if table.head:
        names = "".join(f'<th scope="col">{escape(name)}</th>' for name in table.head)
        parts.append(f"<thead><tr>{names}</tr></thead>")
    parts.append("<tbody>")
    for row, attributes in itertools.zip_longest(table.cells(), table.row_attributes, fillvalue={}):
        cells = "".join(_draw_cell(cell, is_heading=not column) for column, cell in enumerate(row))
        parts.append(f"<tr{_attributes(attributes)}>{cells}</tr>\n")
    note = f'<p class="note">{escape(table.note)}</p>' if table.note else ""
    return Markup("".join([*parts, "</tbody></table></div>", note]))


def _draw_cell(cell: Cell, *, is_heading: bool) -> str:
    """Return a cell as HTML. In cells that are no headings, text between backticks becomes code."""
    detail = f'<span class="detail">{escape(cell.detail)}</span>' if cell.detail else ""
    attributes = _attributes(cell.attributes)
    if is_heading:
        return f'<th scope="row"{attributes}>{escape(cell.text)}{detail}</th>'
    return f"<td{attributes}>{draw_code(cell.text)}{detail}</td>"


def _attributes(attributes: Mapping[str, str]) -> str:
    return "".join(f' {name}="{escape(value)}"' for name, value in attributes.items() if value)


def draw_code(sentence: str) -> Markup:
    """Return a sentence as HTML, with text between backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(sentence))))


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]], *, left_columns: int = 1) -> str:
    """Return a table as aligned text. The first `left_columns` columns are aligned to the left."""
    lines = [list(head), *(list(row) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column < left_columns else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def draw_text(table: ReportTable) -> str:
    """Return the table as text, without the details of its cells."""
    return text_table(table.head, [[cell.text for cell in row] for row in table.cells()])
