"""The floors of the house: which room may import which, read from the imports themselves."""

import ast
from pathlib import Path

import pytest

import trinoc

ROOT = Path(trinoc.__file__).parent

MAY_IMPORT = {
    "geometry": set(),
    "calib": {"geometry"},
    "match": {"geometry"},
    "synth": {"geometry"},
    "io": {"geometry", "calib", "match", "synth"},
    "report": {"geometry", "calib", "match", "synth", "io"},
    "cli": {"geometry", "calib", "match", "synth", "io", "report"},
}

# Imported where they are used, because a plain `pip install` does not bring them.
EXTRAS = {"matplotlib", "reportlab", "dask", "distributed", "ruamel"}
FORBIDDEN = {"numba", "torch", "tkinter"}
# Below io there are no files, no command line, no screen, no settings.
BELOW_IO = ("geometry", "calib", "match", "synth")
OUTER_MODULES = {"argparse", "io", "logging", "os", "pathlib", "shutil", "subprocess", "sys"}


def modules():
    """(module name, room, syntax tree) of every file of the package."""
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        room = parts[0] if len(parts) > 1 else ""
        yield ".".join(("trinoc", *parts)), room, ast.parse(path.read_text(encoding="utf-8"))


def imported(tree, *, at_top_only=False):
    """Dotted names that a file imports, with what `from` takes."""
    nodes = tree.body if at_top_only else ast.walk(tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute, so that this test can read them"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


MODULES = list(modules())


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_a_room_imports_only_the_floors_below(room):
    wrong = [
        f"{module} imports {name}"
        for module, own, tree in MODULES
        if own == room
        for name in imported(tree)
        if name.split(".")[0] == "trinoc"
        and len(name.split(".")) > 1
        and name.split(".")[1] in MAY_IMPORT
        and name.split(".")[1] not in MAY_IMPORT[room] | {room}
    ]
    assert wrong == []


def test_every_room_stands_in_the_table():
    assert {own for _, own, _ in MODULES if own} == set(MAY_IMPORT)


def test_below_io_nothing_touches_files_or_the_outside():
    wrong = [
        f"{module} imports {name}"
        for module, own, tree in MODULES
        if own in BELOW_IO
        for name in imported(tree)
        if name.split(".")[0] in OUTER_MODULES or name.startswith("cv2.imread")
    ]
    assert wrong == []


def test_below_io_nothing_opens_prints_or_sets():
    wrong = []
    for module, own, tree in MODULES:
        if own not in BELOW_IO:
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                if called in ("open", "print", "input") or called in (
                    "jax.config.update",
                    "np.load",
                    "np.save",
                    "np.savez",
                    "cv2.imread",
                    "cv2.imwrite",
                    "cv2.imshow",
                ):
                    wrong.append(f"{module}:{node.lineno} calls {called}")
    assert wrong == []


def test_extras_are_imported_where_they_are_used():
    wrong = [
        f"{module} imports {name}"
        for module, _, tree in MODULES
        for name in imported(tree, at_top_only=True)
        if name.split(".")[0] in EXTRAS
    ]
    assert wrong == []


def test_no_package_that_we_decided_against():
    names = {name.split(".")[0] for _, _, tree in MODULES for name in imported(tree)}
    assert names & FORBIDDEN == set()


def test_commands_import_nothing_heavy_at_the_top():
    heavy = {"jax", "numpy", "cv2", "equinox", "optimistix", "plotly", "jinja2", "skimage", "scipy"}
    wrong = [
        f"{module} imports {name}"
        for module, own, tree in MODULES
        if own == "cli"
        for name in imported(tree, at_top_only=True)
        if name.split(".")[0] in heavy
        or (name.startswith("trinoc.") and name.split(".")[1] not in ("cli", "errors"))
    ]
    assert wrong == []
