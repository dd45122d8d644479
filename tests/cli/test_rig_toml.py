"""trinoc.toml stands in for arguments; what is typed counts more."""

from pathlib import Path

import pytest

from trinoc.cli.command import UsageError
from trinoc.cli.main import main
from trinoc.cli.settings import with_file

TEXT = """
[calibrate]
images = {upper = "u.png", left = "l.png"}
board = "sheet.json"
lens_mm = [16, 0.0162, 0.0134]
sigma = {lens = 0, print_scale = [0.001, 0.002]}
accept_suspect = true
dry_run = false
out = "rig.json"
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "trinoc.toml"
    file.write_text(TEXT, encoding="utf-8")
    return file


def test_a_command_alone_takes_everything_from_the_file(file: Path) -> None:
    assert with_file(["calibrate"], file) == [
        *("calibrate", "upper=u.png", "left=l.png", "--board", "sheet.json"),
        *("--lens-mm", "16", "0.0162", "0.0134"),
        *("--sigma", "lens=0", "print_scale=0.001,0.002"),
        *("--accept-suspect", "--out", "rig.json"),
    ]


def test_what_is_typed_counts_more(file: Path) -> None:
    typed = ["calibrate", "a=a.png", "--pattern=p.json", "-o", "x.json", "--lens", "c.json"]
    with_sigma = [*typed, "--sigma", "aim_mm=0"]
    assert with_file(with_sigma, file) == [*with_sigma, "--accept-suspect"]
    assert with_file(typed, file)[len(typed) :] == [
        *("--sigma", "lens=0", "print_scale=0.001,0.002", "--accept-suspect"),
    ]
    assert with_file(["calibrate", "b.png", "--json"], file)[1] == "b.png"


def test_other_commands_help_and_a_missing_file_change_nothing(file: Path) -> None:
    for arguments in (["match", "a=a.png"], ["calibrate", "--help"], []):
        assert with_file(arguments, file) == arguments
    assert with_file(["calibrate"], file.parent / "none.toml") == ["calibrate"]


@pytest.mark.parametrize(
    "text", ["[calibrate", "[calibrate]\nimages = [", "[calibrate]\nout = rig.json"]
)
def test_a_file_that_is_no_toml_is_refused(
    text: str, file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=r"trinoc\.toml"):
        with_file(["calibrate"], file)
    monkeypatch.chdir(file.parent)
    assert main(["calibrate"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_tables_lists_and_truths_are_typed_as_options_want_them(file: Path) -> None:
    file.write_text(
        '[calibrate-rig]\nboard = ["a.json", "b.json"]\nlens = {left = "l.json"}\n'
        "[match]\nfind = {arcs = true, tolerance_px = 2}\nsteps = ['rims', 'pixels']\n",
        encoding="utf-8",
    )
    assert with_file(["calibrate-rig"], file)[1:] == [
        *("--board", "a.json", "--board", "b.json", "--lens", "left=l.json"),
    ]
    assert with_file(["match"], file)[1:] == [
        *("--find", "arcs=True", "tolerance_px=2", "--steps", "rims", "pixels"),
    ]


def test_settings_that_are_typed_are_no_pictures(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(file.parent)
    assert main(["calibrate", "--sigma", "lens=0"]) == 1
    assert "sheet.json does not exist" in capsys.readouterr().err
