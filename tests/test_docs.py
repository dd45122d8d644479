"""Pages name what exists: commands and options, names of the package, files, other pages."""

import ast
import importlib
import importlib.util
import re
import shlex
from pathlib import Path

import pytest
import yaml

import trinoc
from trinoc.cli.main import main

ROOT = Path(__file__).parent.parent
# Rooms that `import trinoc` hands on; their own names stand beside those of trinoc.
ROOMS = ("calib", "io", "match", "segments")
PAGES = sorted([*(ROOT / "docs").glob("*.md"), ROOT / "README.md"])


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)


def command_lines(page: Path) -> list[list[str]]:
    lines = "\n".join(blocks(page, "sh")).replace("\\\n", " ").splitlines()
    commands = [shlex.split(line, comments=True) for line in lines if line.startswith("trinoc ")]
    return [line for line in commands if "..." not in line and not line[1].startswith("-")]


@pytest.fixture(scope="module")
def options() -> dict[str, set[str]]:
    """The options in the help of each command."""
    import contextlib
    import io

    options_by_command = {}
    for command in re.findall(
        r"^### `trinoc ([\w-]+)`", (ROOT / "docs/reference.md").read_text(), re.M
    ):
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            assert main([command, "--help"]) == 0
        options_by_command[command] = set(
            re.findall(r"(?<![\w-])--?[a-z][a-z0-9-]*", output.getvalue())
        )
    return options_by_command


def test_every_command_line_names_a_command_and_its_options(options: dict[str, set[str]]) -> None:
    wrong = [
        f"{page.name}: {' '.join(line)}"
        for page in PAGES
        for line in command_lines(page)
        if line[1] not in options
        or {word for word in line if re.fullmatch(r"--?[a-z][a-z-]*", word)} - options[line[1]]
    ]
    assert wrong == []


def test_every_name_in_python_exists() -> None:
    wrong = []
    for page in PAGES:
        for block in blocks(page, "python"):
            # An ellipsis stands for what the reader adds.
            for node in ast.walk(ast.parse(re.sub(r", \.\.\.(?=[})])", "", block))):
                if (
                    isinstance(node, ast.Attribute)
                    and isinstance(node.value, ast.Name)
                    and node.value.id == "trinoc"
                    and not hasattr(trinoc, node.attr)
                ):
                    wrong.append(f"{page.name}: trinoc.{node.attr}")
                if isinstance(node, ast.ImportFrom) and node.module and "trinoc" in node.module:
                    room = importlib.import_module(node.module)
                    wrong += [
                        f"{page.name}: {node.module}.{alias.name}"
                        for alias in node.names
                        if not hasattr(room, alias.name)
                    ]
    assert wrong == []


def test_links_and_pictures_lead_somewhere() -> None:
    wrong = [
        f"{page.name}: {target}"
        for page in PAGES
        for target in re.findall(r"\]\(([^)#:]+?)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists()
    ]
    assert wrong == []


def test_files_of_the_code_that_pages_name_are_there() -> None:
    files = [path.as_posix() for path in ROOT.rglob("*.py")]
    wrong = [
        f"{page.name}: {name}"
        for page in PAGES
        for name in re.findall(r"`([\w/]+\.py)`", page.read_text(encoding="utf-8"))
        if not any(file.endswith(f"/{name}") for file in files)
    ]
    assert wrong == []


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = re.findall(r"(\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.M)
    assert sorted(listed) == sorted(page.name for page in (ROOT / "docs").glob("*.md"))
    assert yaml.safe_load((ROOT / "mkdocs.yml").read_text())["strict"]


def test_every_notebook_is_described() -> None:
    page = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\| `(\w+)` \|", page, re.M))
    assert {path.stem for path in (ROOT / "notebooks").glob("*.ipynb")} <= named


def test_every_public_docstring_is_on_its_page() -> None:
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    shown = re.findall(r"^::: trinoc\.(\S+)$", page, re.M)
    assert sorted(name for name in shown if "." not in name) == sorted(
        name for name in trinoc.__all__ if name not in ROOMS
    )
    for name in shown:
        room, _, last = f"trinoc.{name}".rpartition(".")
        assert getattr(importlib.import_module(room), last).__doc__, name


def test_docstrings_become_lists_and_sections() -> None:
    spec = importlib.util.spec_from_file_location("shown", ROOT / "docs" / "docstring_markdown.py")
    assert spec is not None
    assert spec.loader is not None
    pytest.importorskip("griffe")
    shown = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(shown)
    markdown = shown.as_markdown(
        "Say.\n\nx, y : of a point,\n    in mm.\nz : up.\n\nRaises\n------\nError : no."
    )
    assert [line for line in markdown.splitlines() if line] == [
        *("Say.", "- `x, y`: of a point,", "    in mm.", "- `z`: up."),
        *("**Raises**", "- `Error`: no."),
    ]
