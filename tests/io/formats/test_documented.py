"""The page about formats says what the registry says, row by row, and its examples run."""

import importlib.util
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import trinoc
from tests.io.formats.bench import bench_matches, bench_rig
from tests.io.made_cylinders import made_cylinders
from tests.io.made_rims import made_rims
from tests.io.made_wireframe import made_wireframe
from trinoc.cli.main import main
from trinoc.io import FORMATS
from trinoc.io.formats.losses import LOSSES

PAGE = (Path(trinoc.__file__).parent.parent / "docs" / "formats.md").read_text(encoding="utf-8")


def row(form):
    """A format as a row of the page's table."""
    held = ", ".join(form.holds) + ("" if form.reads else " (only written)")
    place = form.place + (f": {', '.join(form.endings)}" if form.endings else "")
    unit = {None: "none", 1.0: "mm", 1000.0: "m"}[form.unit_mm]
    unit += "" if form.unit_is_fixed else ", or `--unit-mm`"
    lost = "; ".join(LOSSES[loss] for loss in form.loses) or "nothing"
    return f"| `{form.name}` | {held} | {place} | {unit} | {form.frames} | {lost} |"


@pytest.mark.parametrize("name", list(FORMATS))
def test_every_format_has_its_row(name):
    assert row(FORMATS[name]) in PAGE.splitlines()


def test_the_page_has_no_other_row():
    assert re.findall(r"^\| `([\w-]+)` \|.*\|.*\|.*\|.*\|", PAGE, re.MULTILINE) == list(FORMATS)


def test_the_examples_of_the_page_run(tmp_path, monkeypatch, capsys):
    """Each command, in the order of the page, on a value of each kind."""
    monkeypatch.chdir(tmp_path)
    trinoc.save(bench_rig(coefficients=4), "rig.json")
    trinoc.save(bench_rig()["upper"].intrinsics, "camera.json")
    trinoc.save(bench_matches(), "matches.npz")
    trinoc.save(made_wireframe(), "wireframe.npz")
    trinoc.save(made_cylinders(), "cylinders.npz")
    trinoc.save(made_rims(), "rims.npz")
    trinoc.save(trinoc.Segments.from_endpoints(np.array([[1.0, 2, 3, 4]])), "segments.npz")
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    lines = [line.split("#")[0] for block in blocks for line in block.splitlines()]
    commands = [shlex.split(line) for line in lines if line.startswith("trinoc ")]
    assert {command[command.index("--to") + 1] for command in commands if "--to" in command} == set(
        FORMATS
    )
    for command in commands:
        if "parquet" in command and importlib.util.find_spec("pyarrow") is None:
            continue
        assert main(command[1:]) == 0, (command, capsys.readouterr().err)
