"""Names of cameras that are not given: guessed, said, and those of the rig where it has some."""

from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given

import trinoc
from trinoc.cli.command import UsageError
from trinoc.cli.main import main
from trinoc.cli.views import files_of_rig, files_of_views
from trinoc.synth import table1_rig

NAMES = st.lists(st.text("abcdefgh", min_size=1, max_size=6), min_size=2, max_size=4, unique=True)
PART = st.text("xyz", max_size=4)


def guessed(*arguments: str) -> list[str]:
    return list(files_of_views(arguments, guess=True))


@given(NAMES, PART, PART)
def test_what_differs_between_the_files_is_the_name(
    names: list[str], before: str, after: str
) -> None:
    before, after = before and f"{before}_", after and f"-{after}"
    assert guessed(*(f"d/{before}{name}{after}.png" for name in names)) == names


def test_where_files_are_called_alike_the_folders_name_the_cameras() -> None:
    assert guessed("run/left/000.png", "run/right/000.png") == ["left", "right"]
    assert guessed("left/sheet_low.png", "left/sheet_left.png") == ["low", "left"]
    assert guessed("top.png") == ["top"]


@pytest.mark.parametrize("files", [("a.png", "a.png"), ("x/a.png", "x/a.png"), ("x=", "b=b.png")])
def test_what_tells_no_cameras_apart_is_refused(files: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="NAME=FILE"):
        files_of_views(files, guess=True)


def test_nothing_is_guessed_unless_that_is_wanted() -> None:
    with pytest.raises(UsageError, match="names no view"):
        files_of_views(("a.json",))


def test_the_names_of_the_rig_are_found_in_those_of_the_files() -> None:
    rig = ("upper", "left")
    assert files_of_rig(("scan3-left.png", "scan3-upper-b.png"), rig) == {
        "left": Path("scan3-left.png"),
        "upper": Path("scan3-upper-b.png"),
    }
    assert list(files_of_rig(("one.png", "two.png"), rig)) == ["one", "two"]
    # A name that is given is meant.
    assert list(files_of_rig(("lower=left.png", "upper=upper.png"), rig)) == ["lower", "upper"]


def test_a_match_says_once_how_it_names_the_cameras(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    trinoc.save(table1_rig(), "rig.json")
    files = [f"{name}.png" for name in table1_rig().names]
    assert main(["match", *files, "--rig", "rig.json"]) == 1
    assert capsys.readouterr().err.count("named after") == 1
