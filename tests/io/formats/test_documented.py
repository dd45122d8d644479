"""The table in the docs equals the registry of formats, row by row."""

import re
from pathlib import Path

import pytest

import trinoc
from trinoc.io import FORMATS
from trinoc.io.formats.format import LOSSES

PAGE = (Path(trinoc.__file__).parent.parent / "docs" / "formats.md").read_text(encoding="utf-8")


# What the page says once, above its table.
SHORT = {
    "pixel (0, 0) is the centre of the top-left pixel": "centre",
    "pixel (0, 0) is the corner of the top-left pixel, (0.5, 0.5) its centre": "corner",
    "x right, y down, z forward": "forward",
    "the size of a pixel, and therefore the focal length in mm": "pixel size",
    "the fragments in the pictures, and the segments that they belong to": "fragments",
    "the world frame: the first camera becomes its origin": "the world",
    " (only written)": "",
}


def shorten(row):
    for sentence, short in SHORT.items():
        row = row.replace(sentence, short)
    return row


def row(form):
    """The table row of a format."""
    contents = ", ".join(form.holds or form.reads) + ("" if form.reads else " (only written)")
    contents += "" if form.holds else " (only read)"
    location = form.place + (f": {', '.join(form.endings)}" if form.endings else "")
    unit = {None: "none", 1.0: "mm", 1000.0: "m"}[form.unit_mm]
    unit += "" if form.unit_is_fixed else ", or `--unit-mm`"
    unit = "stated by the file, or `--unit-mm`" if form.states_unit else unit
    lost = "; ".join(LOSSES[loss] for loss in form.loses) or "nothing"
    return shorten(f"| `{form.name}` | {contents} | {location} | {unit} | {form.frames} | {lost} |")


def key_rows(form):
    """Yield one table row for each mapping of a format, with the keys that its reader declares."""
    for location, keys in form.keys.items():
        cells = (
            ", ".join(f"`{key}`" for key in group)
            for group in (keys.read, keys.refused, keys.left_out)
        )
        yield f"| `{form.name}` | {location} | {' | '.join(cells)} |"


@pytest.mark.parametrize("name", list(FORMATS))
def test_every_format_has_its_rows_of_keys(name):
    rows = [line for line in PAGE.splitlines() if line.count("|") == 6]
    assert [row for row in rows if row.startswith(f"| `{name}` |")] == list(key_rows(FORMATS[name]))


@pytest.mark.parametrize("name", list(FORMATS))
def test_every_format_has_its_row(name):
    assert row(FORMATS[name]) in PAGE.splitlines()


def test_the_page_has_no_other_row():
    assert re.findall(r"^\| `([\w-]+)` \|.*\|.*\|.*\|.*\|.*\|", PAGE, re.MULTILINE) == list(FORMATS)


def test_the_page_has_an_example_of_every_format():
    assert set(re.findall(r"--to ([\w-]+)", PAGE)) == {
        n for n, each in FORMATS.items() if each.holds
    }
    assert {n for n, each in FORMATS.items() if not each.holds} <= set(
        re.findall(r"--from ([\w-]+)", PAGE)
    )
