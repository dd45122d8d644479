"""The floors of the house: which room may import which, read from the imports themselves."""

import ast
import functools
import importlib
import re
from pathlib import Path

import pytest

from tests.package import ROOT, list_files, parse_file

MAY_IMPORT = {
    "numerics": set(),
    "geometry": {"numerics"},
    "image": {"numerics", "geometry"},
    "segments": {"numerics", "geometry", "image"},
    "calib": {"numerics", "geometry", "image"},
    "match": {"numerics", "geometry", "image"},
    "synth": {"numerics", "geometry"},
    "evaluation": {"numerics", "geometry", "image", "segments", "calib", "match", "synth"},
    "recording": {"numerics", "geometry", "match"},
    "capture": {"numerics", "geometry", "image", "calib"},
}
MAY_IMPORT["io"] = {*MAY_IMPORT["evaluation"], "evaluation", "recording"}
MAY_IMPORT["report"] = MAY_IMPORT["batch"] = {*MAY_IMPORT["io"], "io"}
MAY_IMPORT["serving"] = {*MAY_IMPORT["report"], "report", "capture"}
MAY_IMPORT["cli"] = {*MAY_IMPORT["serving"], "serving", "batch"}

# Rooms inside a room, from the ground up: each may import those before it. The files of the room
# itself put them together and stand above all.
INNER_FLOORS = {
    "calib": (
        *("tuning", "targets", "detection", "uncertainty", "problem", "result"),
        *("starts", "advice", "photometric", "adjustment", "bundle", "rig_check"),
    ),
    "match": (
        *("tuning", "observations", "two_view", "evidence", "candidates", "selection"),
        *("occlusion", "tracks", "pixels", "line_map", "wire_frame", "rims"),
    ),
    "segments": ("nevatia_babu",),
    "geometry": ("lenses",),
}

# Files or rooms that all inner rooms of a room may import: its tuned constants, and its sentences
# if they are made of numbers and names alone.
FOUNDATION = {"calib": {"tuning"}, "match": {"tuning", "sentences"}}

# Doors with names for users: those that import when a name is first used, as what stands behind
# them takes a second to import; and those that import at once. Inside, one imports from the files.
LAZY = ("trinoc", "trinoc.calib", "trinoc.match", "trinoc.io", "trinoc.report")
PLAIN = ("trinoc.geometry", "trinoc.segments", "trinoc.synth")

# Imported where they are used, because a plain `pip install` does not bring them.
EXTRAS = {
    *("matplotlib", "reportlab", "dask", "distributed", "ruamel", "pyarrow", "pandas"),
    "trimesh",
}
FORBIDDEN = {"numba", "torch", "tkinter"}
# Below io there are no files, no command line, no screen, no settings.
BELOW_IO = (
    *("numerics", "geometry", "image", "segments", "calib", "match", "synth", "evaluation"),
    *("recording", "capture"),
)
OUTER_MODULES = {"argparse", "io", "logging", "os", "pathlib", "shutil", "subprocess", "sys"}


@functools.cache
def modules():
    """(module name, room, syntax tree) of every file of the package."""
    module_list = []
    for path in list_files():
        parts = path.relative_to(ROOT).with_suffix("").parts
        room = parts[0] if len(parts) > 1 else ""
        name = ".".join(("trinoc", *parts)).removesuffix(".__init__")
        module_list.append((name, room, parse_file(path)))
    return module_list


