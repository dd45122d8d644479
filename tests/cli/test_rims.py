"""`trinoc match --steps rims`: on the bundled scene, and with segments in place of pictures."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import trinoc
import trinoc.synth
from trinoc.cli.main import main
from trinoc.synth import table1_rig

VIEWS = ("upper", "left", "right")
DEMO = Path(trinoc.synth.__file__).parent / "demo"


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """The rig and the pictures of the demo's scene, which has one cylinder, 15 mm in radius."""
    monkeypatch.chdir(tmp_path)
    trinoc.save(table1_rig(), "rig.json")
    for view in VIEWS:
        shutil.copy(DEMO / f"scene_{view}.png", tmp_path)
    return [f"{view}=scene_{view}.png" for view in VIEWS]


def test_rims_are_added_and_told(scene, capsys):
    options = ["--steps", "rims", "--json", "--quiet"]
    assert main(["match", *scene, "--rig", "rig.json", *options]) == 0
    record = json.loads(capsys.readouterr().out)
    (rim,) = record["rims"]["found"]
    assert record["written"] == ["matches.npz", "matches-rims.npz"]
    rims = trinoc.load("matches-rims.npz")
    assert rims.centre_mm.tolist() == [rim["centre_mm"]]
    assert rims.radius_sigma_mm.tolist() == [rim["radius_sigma_mm"]]
    assert main(["export", "matches-rims.npz", "--to", "obj", "-o", "rims.obj", "--quiet"]) == 0
    assert abs(rim["radius_mm"] - 15.0) < 5 * rim["radius_sigma_mm"] < 1.0
    matches = trinoc.load_matches("matches.npz")
    added = record["rims"]["counts"]["pieces of rims"]
    distances_mm = np.linalg.norm(matches.lines_mm[-added:] - rim["centre_mm"], axis=2)
    np.testing.assert_allclose(distances_mm, rim["radius_mm"], atol=0.01)


def test_rims_need_pictures(scene, capsys):
    trinoc.save(trinoc.find_segments(np.asarray(cv2.imread("scene_left.png"))), "left.npz")
    files = [name.replace("scene_left.png", "left.npz") for name in scene]
    assert main(["match", *files, "--rig", "rig.json", "--steps", "rims", "--quiet"]) == 2
    assert "--steps rims needs pictures" in capsys.readouterr().err
