"""Generate the notebooks, with their outputs, from the scripts in this folder.

    pip install '.[test]' && python notebooks/execute.py
    python notebooks/execute.py new_rig segments                  # some notebooks only

Edit and review the scripts. They use the percent format, which many editors support.
"""

import os
import re
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

TIME_LIMIT_S = 240
ROOT = Path(__file__).resolve().parent.parent


def notebook_of_script(text: str) -> nbformat.NotebookNode:
    """Notebook of a script, without outputs.

    "# %%" begins a code cell, "# %% [markdown]" a text cell.
    """
    cells = []
    for number, cell_text in enumerate(re.split(r"^# %%", text, flags=re.MULTILINE)[1:]):
        marker, _, body = cell_text.partition("\n")
        if "[markdown]" in marker:
            body = "\n".join(line.removeprefix("#").removeprefix(" ") for line in body.split("\n"))
            cell = nbformat.v4.new_markdown_cell(body.strip())
        else:
            cell = nbformat.v4.new_code_cell(body.strip())
        # Not the random default, so that an unchanged script gives an unchanged file.
        cell["id"] = f"cell-{number}"
        cells.append(cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return nbformat.v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})


def execute(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """Run a notebook in `folder` and return it with its outputs. An error in a cell is raised."""
    client = NotebookClient(
        notebook,
        timeout=TIME_LIMIT_S,
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    )
    executed = client.execute()
    executed.metadata.pop("language_info", None)
    return executed


if __name__ == "__main__":
    # The kernel must find `simulation`, which is not installed.
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *sys.path])
    for script in sorted(Path(__file__).parent.glob("*.py")):
        if script.name == Path(__file__).name or sys.argv[1:] and script.stem not in sys.argv[1:]:
            continue
        notebook = notebook_of_script(script.read_text(encoding="utf-8"))
        nbformat.write(execute(notebook, script.parent), script.with_suffix(".ipynb"))
        print(script.with_suffix(".ipynb"))
