"""`trinoc --version` lists the installed packages, and each problem with its remedy."""

import importlib.metadata

import pytest

import trinoc
from trinoc.cli.installation import OPENCV
from trinoc.cli.main import main


def test_all_is_well_here(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TRINOC_COMPILE_CACHE", "off")
    assert main(["--version"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"trinoc {trinoc.__version__}"
    assert any(line.startswith("devices") and "cpu" in line for line in lines)


def test_two_wheels_of_opencv_clash(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.metadata.version
    monkeypatch.setattr(
        "importlib.metadata.version",
        lambda name: "1" if name in OPENCV[:2] else real(name),
    )
    assert main(["--version"]) == 1
    assert "2 wheels bring cv2: pip uninstall" in capsys.readouterr().err
