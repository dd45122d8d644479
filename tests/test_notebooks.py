"""Notebooks run to their end, whose checks hold, and agree with the scripts beside them."""

import os
import runpy
import sys
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
TOOLS = runpy.run_path(str(FOLDER / "execute.py"), run_name="tools")


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_its_script(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    script = TOOLS["notebook_of_script"](path.with_suffix(".py").read_text(encoding="utf-8"))
    assert [(c.cell_type, c.source) for c in notebook.cells] == [
        (c.cell_type, c.source) for c in script.cells
    ], "run: python notebooks/execute.py"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_figure_is_a_picture(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    shown = [output.data for output in outputs if output.output_type == "display_data"]
    assert shown
    assert all("image/png" in data for data in shown)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_to_its_checks(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(FOLDER.parent), *sys.path]))
    # Off: the folder that all tests share has what others have compiled.
    monkeypatch.setenv("TRINOC_COMPILE_CACHE", "off")
    notebook = TOOLS["notebook_of_script"](path.with_suffix(".py").read_text(encoding="utf-8"))
    done = TOOLS["execute"](notebook, tmp_path)
    assert "assert" in done.cells[-1].source
    assert done.cells[-1].execution_count == sum(c.cell_type == "code" for c in done.cells)
