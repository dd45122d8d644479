"""`trinoc evaluate` on the demo's pictures, on matches, and on what it refuses."""

import csv
import json

import cv2
import numpy as np
import pytest

import trinoc
from trinoc.cli.main import main
from trinoc.io import demo_paths
from trinoc.io.demo import demo_folder
from trinoc.synth import table1_rig

RIG = table1_rig()
BOX_MM = np.array([[x, y, z] for x in (-30, 35) for y in (-25, 20) for z in (0, 30)], dtype=float)
LINKS = [(a, b) for a in range(8) for b in range(a) if (BOX_MM[a] != BOX_MM[b]).sum() == 1]
EDGES = BOX_MM[np.array(LINKS)]
PICTURES = [f"{view}={path}" for view, path in demo_paths("scene").items()]
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
    cv2.imwrite(str(folder / "small.png"), np.zeros((120, 160), np.uint8))
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


def test_pictures_with_two_settings_of_which_one_fails(run, folder):
    status, out, err = run(
        *PICTURES, "--rig", "rig.json", "--truth", TRUTH, "--find", "tolerance_px=-1,1.6",
        "--lines", "stage=all,trinocular", "-o", "demo.csv", "--plot", "demo.svg", "--json",
        quiet=False,
    )  # fmt: skip
    assert status == 0
    record = json.loads(out)
    assert "two pictures" in record["wanted"]
    failed, failed_too, every, three = record["rows"]
    assert failed["problem"] == failed_too["problem"] != ""
    assert (every["tolerance_px"], every["stage"], every["problem"]) == (1.6, "all", "")
    assert every["lines"] > three["lines"] > 20
    for row in (every, three):
        assert row["precision_1mm"] > 0.9
        assert row["distance_median_mm"] < 0.05
        assert 0.8 < row["share_within_1.96_sigma"] <= 1
    assert every["completeness_1mm"] > 0.8
    assert len(record["edges"][2]) == every["edges_wanted_whole"] > 30
    assert "2 of 2: tolerance 1.6 px" in err
    assert "tolerance_px is -1.0" in err
    with open(folder / "demo.csv", encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["stage"] for row in table] == ["all", "trinocular"] * 2
    assert table[0]["lines"] == "" != table[0]["problem"]
    assert int(table[2]["lines"]) == every["lines"]
    assert float(table[2]["precision_1mm"]) == pytest.approx(every["precision_1mm"], rel=1e-5)
    assert record["written"] == ["demo.csv", "demo.svg"]


def test_matches_of_a_box(run):
    status, out, _ = run(*of_matches("edges.csv", "--json"))
    assert status == 0
    record = json.loads(out)
    (row,) = record["rows"]
    assert record["wanted"] == "every edge"
    assert row["completeness_0.1mm"] > 0.8
    assert row["distance_median_mm"] < 1e-3
    assert record["motions"] == [None]
    inches = json.loads(run(*of_matches("inches.csv", "--shape", "unit_mm=25.4", "--json"))[1])
    assert inches["rows"][0]["completeness_0.1mm"] == row["completeness_0.1mm"]
    seen = json.loads(run(*of_matches("edges.csv", "--rig", "rig.json", "--json"))[1])
    assert "two cameras" in seen["wanted"]


def test_alignment_is_asked_for_and_said(run):
    status, out, _ = run(*of_matches("shifted.csv"))
    assert status == 0
    assert "after laying" not in out
    status, out, _ = run(*of_matches("shifted.csv", "--shape", "align=yes"))
    assert status == 0
    assert "turned by 0.00" in out
    record = json.loads(run(*of_matches("shifted.csv", "--shape", "align=yes", "--json"))[1])
    assert record["aligned"] is True
    np.testing.assert_allclose(record["motions"][0]["shift_mm"], 1.5, atol=1e-2)
    assert record["rows"][0]["precision_0.1mm"] > 0.9


def test_lines_are_joined_and_carried_to_corners(run):
    forms = "tracks", "joined", "corners"
    arguments = of_matches("edges.csv", "--rig", "rig.json", "--lines", f"form={','.join(forms)}")
    record = json.loads(run(*arguments, "--json")[1])
    assert [row["form"] for row in record["rows"]] == list(forms)
    for row in record["rows"]:
        assert row["problem"] == ""
        assert row["distance_95_mm"] < 1e-2
        assert row["length_error_95_mm"] < 1e-2
    assert run(*arguments)[1].count("corners") == 1


WRONG_USAGE = {
    "neither": (("--truth", "edges.csv"), "either NAME=IMG"),
    "both": (("a=b.png", *of_matches()), "either NAME=IMG"),
    "no rig": (("a=b.png", "--truth", "edges.csv"), "add --rig"),
    "a sweep of matches": (of_matches("edges.csv", "--find", "tolerance_px=1,2"), "a setting"),
    "joined without a rig": (of_matches("edges.csv", "--lines", "form=joined"), "add --rig"),
    "a setting of matches": (of_matches("edges.csv", "--find", "least_contrast=9"), "a setting"),
    "no value": (of_matches("edges.csv", "--lines", "stage="), "has no value"),
}
REFUSED = {
    "no edges": (of_matches("nothing.csv"), "holds no edge"),
    "no truth": (of_matches("none.csv"), "none.csv does not exist"),
    "another plot": (of_matches("edges.csv", "--plot", "plot.bmp"), "choose such a name"),
    "a folder": (of_matches("edges.csv", "-o", "table.csv.d"), "is a folder"),
    "segments": (("upper=edges.csv", "--rig", "rig.json", "--truth", "edges.csv"), "on pictures"),
    "a small picture": (
        (*PICTURES[1:], "upper=small.png", "--rig", "rig.json", "--truth", "edges.csv"),
        "160 x 120 px, but the rig",
    ),
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


def test_a_box_becomes_a_wire_frame_and_is_compared_with_its_edges(run, folder, capsys):
    status, out, _ = run(
        *of_matches(), "--rig", "rig.json", "--lines", "form=wireframe", "-o", "frame.csv", "--json"
    )
    assert status == 0
    (row,) = json.loads(out)["rows"]
    assert (row["edges_wanted"], row["edges_found"], row["edges_extra"]) == (12, 12, 0)
    assert (row["corners_wanted"], row["corners_found"], row["corners_extra"]) == (8, 8, 0)
    assert row["corner_error_median_mm"] < 1e-3
    assert row["faces"] == 6
    matches, rig = (trinoc.load(folder / name) for name in ("matches.npz", "rig.json"))
    frame = trinoc.match.wireframe(matches, rig)
    said = frame.record()
    assert (said["edges"], said["corners"], said["free_ends"], said["faces"]) == (12, 8, 0, 6)
    assert said["let_go"] == []
    trinoc.save(frame, folder / "wireframe.npz")
    assert main(["export", "wireframe.npz", "--to", "obj", "-o", "box.obj"]) == 0
    shape = trinoc.io.load_shape(folder / "box.obj")
    assert len(shape.edges_mm) == 12