def imported(tree, *, at_top_only=False):
    """Dotted names that a file imports, with what `from` takes."""
    nodes = tree.body if at_top_only else ast.walk(tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute, so that this test can read them"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_the_package_does_not_import_the_simulation():
    assert not [
        f"{module} imports {name}"
        for module, _, tree in modules()
        for name in imported(tree)
        if name.split(".")[0] == "simulation"
    ]


PACKAGES = sorted(
    ".".join(("trinoc", *path.parent.relative_to(ROOT).parts)) for path in ROOT.rglob("__init__.py")
)


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_a_room_imports_only_the_floors_below(room):
    wrong = [
        f"{module} imports {name}"
        for module, module_room, tree in modules()
        if module_room == room
        for name in imported(tree)
        if name.split(".")[0] == "trinoc"
        and len(name.split(".")) > 1
        and name.split(".")[1] in MAY_IMPORT
        and name.split(".")[1] not in MAY_IMPORT[room] | {room}
    ]
    assert wrong == []


def test_every_room_stands_in_the_table():
    assert {module_room for _, module_room, _ in modules() if module_room} == set(MAY_IMPORT)


@pytest.mark.parametrize("room", INNER_FLOORS)
def test_inner_rooms_import_only_the_floors_below(room):
    floors = INNER_FLOORS[room]
    assert set(floors) == {path.parent.name for path in (ROOT / room).glob("*/__init__.py")}
    wrong = []
    for module, module_room, tree in modules():
        parts = module.split(".")
        if module_room != room or len(parts) < 4:
            continue
        below = {*FOUNDATION.get(room, {"tuning"}), *floors[: floors.index(parts[2]) + 1]}
        for name in imported(tree):
            taken = name.split(".")
            if taken[:2] == ["trinoc", room] and taken[2] not in below:
                wrong.append(f"{module} imports {name}")
    assert wrong == []


def test_code_imports_from_the_files():
    wrong = [
        f"{module} imports {name}"
        for module, _, tree in modules()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in PACKAGES
        for name in (f"{node.module}.{alias.name}" for alias in node.names)
        if module not in PACKAGES and name not in {each for each, _, _ in modules()}
    ]
    assert wrong == []


def _is_of_a_file(value, room):
    """Return True if a file of the room defines this class or function."""
    return getattr(value, "__module__", "").startswith(f"{room.__name__}.")


def names_of(package):
    """Names that a package exports in its `__init__`. Most packages export none."""
    room = importlib.import_module(package)
    if package in LAZY:
        return set(room.__all__)
    return {name for name, value in vars(room).items() if _is_of_a_file(value, room)}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_door_says_what_is_done_and_hands_on_names_that_exist(package):
    room = importlib.import_module(package)
    assert room.__doc__
    names = names_of(package) - {"errors", "calib", "io", "match", "segments"}
    assert bool(names) == (package in LAZY + PLAIN)
    files = {path.stem for path in Path(room.__path__[0]).iterdir() if path.suffix in ("", ".py")}
    assert files & names == set()
    for name in names:
        assert getattr(room, name) is not None


def test_only_these_doors_are_lazy():
    lazy = {
        module
        for module, _, tree in modules()
        if any(name.startswith("lazy_loader") for name in imported(tree))
    }
    assert lazy == set(LAZY)


def test_docs_name_no_path_behind_a_door():
    """Prose and code blocks name public modules. Only API listings name files."""
    files = [f"{module}." for module, _, _ in modules() if module not in PACKAGES]
    files.remove("trinoc.errors.")
    pages = [*(ROOT.parent / "docs").glob("*.md"), *ROOT.parent.glob("*.md")]
    wrong = [
        f"{page.name}: {path}"
        for page in pages
        if page.name != "api.md"
        for path in re.findall(r"trinoc(?:\.\w+)+", page.read_text(encoding="utf-8"))
        if any(f"{path}.".startswith(file) for file in files)
    ]
    assert wrong == []


def test_below_io_nothing_touches_files_or_the_outside():
    wrong = [
        f"{module} imports {name}"
        for module, module_room, tree in modules()
        if module_room in BELOW_IO
        for name in imported(tree)
        if name.split(".")[0] in OUTER_MODULES or name.startswith("cv2.imread")
    ]
    assert wrong == []


def test_below_io_nothing_opens_prints_or_sets():
    wrong = []
    for module, module_room, tree in modules():
        if module_room not in BELOW_IO:
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                function = ast.unparse(node.func)
                if function in ("open", "print", "input") or function in (
                    "jax.config.update",
                    "np.load",
                    "np.save",
                    "np.savez",
                    "cv2.imread",
                    "cv2.imwrite",
                    "cv2.imshow",
                ):
                    wrong.append(f"{module}:{node.lineno} calls {function}")
    assert wrong == []


def test_extras_are_imported_where_they_are_used():
    wrong = [
        f"{module} imports {name}"
        for module, _, tree in modules()
        for name in imported(tree, at_top_only=True)
        if name.split(".")[0] in EXTRAS
    ]
    assert wrong == []


def test_no_package_that_we_decided_against():
    names = {name.split(".")[0] for _, _, tree in modules() for name in imported(tree)}
    assert names & FORBIDDEN == set()


def test_nothing_imports_what_takes_longer_than_a_match():
    slow = ("scipy.stats", "scipy.signal")  # a second; `trinoc.numerics.tails` has their tails
    wrong = [
        f"{module} imports {name}"
        for module, _, tree in modules()
        for name in imported(tree, at_top_only=True)
        if name.startswith(slow)
    ]
    assert wrong == []


def test_commands_import_nothing_heavy_at_the_top():
    heavy = {"jax", "numpy", "cv2", "equinox", "optimistix", "jinja2", "skimage", "scipy"}
    # Words for the help, in files that import nothing.
    light = {"trinoc.match.step_names.StepName"}
    wrong = [
        f"{module} imports {name}"
        for module, module_room, tree in modules()
        if module_room == "cli"
        for name in imported(tree, at_top_only=True)
        if name.split(".")[0] in heavy
        or (
            name.startswith("trinoc.")
            and name.split(".")[1] not in ("cli", "errors")
            and name not in light
        )
    ]
    assert wrong == []
