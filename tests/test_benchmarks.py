"""Scripts in benchmarks/ that say of the code what must stay true."""

import importlib
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_every_place_that_is_broken_stands_once(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    script = importlib.import_module("mutations")
    assert len(script.MUTATIONS) >= 60
    for each in script.MUTATIONS:
        text = (ROOT / script.source(each)).read_text(encoding="utf-8")
        assert text.count(each.before) == 1, f"{each.file}: {each.before}"
        assert all((ROOT / "tests" / name).exists() for name in each.tests.split()), each.tests
