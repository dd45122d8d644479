"""Camera names that the user omits are guessed and reported, or taken from the rig."""

from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given

import trinoc
from trinoc.cli.command import UsageError
from trinoc.cli.main import main
from trinoc.cli.views import check_views, expect_names, files_of_rig, files_of_views
from trinoc.errors import InputError
from trinoc.recording.camera_aliases import camera_aliases
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


def test_a_unique_part_of_a_name_finds_its_camera() -> None:
    """COLMAP names cameras after files in folders."""
    rig = ("realsense/8461.png", "realsense/9512.png", "hand/0001.png", "other/0001.png", "a=b")
    assert list(files_of_rig(("8461=x.png", "9512.png=y=2.png", "a=b=z.png"), rig)) == [
        "realsense/8461.png",
        "realsense/9512.png",
        "a=b",
    ]
    assert files_of_rig(("images/8461.png", "images/9512_rgb.jpg"), rig) == {
        "realsense/8461.png": Path("images/8461.png"),
        "realsense/9512.png": Path("images/9512_rgb.jpg"),
    }
    # Where the file's name alone is that of two cameras, the folder tells.
    assert list(files_of_rig(("in/hand/0001.png", "in/other/0001.png"), rig)) == list(rig[2:4])
    assert list(files_of_rig(("8461/7.png", "9512/7.png"), rig)) == list(rig[:2])
    # A name that two have names neither, and a name that is a part of another is not meant by it.
    assert list(files_of_rig(("0001=x.png",), rig)) == ["0001"]
    nested = ("cam", "cam_segment")
    assert files_of_rig(("1_cam_segment_b.png", "1_cam_b.png"), nested) == {
        "cam_segment": Path("1_cam_segment_b.png"),
        "cam": Path("1_cam_b.png"),
    }


@given(st.lists(st.text("abc/.", min_size=1, max_size=5), min_size=1, max_size=6, unique=True))
def test_every_camera_is_found_by_its_own_name(names: list[str]) -> None:
    aliases = camera_aliases(names)
    assert {name: aliases[name] for name in names} == {name: name for name in names}
    for alias, camera in aliases.items():
        assert alias in camera.split("/")[-1] or alias == camera


def test_a_rig_of_many_cameras_is_named_in_one_short_note(capsys, caplog) -> None:
    rig = table1_rig()
    larger = trinoc.Rig({**dict(rig.items()), **{f"more/{k}": rig["left"] for k in range(39)}})
    files = {name: Path(f"{name}.png") for name in rig}
    with caplog.at_level("WARNING", logger="trinoc"):
        check_views(files, larger, Path("rig.json"))
    (record,) = caplog.records
    assert record.getMessage() == (
        "no picture of more/0, more/1, more/2, more/3, more/4, more/5 and 33 more: "
        "matching uses the other cameras"
    )
    with pytest.raises(InputError, match="more/2 and 36 more: use these names"):
        expect_names({"lower": Path("a.png")}, larger, Path("rig.json"))
