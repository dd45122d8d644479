"""`trinoc match --steps shadows`: told, written, exported, shown, and read by people."""

import dataclasses
import json

import numpy as np

import trinoc
from tests.match.shadows.made_shadows import NEAR_LAMP, scene_of
from trinoc.cli.main import main
from trinoc.match import Shadows


def test_shadows_are_told_written_and_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rig, segments, _, shadow = scene_of(NEAR_LAMP)
    trinoc.save(rig, "rig.json")
    for name, own in segments.items():
        trinoc.save(own, f"{name}.npz")
    pictures = [f"{name}={name}.npz" for name in rig.names]
    asked = [
        "--steps",
        "shadows",
        "--report",
        "page.html",
        "-o",
        "matches.npz",
        "--json",
        "--quiet",
    ]
    assert main(["match", *pictures, "--rig", "rig.json", *asked]) == 0
    told = json.loads(capsys.readouterr().out)["shadows"]
    assert told["tracks_marked"] == shadow.sum()
    assert told["lamp_posterior"] > 0.9
    matches = trinoc.load_matches("matches.npz")
    assert (matches.marks["shadow"] > 0.5).sum() == shadow.sum()
    with open("page.html", encoding="utf-8") as page:
        words = page.read()
    assert ", shadow" in words
    assert ", of a shadow 0." in words
    assert main(["export", "matches.npz", "--to", "csv", "-o", "lines.csv", "--quiet"]) == 0
    with open("lines.csv", encoding="utf-8") as table:
        assert "shadow" in table.readline().strip().split(",")


def test_people_read_whether_there_is_a_lamp():
    found = Shadows(
        shadow=np.array([0.9, 0.1]),
        lamp_posterior=0.99,
        middle_mm=np.zeros(3),
        toward_lamp=np.array([0.6, 0.0, 0.8]),
        nearness_per_mm=0.0,
        lamp_covariance=np.diag([1e-6, 1e-6, 1e-10]),
        counts={},
    )
    said = found.summary()
    assert said.startswith("1 track is likely a shadow; the lamp is toward (0.600,")
    assert "no lamp stands out" in dataclasses.replace(found, lamp_posterior=0.1).summary()
