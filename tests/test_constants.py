"""Tuned numbers of `segments`, `match` and `calib` stand in the tuning of their room."""

import ast

import pytest

from tests.package import ROOT, list_files, parse_file

MARK = "# numerical:"


def parts():
    """Pairs (name, files): `segments`; the inner rooms and loose files of `match` and `calib`."""
    yield "segments", list_files("segments")
    for room in ("match", "calib"):
        yield room, sorted((ROOT / room).glob("*.py"))
        for inner in sorted(path.parent for path in (ROOT / room).glob("*/__init__.py")):
            yield f"{room}/{inner.name}", sorted(inner.rglob("*.py"))


PARTS = {name: files for name, files in parts() if not name.endswith("/tuning")}


def has_number(node):
    """Return True if an expression that is evaluated at import contains a number."""
    return any(
        isinstance(each, ast.Constant)
        and isinstance(each.value, int | float)
        and not isinstance(each.value, bool)
        for each in ast.walk(node)
        if not isinstance(each, ast.Subscript)
    )


def is_marked(lines, node):
    """Return True if a comment above or behind the line marks its number as arithmetic."""
    if any(MARK in line for line in lines[node.lineno - 1 : node.end_lineno]):
        return True
    above = node.lineno - 2
    while above >= 0 and lines[above].lstrip().startswith("#"):
        if MARK in lines[above]:
            return True
        above -= 1
    return False


# Rooms of `calib` whose functions take the tuning as an argument.
PASSED_ON = ("calib/detection", "calib/starts")


@pytest.mark.parametrize("part", PASSED_ON)
def test_a_room_reads_the_default_tuning_only_as_the_default_of_an_argument(part):
    wrong = []
    for path in PARTS[part]:
        nodes = list(ast.walk(parse_file(path)))
        defaults = [
            default
            for node in nodes
            if isinstance(node, ast.FunctionDef)
            for default in (*node.args.defaults, *node.args.kw_defaults)
        ]
        wrong += [
            f"{path.relative_to(ROOT)}:{node.lineno}"
            for node in nodes
            if isinstance(node, ast.Name) and node.id == "TUNING" and node not in defaults
        ]
    assert wrong == []


@pytest.mark.parametrize("part", PARTS)
def test_a_number_stands_in_tuning_or_is_marked_as_numerical(part):
    wrong = []
    for path in PARTS[part]:
        if path.name == "tuning.py":
            continue
        lines = path.read_text(encoding="utf-8").splitlines()
        for node in parse_file(path).body:
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            if has_number(node.value) and not is_marked(lines, node):
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno} {ast.unparse(node)[:70]}")
    assert wrong == []
