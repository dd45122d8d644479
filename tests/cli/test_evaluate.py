"""`trinoc evaluate` on matches of the demo and of a box, and on what it refuses."""

import csv
import json

import numpy as np
import pytest

import trinoc
from trinoc.cli.main import main
from trinoc.io import demo_images
from trinoc.io.demo import demo_folder
from trinoc.synth import table1_rig

RIG = table1_rig()
BOX_MM = np.array([[x, y, z] for x in (-30, 35) for y in (-25, 20) for z in (0, 30)], dtype=float)
LINKS = [(a, b) for a in range(8) for b in range(a) if (BOX_MM[a] != BOX_MM[b]).sum() == 1]
EDGES = BOX_MM[np.array(LINKS)]
TRUTH = str(demo_folder() / "truth.json")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The true rig, matches of a box, and its edges."""
    folder = tmp_path_factory.mktemp("evaluate")
    trinoc.save(RIG, folder / "rig.json")
    ends = {}
    for name, camera in RIG.items():
        images = np.concatenate([EDGES, np.ones((12, 2, 1))], axis=2) @ camera.matrix_px.T
        ends[name] = (images[..., :2] / images[..., 2:]).reshape(-1, 4)
    trinoc.save(trinoc.match_segments(ends, RIG), folder / "matches.npz")
    np.savetxt(folder / "edges.csv", EDGES.reshape(-1, 6), delimiter=",")
    np.savetxt(folder / "inches.csv", EDGES.reshape(-1, 6) / 25.4, delimiter=",")
    np.savetxt(folder / "shifted.csv", EDGES.reshape(-1, 6) + 1.5, delimiter=",")
    (folder / "nothing.csv").write_text("x1,y1,z1,x2,y2,z2\n")
    (folder / "table.csv.d").mkdir()
    return folder


@pytest.fixture
def run(folder, monkeypatch, capsys):
    """Runs the command in the folder: (status, stdout, stderr)."""
    monkeypatch.chdir(folder)

    def run_one(*arguments, quiet=True):
        status = main(["evaluate", *arguments, *(["--quiet"] if quiet else [])])
        return status, *capsys.readouterr()

    return run_one


def of_matches(truth="edges.csv", *more):
    return "--matches", "matches.npz", "--truth", truth, *more


def test_the_demo_against_its_truth(run, folder):
    pictures = demo_images("scene")
    segments = {view: trinoc.find_segments(picture) for view, picture in pictures.items()}
    trinoc.save(trinoc.match_segments(segments, RIG), "demo.npz")
    demo = "--matches", "demo.npz", "--rig", "rig.json", "--truth", TRUTH
    record = json.loads(run(*demo, "-o", "demo.csv", "--json")[1])
    assert "two pictures" in record["wanted"]
    three = json.loads(run(*demo, "--stage", "trinocular", "--json")[1])
    assert record["lines"] > three["lines"] > 20
    for values in (record, three):
        assert values["precision_1mm"] > 0.9
        assert values["distance_median_mm"] < 0.05
        assert 0.8 < values["share_within_1.96_sigma"] <= 1
    assert record["completeness_1mm"] > 0.8
    with open(folder / "demo.csv", encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["stage"] == "all"
    assert int(row["lines"]) == record["lines"]
    assert float(row["precision_1mm"]) == pytest.approx(record["precision_1mm"], rel=1e-5)
    assert record["written"] == ["demo.csv"]
    likely = json.loads(run(*demo, "--least-posterior", "0.99", "--json")[1])
    assert likely["lines"] < record["lines"]


def test_matches_of_a_box(run):
    status, out, _ = run(*of_matches("edges.csv", "--json"))
    assert status == 0
    record = json.loads(out)
    assert record["wanted"] == "every edge"
    assert record["completeness_0.1mm"] > 0.8
    assert record["distance_median_mm"] < 1e-3
    assert record["motion"] is None
    inches = json.loads(run(*of_matches("inches.csv", "--unit-mm", "25.4", "--json"))[1])
    assert inches["completeness_0.1mm"] == record["completeness_0.1mm"]
    visible = json.loads(run(*of_matches("edges.csv", "--rig", "rig.json", "--json"))[1])
    assert "two cameras" in visible["wanted"]


def test_alignment_is_asked_for_and_said(run):
    status, out, _ = run(*of_matches("shifted.csv"))
    assert status == 0
    assert "after laying" not in out
    status, out, _ = run(*of_matches("shifted.csv", "--align"))
    assert status == 0
    assert "turned by 0.00" in out
    record = json.loads(run(*of_matches("shifted.csv", "--align", "--json"))[1])
    np.testing.assert_allclose(record["motion"]["shift_mm"], 1.5, atol=1e-2)
    assert record["precision_0.1mm"] > 0.9


@pytest.mark.parametrize("form", ["tracks", "joined", "corners", "wireframe"])
def test_lines_are_joined_and_carried_to_corners(run, form):
    arguments = of_matches("edges.csv", "--rig", "rig.json", "--form", form)
    record = json.loads(run(*arguments, "--json")[1])
    assert record["form"] == form
    assert record["lines"] == 12
    assert record["distance_95_mm"] < 1e-2


WRONG_USAGE = {
    "joined without a rig": (of_matches("edges.csv", "--form", "joined"), "add --rig"),
    "no distance": (of_matches("edges.csv", "--within-mm"), "has no distance"),
}
REFUSED = {
    "no edges": (of_matches("nothing.csv"), "holds no edge"),
    "no truth": (of_matches("none.csv"), "none.csv does not exist"),
    "a folder": (of_matches("edges.csv", "-o", "table.csv.d"), "is a folder"),
    "no tolerance": (of_matches("edges.csv", "--within-mm", "0"), "positive distances"),
}


@pytest.mark.parametrize("case", WRONG_USAGE | REFUSED)
def test_what_is_refused(run, case):
    arguments, message = (WRONG_USAGE | REFUSED)[case]
    status, out, err = run(*arguments)
    assert status == (2 if case in WRONG_USAGE else 1)
    assert out == ""
    assert message in err
    assert err.count("\n") == 1


def test_lines_far_from_the_shape_are_said_and_not_refused(run, folder):
    np.savetxt(folder / "far.csv", EDGES.reshape(-1, 6) + 500.0, delimiter=",")
    status, out, _ = run(*of_matches("far.csv"))
    assert status == 0
    assert "No line lies on a known edge" in out


def test_a_wire_frame_is_exported_as_a_known_shape(folder, monkeypatch):
    monkeypatch.chdir(folder)
    matches, rig = (trinoc.load(folder / name) for name in ("matches.npz", "rig.json"))
    frame = trinoc.match.wireframe(matches, rig)
    record = frame.record()
    assert [record[name] for name in ("edges", "corners", "free_ends", "faces")] == [12, 8, 0, 6]
    assert record["let_go"] == []
    trinoc.save(frame, folder / "wireframe.npz")
    assert main(["export", "wireframe.npz", "--to", "obj", "-o", "box.obj"]) == 0
    shape = trinoc.io.load_shape(folder / "box.obj")
    assert len(shape.edges_mm) == 12
