"""docs/architecture.md says what the code does: rooms, floors, doors, solvers and tuning values."""

import re
from pathlib import Path

import pytest

import trinoc
from tests.test_floors import INNER_FLOORS, LAZY, MAY_IMPORT, PLAIN, imported, modules

PAGE = (Path(trinoc.__file__).parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8")


def rows(head: str) -> list[list[str]]:
    """The cells of each row of the table below the first line that begins with `head`."""
    below = PAGE[PAGE.index(f"\n{head}") :].splitlines()
    first = next(k for k, line in enumerate(below) if line.startswith("|---"))
    table = []
    for line in below[first + 1 :]:
        if not line.startswith("|"):
            break
        table.append([cell.strip() for cell in line.strip("|").split(" | ")])
    return table


def quoted(text: str) -> list[str]:
    return re.findall(r"`([\w./]+)`", text)


def test_rooms_may_import_what_the_page_says() -> None:
    may: dict[str, set[str]] = {}
    for (room,), cell in ((quoted(row[0]), row[-1]) for row in rows("## Rooms and floors")):
        allowed = set(quoted(cell))
        if "what th" in cell:
            allowed |= {name for below in allowed for name in may[below]}
        may[room] = allowed
    assert may == MAY_IMPORT


@pytest.mark.parametrize("room", ["calib", "match"])
def test_inner_rooms_stand_in_the_order_of_their_floors(room: str) -> None:
    assert [quoted(row[0])[0] for row in rows(f"### `{room}`")] == list(INNER_FLOORS[room])


def test_doors_are_those_of_the_page() -> None:
    lazy, plain = (tuple(quoted(row[0])) for row in rows("## Doors"))
    assert (set(lazy), set(plain)) == (set(LAZY), set(PLAIN))


def sentences(title: str) -> str:
    """The paragraph that begins with a title in bold."""
    return PAGE[PAGE.index(f"**{title}.**") :].split("\n\n")[0]


def test_solvers_are_those_of_the_page() -> None:
    used = {
        f"{module.removeprefix('trinoc.calib.').replace('.', '/')}.py"
        for module, room, tree in modules()
        if room == "calib" and any(name.split(".")[0] == "optimistix" for name in imported(tree))
    }
    listed = quoted(sentences("Solvers"))
    assert used == {name for name in listed if not name.startswith("numerics/") and "/" in name}


def test_tuning_values_are_those_of_the_page() -> None:
    """Each room's value is the class that its function takes, and stands in a file of tuning."""
    import ast

    classes = {
        node.name
        for module, _, tree in modules()
        if "tuning" in module.split(".")
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    }
    groups = {
        name
        for module, _, tree in modules()
        if "tuning" in module.split(".")
        for node in ast.walk(tree)
        if isinstance(node, ast.AnnAssign)
        for name in re.findall(r"\w+", ast.unparse(node.annotation))
    }
    assert classes - groups == set(re.findall(r"`(\w+Tuning)`", sentences("Tuning")))
