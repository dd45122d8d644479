"""A rig is checked with matches or with pictures: one of both, and the files are named."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

import trinoc
from trinoc.calib import RigCheck
from trinoc.cli.command import Job, UsageError
from trinoc.cli.main import main
from trinoc.cli.views import read_scene
from trinoc.errors import InputError
from trinoc.synth import table1_rig


@pytest.mark.parametrize(("pictures", "matches"), [((), None), (("upper=a.png",), Path("m.npz"))])
def test_either_pictures_or_matches(pictures, matches):
    with pytest.raises(UsageError, match="either NAME=FILE for each camera"):
        read_scene(pictures, matches, table1_rig(), Path("rig.json"), Job(quiet=True))


def test_pictures_are_those_of_the_rig():
    with pytest.raises(InputError, match="no camera"):
        read_scene(("other=a.png",), None, table1_rig(), Path("rig.json"), Job(quiet=True))


@pytest.mark.parametrize("command", ["check", "refine"])
def test_a_scene_that_is_not_given_is_wrong_usage(command, tmp_path, capsys):
    trinoc.save(table1_rig(), tmp_path / "rig.json")
    assert main([command, "--rig", str(tmp_path / "rig.json"), "--quiet"]) == 2
    assert "--matches FILE" in capsys.readouterr().err


@pytest.mark.parametrize("conclusive", [True, False])
def test_a_check_is_told_in_the_words_of_its_result(conclusive, tmp_path, capsys, monkeypatch):
    check = RigCheck((), ("left",) if conclusive else (), None, conclusive)
    scene = SimpleNamespace(matches=(), tolerant=None, strict=None, files={})
    monkeypatch.setattr("trinoc.check_rig", lambda *_, **__: check)
    monkeypatch.setattr("trinoc.cli.refine.read_scene", lambda *_, **__: scene)
    trinoc.save(table1_rig(), tmp_path / "rig.json")
    assert main(["check", "--rig", str(tmp_path / "rig.json"), "--matches", "m.npz", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "conclusive": conclusive,
        "moved": list(check.moved),
        "corrected": False,
        "sigmas": {},
        "written": [],
    }
