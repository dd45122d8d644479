"""The commands on files: what they write, what they print, and what they refuse."""

import json

import cv2
import numpy as np
import pytest

import trinoc
from tests.cli.conftest import BOX_MM, EDGES
from tests.cli.run_command import run_command
from trinoc.cli.main import main
from trinoc.io import demo_paths
from trinoc.synth import table1_lens, table1_rig

LENS = ("--lens-mm", "16", "0.0162", "0.0134")
# Made pictures are of what is said of them.
EXACT = ("--sigma", "lens=0", "aim_mm=0", "flatness_mm=0", "print_scale=0")
RIG = table1_rig()


@pytest.fixture(scope="module")
def folder(sheet_and_box, sheet_pictures):
    """Pictures of the sheet, its layout, the true rig, and segments of a box."""
    folder = sheet_and_box
    trinoc.save(RIG, folder / "rig.json")
    for name, picture in sheet_pictures[1].items():
        cv2.imwrite(str(folder / f"{name}.tif"), picture.astype(np.uint16) * 257)
    random = np.random.default_rng(3)
    photo = random.integers(0, 256, (480, 512, 3), dtype=np.uint8)
    cv2.imwrite(str(folder / "photo.png"), cv2.GaussianBlur(photo, (0, 0), 4))
    (folder / "empty").mkdir()
    (folder / "nothing.csv").write_text("x1,y1,x2,y2\n")
    return folder


@pytest.fixture
def run(folder, monkeypatch, capsys):
    """Runs a command in the folder: (status, stdout, stderr)."""
    monkeypatch.chdir(folder)

    def run_one(*arguments):
        status = main([*arguments, "--quiet"])
        return status, *capsys.readouterr()

    return run_one


def views(suffix):
    return [f"{name}={name}.{suffix}" for name in RIG]


