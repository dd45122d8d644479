"""Notebooks run to their end, whose checks hold, and agree with the scripts beside them."""

import os
import runpy
import sys
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SLOW = pytest.mark.slow
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


@pytest.mark.parametrize(
    "path",
    [path if path.stem == "end_to_end" else pytest.param(path, marks=SLOW) for path in NOTEBOOKS],
    ids=lambda path: path.stem,
)
def test_a_script_runs_to_its_checks(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run the script in this process, which already has many compiled programs."""
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    # Off: the folder that all tests share has what others have compiled.
    monkeypatch.setenv("TRINOC_COMPILE_CACHE", "off")
    plt.switch_backend("agg")
    monkeypatch.setattr(plt, "show", lambda: plt.close("all"))
    script = path.with_suffix(".py")
    assert "\nassert" in script.read_text(encoding="utf-8").rpartition("# %%")[2]
    with plt.rc_context():
        runpy.run_path(str(script))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_outputs_kept_are_of_one_run_to_the_end(path: Path) -> None:
    cells = [c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert not any(output.output_type == "error" for cell in cells for output in cell.outputs)


def test_a_notebook_runs_in_a_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(FOLDER.parent), *sys.path]))
    text = "# %% [markdown]\n# Words.\n# %%\nimport trinoc\ntrinoc.__version__\n# %%\nassert 1\n"
    done = TOOLS["execute"](TOOLS["notebook_of_script"](text), tmp_path)
    assert [cell.cell_type for cell in done.cells] == ["markdown", "code", "code"]
    assert done.cells[-1].execution_count == 2
