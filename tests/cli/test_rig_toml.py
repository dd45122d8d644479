"""trinoc.toml stands in for arguments; what is typed counts more."""

from pathlib import Path

import pytest

from trinoc.cli.command import UsageError
from trinoc.cli.main import main
from trinoc.cli.rig_toml import with_file

TEXT = """
[calibrate]
pictures = {upper = "u.png", left = "l.png"}
pattern = "sheet.json"
pixel_pitch_mm = [0.0162, 0.0134]
lens_exact = true
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
        *("calibrate", "upper=u.png", "left=l.png", "--pattern", "sheet.json"),
        *("--pixel-pitch-mm", "0.0162", "0.0134", "--lens-exact", "--out", "rig.json"),
    ]


def test_what_is_typed_counts_more(file: Path) -> None:
    words = with_file(["calibrate", "a=a.png", "--pattern=p.json", "-o", "x.json"], file)
    assert words == [
        *("calibrate", "a=a.png", "--pattern=p.json", "-o", "x.json"),
        *("--pixel-pitch-mm", "0.0162", "0.0134", "--lens-exact"),
    ]
    assert with_file(["calibrate", "b.png", "--json"], file)[1] == "b.png"


def test_other_commands_help_and_a_missing_file_change_nothing(file: Path) -> None:
    for words in (["match", "a=a.png"], ["calibrate", "--help"], []):
        assert with_file(words, file) == words
    assert with_file(["calibrate"], file.parent / "none.toml") == ["calibrate"]


@pytest.mark.parametrize(
    "text", ["[calibrate", "[calibrate]\npictures = 3", "[calibrate]\nout = {a = 1}"]
)
def test_a_file_that_says_nothing_is_refused(
    text: str, file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=r"trinoc\.toml"):
        with_file(["calibrate"], file)
    monkeypatch.chdir(file.parent)
    assert main(["calibrate"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