def calibrate(*pictures):
    return "calibrate", *pictures, "--pattern", "sheet.json", *LENS, *EXACT


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_calibrate(run, folder, suffix):
    written = ["made.json", "made.html"]
    command = *calibrate(*views(suffix)), "-o", written[0], "--report", written[1]
    status, out, err = run(*command, "--json")
    assert (status, err) == (0, "")
    record = json.loads(out)
    assert record["written"] == written
    assert list(record["cameras"]) == list(RIG)
    rig = trinoc.load_rig(folder / "made.json")
    for name, camera in RIG.items():
        fitted = record["cameras"][name]["parameters"]
        assert fitted["pan_deg"]["value"] == pytest.approx(rig[name].pan_deg, abs=1e-12)
        assert fitted["pan_deg"]["sigma"] == rig.sigma(f"{name}.pan_deg") > 0
        for parameter, tolerance in [("pan_deg", 0.01), ("tilt_deg", 0.01), ("distance_mm", 0.05)]:
            assert getattr(rig[name], parameter) == pytest.approx(
                getattr(camera, parameter), abs=tolerance
            )
    origin = json.loads((folder / "made.json").read_text())["provenance"]
    assert origin["command"].startswith("trinoc calibrate upper=upper.")
    assert set(origin["inputs"]) == {*RIG, "board"}
    assert "trinoc calibrate" in (folder / "made.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def upper(folder):
    """The text output of calibrating one camera."""
    return run_command([*calibrate("upper=upper.png"), "-o", "upper.json", "--quiet"], folder)


@pytest.fixture(scope="module")
def matched(folder):
    """The run of `trinoc match` on the pictures of the sheet."""
    command = ["match", *views("png"), "--rig", "rig.json", "-o", "matched.npz"]
    return run_command([*command, "--json", "--quiet"], folder)


def test_calibrate_says_the_same_to_people(upper):
    assert upper.status == 0
    assert "pan (deg)" in upper.stdout
    assert upper.stdout.endswith("written: upper.json\n")


@pytest.mark.slow
def test_a_suspect_rig_is_written_only_where_it_is_accepted_and_says_so(run, folder):
    command = *calibrate("upper=upper.png"), "--print-scale", "1.004", "0.996", "-o", "doubt.json"
    status, out, err = run(*command, "--json")
    assert status == 1
    assert 'of "upper" is SUSPECT' in err
    assert "--accept-suspect" in err
    assert json.loads(out)["cameras"]["upper"]["status"] == "suspect"
    assert not (folder / "doubt.json").exists()
    assert run(*command, "--accept-suspect")[0] == 0
    document = json.loads((folder / "doubt.json").read_text())
    assert document["status"]["cameras"]["upper"]["status"] == "suspect"
    assert document["status"]["cameras"]["upper"]["notes"]


@pytest.mark.usefixtures("upper")
def test_grey_levels_from_0_to_1_calibrate_as_bytes_do(run, folder):
    picture = cv2.imread(str(folder / "upper.png"), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    cv2.imwrite(str(folder / "unit.tif"), (picture / 255).astype(np.float32))
    assert run(*calibrate("upper=unit.tif"), "-o", "unit.json")[0] == 0
    of_bytes, of_unit = (trinoc.load_rig(folder / f"{name}.json") for name in ("upper", "unit"))
    assert of_unit["upper"].distance_mm == pytest.approx(of_bytes["upper"].distance_mm, abs=1e-3)


@pytest.mark.usefixtures("upper")
def test_a_longer_print_is_a_longer_distance(run, folder):
    command = *calibrate("upper=upper.png"), "--print-scale", "1.01", "1.01"
    assert run(*command, "-o", "longer.json")[0] == 0
    true, longer = (
        trinoc.load_rig(folder / file)["upper"] for file in ("upper.json", "longer.json")
    )
    assert longer.distance_mm / true.distance_mm == pytest.approx(1.01, abs=1e-4)
    assert longer.pan_deg == pytest.approx(true.pan_deg, abs=1e-3)


def test_segments_then_match_is_match_of_pictures(run, folder, matched):
    for name in RIG:
        assert run("segments", f"{name}.png", "-o", f"{name}.npz")[0] == 0
    result = run("match", *views("npz"), "--rig", "rig.json", "-o", "a.npz", "--json")
    assert result[0] == matched.status == 0
    a, b = (trinoc.load_matches(folder / file) for file in ("a.npz", "matched.npz"))
    np.testing.assert_array_equal(a.index, b.index)
    np.testing.assert_array_equal(a.lines_mm, b.lines_mm)
    assert json.loads(result[1])["tracks"] == matched.record["tracks"]


@pytest.mark.usefixtures("matched")
def test_lines_measured_in_pictures_are_those_of_the_segments_placed_anew(run, folder):
    status, _, error = run("match", *views("csv"), "--rig", "rig.json", "--steps", "pixels")
    assert status == 2
    assert "--steps pixels needs pictures" in error
    command = "match", *views("png"), "--rig", "rig.json"
    assert run(*command, "--steps", "pixels", "-o", "measured.npz")[0] == 0
    plain, after = (trinoc.load_matches(folder / f"{name}.npz") for name in ("matched", "measured"))
    assert plain.marks == {}
    assert ((after.marks["measure"] == "") == (after.index < 0)).all()
    np.testing.assert_array_equal(after.index, plain.index)
    moved = np.abs(after.lines_mm - plain.lines_mm).max(axis=(1, 2))
    assert (moved > 0).any()
    assert np.median(moved) < 1.0


def test_match_finds_the_box_and_reports_it(run, folder):
    written = ["box.npz", "box.html"]
    command = "match", *views("csv"), "--rig", "rig.json", "-o", written[0], "--report", written[1]
    status, out, _ = run(*command, "--json")
    assert status == 0
    record = json.loads(out)
    assert record["written"] == written
    assert record["segments"] == dict.fromkeys(RIG, len(EDGES))
    matches = trinoc.load_matches(folder / "box.npz")
    assert record["remarks"] == []
    assert len(matches) == record["tracks"]["trinocular"] + record["tracks"]["binocular"]
    ends = matches.lines_mm.reshape(-1, 3)
    nearest = np.linalg.norm(ends[:, None] - BOX_MM[None], axis=-1).min(axis=1)
    assert len(matches) >= len(EDGES) - 2
    assert np.median(nearest) < 1e-2
    assert "<html" in (folder / "box.html").read_text(encoding="utf-8")


REFUSED = {
    "empty folder": (calibrate("upper=empty", "left=left.png"), "empty is a folder without"),
    "folder": (calibrate("upper=.", "left=left.png"), "give one picture in it"),
    "the same picture twice": (
        calibrate("upper=left.png", "left=left.tif", "right=left.png"),
        '"upper" and "right" are the same picture',
    ),
    "a file that is missing": (calibrate("upper=none.png"), "none.png does not exist"),
    "a file of another kind": (calibrate("upper=sheet.json"), "not a readable picture"),
    "a rig for a sheet": (
        ("calibrate", "upper=upper.png", "--pattern", "rig.json", *LENS, "-o", "new.json"),
        '"trinoc-pattern" is needed',
    ),
    "a lens of another camera": (
        ("calibrate", "upper=upper.png", "--pattern", "sheet.json", "--intrinsics", "lens.json"),
        "but its lens is for 640 x 480",
    ),
    "no such folder": ((*calibrate("upper=upper.png"), "-o", "no/rig.json"), "folder no does not"),
    "a camera without a picture": (
        ("match", "upper=upper.csv", "left=left.csv", "--rig", "rig.json"),
        'has the camera "right", for which no picture is given: add right=FILE',
    ),
    "a camera that the rig lacks": (
        ("match", "upper=upper.csv", "lower=left.csv", "--rig", "rig.json"),
        'rig.json has no camera "lower", but',
    ),
    "a picture of another size": (
        ("match", "upper=small.png", "left=left.png", "right=right.png", "--rig", "rig.json"),
        "calibrated for 512 x 480 px",
    ),
    "NaN among segments": (
        ("match", "upper=nan.csv", "left=left.csv", "right=right.csv", "--rig", "rig.json"),
        "nan.csv: Segment 3 has a coordinate that is not finite",
    ),
    "an unknown key": (
        ("match", *views("csv"), "--rig", "unknown.json"),
        'unknown.json: "cameras.upper.colour" is an unknown key',
    ),
}


@pytest.fixture(scope="module")
def broken(folder):
    """A folder of invalid files."""
    lens = trinoc.Intrinsics(focal_length_px=1000.0, image_size_px=(640, 480))
    trinoc.save(lens, folder / "lens.json")
    cv2.imwrite(str(folder / "small.png"), np.zeros((48, 64), np.uint8))
    ends = np.loadtxt(folder / "upper.csv", delimiter=",")
    ends[3, 1] = np.nan
    np.savetxt(folder / "nan.csv", ends, delimiter=",")
    rig = json.loads((folder / "rig.json").read_text())
    rig["cameras"]["upper"]["colour"] = "red"
    (folder / "unknown.json").write_text(json.dumps(rig))


@pytest.mark.parametrize("what", REFUSED)
@pytest.mark.usefixtures("broken")
def test_refusal_is_one_line_and_status_1(run, folder, what):
    command, sentence = REFUSED[what]
    before = sorted(folder.iterdir())
    status, out, err = run(*command)
    assert sentence in err
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert sorted(folder.iterdir()) == before


def test_a_camera_that_fails_leaves_the_others_and_a_picture_of_why(run, folder):
    command = *calibrate("upper/a=photo.png", "left=left.png"), "-o", "part.json"
    status, out, err = run(*command)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert 'Camera "upper/a": No sheet of the pattern' in err
    assert (
        "part-incomplete.json contains the calibrated cameras (left); part.json was not written"
        in err
    )
    assert not (folder / "part.json").exists()
    assert trinoc.load_rig(folder / "part-incomplete.json").names == ("left",)
    assert trinoc.io.read_image(folder / "part-upper%2Fa-failed.png").ndim == 3


@pytest.mark.parametrize("shuffled", ["upper=left.csv left=right.csv right=upper.csv", "nothing"])
def test_scene_that_hardly_matches_says_what_to_check(run, shuffled):
    files = shuffled.split() if "=" in shuffled else [f"{name}={shuffled}.csv" for name in RIG]
    status, out, _ = run("match", *files, "--rig", "rig.json", "-o", "none.npz")
    assert status == 0
    assert "Use these matches with care. 0 sure lines in three views" in out
    assert "Check that this rig took these images" in out


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_pattern_writes_a_sheet_that_calibrate_reads(run, folder, paper):
    status, out, _ = run("pattern", "--paper", paper, "-o", "printed.json", "--json")
    assert status == 0
    assert json.loads(out)["written"] == ["printed.json", "printed.svg", "printed.pdf"]
    assert len(trinoc.load_pattern(folder / "printed.json")) == json.loads(out)["circles"]
    assert (folder / "printed.pdf").read_bytes().startswith(b"%PDF")


def test_pattern_that_does_not_fit_the_paper_is_not_written(run, folder):
    before = sorted(folder.iterdir())
    status, _, err = run("pattern", "sheet", "pitch_mm=80", "-o", "large.json")
    assert status == 1
    assert "more than a4 offers" in err
    assert sorted(folder.iterdir()) == before


def test_lens_of_the_reference_rig_is_that_of_the_options():
    lens = table1_lens()
    assert (lens.focal_length_mm, lens.pixel_pitch_mm) == (16, (0.0162, 0.0134))


def test_the_readme_s_code_and_the_command_agree_on_a_colour_picture(folder, run):
    # README reads with cv2.imread, in the order blue, green, red; the command in red, green, blue.
    status, *_ = run("segments", "photo.png", "-o", "photo.npz")
    assert status == 0
    by_command = trinoc.load_segments(folder / "photo.npz")
    by_readme = trinoc.find_segments(np.asarray(cv2.imread(str(folder / "photo.png"))))
    assert len(by_readme) > 0
    np.testing.assert_array_equal(by_command.endpoints_px, by_readme.endpoints_px)
    np.testing.assert_array_equal(by_command.covariance_px2, by_readme.covariance_px2)


def test_pictures_under_each_others_names_fail_the_match_with_the_cause(tmp_path, capsys):
    scenes = demo_paths("scene")
    paths = {"upper": scenes["left"], "left": scenes["upper"], "right": scenes["right"]}
    trinoc.save(table1_rig(), tmp_path / "rig.json")
    pictures = [f"{name}={path}" for name, path in paths.items()]
    out = tmp_path / "m.npz"
    command = ["match", *pictures, "--rig", str(tmp_path / "rig.json"), "-o", str(out), "--quiet"]
    assert main([*command, "--json"]) == 1
    output = capsys.readouterr()
    assert "do not seem to belong together" in output.err
    assert json.loads(output.out)["status"] == "suspect"
    assert trinoc.load(out).status.name == "SUSPECT"
