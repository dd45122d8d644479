"""A change of a source changes the digest of what imports it, and of nothing else."""

import sys

import numpy as np
import pytest

from trinoc.calib.photometric.sheet_geometry import homography_of_pose
from trinoc.geometry.pose import Pose
from trinoc.io import module_sources
from trinoc.io.module_sources import digest_sources
from trinoc.numerics.programs import forget_programs, kept_jit, set_program_store

SOURCES = {
    "__init__": "",
    "low": "STEP = 1\n",
    "middle": "def work():\n    from made_package.low import STEP\n    return STEP\n",
    "high": "from made_package import (\n    middle as other,\n)\nimport os\n",
    "beside": "import made_package.low\n",
    "cli": "from made_package.high import other\n",
}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Import a new package's `__init__` alone. Yield a function that rewrites its modules."""
    folder = tmp_path / "made_package"
    folder.mkdir()
    for name, text in SOURCES.items():
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(module_sources, "_STARTED_S", np.inf)
    __import__("made_package")
    forget()
    yield lambda name, text: ((folder / f"{name}.py").write_text(text), forget())
    del sys.modules["made_package"]
    forget()


def forget():
    for cached in ("digest_sources", "_text", "_digest", "_imports", "_source_file"):
        getattr(module_sources, cached).cache_clear()


def digests():
    return {name: digest_sources(frozenset({f"made_package.{name}"})) for name in SOURCES}


@pytest.mark.parametrize(
    ("changed", "reached"),
    [
        ("low", {"low", "middle", "high", "beside", "cli"}),
        ("middle", {"middle", "high", "cli"}),
        ("beside", {"beside"}),
        ("cli", {"cli"}),
    ],
)
def test_a_changed_source_reaches_those_that_import_it(package, changed, reached):
    before = digests()
    package(changed, SOURCES[changed] + "# changed\n")
    after = digests()
    assert {name for name in SOURCES if before[name] != after[name]} == reached
    package(changed, SOURCES[changed])
    assert digests() == before


def test_a_source_that_is_new_or_unknown_keeps_no_program(package, monkeypatch):
    with pytest.raises(LookupError, match="no source file"):
        digest_sources(frozenset({"made_package.nothing"}))
    forget()
    monkeypatch.setattr(module_sources, "_STARTED_S", 0.0)
    with pytest.raises(LookupError, match="has changed"):
        digests()


def test_no_program_of_the_matcher_depends_on_commands():
    reached, waiting = set(), {"trinoc.match.matcher"}
    while waiting:
        module = waiting.pop()
        reached.add(module)
        waiting |= module_sources._imports(module) - reached
    rooms = {module.split(".")[1] for module in reached}
    assert {"match", "geometry", "numerics"} <= rooms
    assert not rooms & {"cli", "io", "report", "calib", "segments"}


def _turn(pose: Pose) -> Pose:
    return Pose(2.0 * pose.cam_from_world)


def modules_of(run):
    """The module sets that a call passes to the program store."""
    requests = []

    class Store:
        def get(self, name, modules=frozenset()):
            requests.append(modules)

        def put(self, name, content, modules=frozenset()):
            requests.append(modules)

    before = set_program_store(Store())
    try:
        run()
    finally:
        set_program_store(before)
    return requests


def test_a_program_brings_the_modules_of_its_function_and_its_arguments():
    requests = modules_of(lambda: kept_jit(_turn)(Pose(np.eye(3, 4))))
    assert requests == [{__name__, "trinoc.geometry.pose"}] * 2


def test_a_program_brings_the_module_that_keeps_a_function_of_another():
    forget_programs()
    requests = modules_of(lambda: homography_of_pose(Pose(np.eye(3, 4))))
    assert "trinoc.calib.photometric.sheet_geometry" in requests[0]
