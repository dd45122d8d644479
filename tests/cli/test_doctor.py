"""`trinoc doctor`: all is well here, and what is not is named with its remedy."""

import importlib.metadata
import json

import pytest

from trinoc.cli import doctor
from trinoc.cli.main import main


def test_all_is_well_here(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TRINOC_COMPILE_CACHE", "off")
    assert main(["doctor", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["to_mend"] == {}
    assert record["findings"]["self-test, segments"].startswith("4 edges")
    assert "cpu" in record["findings"]["devices of JAX"]


def test_two_wheels_of_opencv_clash(monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.metadata.version
    monkeypatch.setattr(
        "importlib.metadata.version", lambda name: "1" if name in doctor.OPENCV[:2] else real(name)
    )
    (finding,) = doctor._opencv()
    assert "2 wheels" in finding.found
    assert finding.remedy.startswith("pip uninstall")
