"""Make the notebooks from the scripts beside them, with their outputs.

    pip install '.[test]' && python notebooks/execute.py          # or names: ... new_rig segments

The scripts, in the percent format that editors know, are what one edits and reviews.
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
    """The cells of a script, without outputs: "# %%" begins code, "# %% [markdown]" words."""
    cells = []
    for number, part in enumerate(re.split(r"^# %%", text, flags=re.MULTILINE)[1:]):
        head, _, body = part.partition("\n")
        if "[markdown]" in head:
            body = "\n".join(line.removeprefix("#").removeprefix(" ") for line in body.split("\n"))
            cell = nbformat.v4.new_markdown_cell(body.strip())
        else:
            cell = nbformat.v4.new_code_cell(body.strip())
        # Numbered, not random, so that an unchanged script gives an unchanged file.
        cell["id"] = f"cell-{number}"
        cells.append(cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return nbformat.v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})


def execute(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """Run a notebook in `folder`; raises where a cell does."""
    client = NotebookClient(
        notebook,
        timeout=TIME_LIMIT_S,
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    )
    done = client.execute()
    done.metadata.pop("language_info", None)
    return done


if __name__ == "__main__":
    # `simulation` is not installed.
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *sys.path])
    for script in sorted(Path(__file__).parent.glob("*.py")):
        if script.name == Path(__file__).name or sys.argv[1:] and script.stem not in sys.argv[1:]:
            continue
        notebook = notebook_of_script(script.read_text(encoding="utf-8"))
        nbformat.write(execute(notebook, script.parent), script.with_suffix(".ipynb"))
        print(script.with_suffix(".ipynb"))
