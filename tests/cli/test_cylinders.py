"""`trinoc match --steps cylinders`: found, written, told, shown, exported and marked."""

import json

import numpy as np
import pytest

import trinoc
from tests.io.made_cylinders import made_cylinders
from tests.match.cylinders.made_outlines import Placed, seen_by
from tests.match.made import loose_lines, rig_of
from trinoc.cli.main import main
from trinoc.report.features_part import features_text


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A rig, and the segments of three views of one cylinder among lines."""
    monkeypatch.chdir(tmp_path)
    rig = rig_of("upper", "left", "right")
    trinoc.save(rig, "rig.json")
    cylinder = Placed(12.0, 30.0, shift_mm=(20.0, -15.0, 0.0))
    for name, own in seen_by(rig, [cylinder], loose_lines(6, seed=2), sigma_px=0.1).items():
        trinoc.save(own, f"{name}.npz")
    return [f"{name}={name}.npz" for name in rig.names]


def test_cylinders_are_written_told_and_shown(scene, capsys):
    places = ["-o", "matches.npz", "--steps", "cylinders", "--report", "page.html"]
    assert main(["match", *scene, "--rig", "rig.json", *places, "--json", "--quiet"]) == 0
    told = json.loads(capsys.readouterr().out)
    (found,) = told["cylinders"]["found"]
    assert abs(found["radius_mm"] - 12.0) < 5 * found["radius_sigma_mm"] < 1.0
    assert all(outlines == [0, 1] for outlines in found["segments"].values())
    assert told["written"] == ["matches.npz", "matches-cylinders.npz", "page.html"]
    back = trinoc.load("matches-cylinders.npz")
    matches = trinoc.load_matches("matches.npz")
    np.testing.assert_array_equal(matches.marks["silhouette"], back.silhouette)
    with open("page.html", encoding="utf-8") as page:
        assert "cylinders (1)" in page.read()
    assert main(["export", "matches-cylinders.npz", "--to", "obj", "-o", "cylinders.obj"]) == 0


def test_people_read_how_many_and_how_large():
    said = features_text(made_cylinders()).splitlines()
    assert said[0] == "2 cylinders; 2 tracks hold an outline of one."
    assert said[1].startswith(
        "cylinder 0: radius 12.00 ± 0.20 mm, posterior 0.990, segments upper 3, 4"
    )
