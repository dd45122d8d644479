"""Output paths are checked before the work: no result overwrites an input or another result."""

import dataclasses
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

import trinoc
from tests.io.formats.bench import bench_matches
from trinoc.cli.checks import expect_options
from trinoc.cli.main import main, parse_arguments
from trinoc.match.tracks.reliability import assess_matches
from trinoc.synth import table1_rig

VIEWS = ("upper", "left", "right")
MATCH = ("match", *(f"{view}={view}.npz" for view in VIEWS), "--rig", "rig.json")
CALIBRATE = (
    *("calibrate", *(f"{view}={view}.png" for view in VIEWS), "--board", "sheet.json"),
    *("--lens-mm", "16", "0.0162", "0.0134"),
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A rig, a sheet, and a picture and segments of each camera."""
    monkeypatch.chdir(tmp_path)
    trinoc.save(table1_rig(), "rig.json")
    pattern = trinoc.Pattern.cross_grid(rows=2, columns=2, pitch_mm=20.0, radius_mm=6.0)
    trinoc.save(pattern, "sheet.json")
    ends = np.random.default_rng(3).uniform(20, 400, (6, 4))
    for view in VIEWS:
        trinoc.save(trinoc.Segments.from_endpoints(ends), f"{view}.npz")
        cv2.imwrite(f"{view}.png", np.zeros((480, 512), np.uint8))
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((*MATCH, "-o", "left.npz"), "--out is left.npz, which is an input"),
        ((*MATCH, "--report", "./rig.json"), "--report is rig.json, which is an input"),
        ((*MATCH, "-o", "x.npz", "--report", "x.npz"), "are both x.npz"),
        ((*CALIBRATE, "-o", "sheet.json"), "--out is sheet.json, which is an input"),
        ((*CALIBRATE, "-o", "r.json", "--report", "r.json"), "are both r.json"),
        (("refine", "--matches", "left.npz", "--rig", "rig.json", "-o", "left.npz"), "is an input"),
        (("export", "left.npz", "--to", "lsd", "-o", "left.npz"), "which is an input"),
        (("segments", "left.png", "-o", "left.png"), "which is an input"),
        ((*MATCH, "-o", "x.npz", "--report", "x.pdf"), "a report is HTML"),
    ],
)
def test_no_result_goes_over_another_file_of_the_job(folder, arguments, message, capsys):
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert main([*arguments, "--quiet"]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert re.search(message, err)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_a_rig_may_take_the_place_of_the_one_it_was_made_from() -> None:
    refine = ("refine", "--matches", "left.npz", "--rig", "rig.json", "-o", "rig.json")
    for arguments in (refine, (*CALIBRATE, "--orientation", "rig.json", "-o", "rig.json")):
        expect_options(parse_arguments(arguments))


def test_a_link_to_what_is_read_is_what_is_read(folder, capsys):
    Path("other.npz").symlink_to("left.npz")
    assert main([*MATCH, "-o", "other.npz", "--quiet"]) == 2
    assert "which is an input" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((*MATCH, "-o", "m.csv"), "matches are written as .npz"),
        ((*CALIBRATE, "-o", "rig.npz"), "a rig is written as .json"),
        (("segments", "left.png", "-o", "s.csv"), "segments are written as .npz"),
        (("refine", "--matches", "none.npz", "--rig", "rig.json", "-o", "r.txt"), "a rig is"),
    ],
)
def test_a_name_that_cannot_be_written_is_said_before_the_work(folder, arguments, message, capsys):
    # Before: where files are missing, too, the name comes first; `--dry-run` says it as well.
    dry = ["--dry-run"] if arguments[0] in ("match", "calibrate") else []
    assert main([*arguments, *dry]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert message in err


@pytest.mark.parametrize(
    ("focal_length", "message"),
    [("0.016", "metres: write 16 millimetres"), ("16000", "micrometres: write 16 millimetres")],
)
def test_a_focal_length_in_another_unit_is_named(folder, focal_length, message, capsys):
    arguments = list(CALIBRATE)
    arguments[arguments.index("16")] = focal_length
    assert main([*arguments, "--quiet"]) == 2
    assert message in capsys.readouterr().err


def test_a_drawing_given_for_its_layout_is_not_to_be_corrected(folder, capsys):
    Path("sheet.svg").write_text("<svg/>")
    arguments = ["sheet.svg" if word == "sheet.json" else word for word in CALIBRATE]
    assert main([*arguments, "--quiet"]) == 1
    assert "sheet.svg is not JSON: give the .json file." in capsys.readouterr().err


def test_depths_that_leave_nothing_are_named():
    matches = bench_matches()
    reasons = {view: np.full(len(w), "outside depth") for view, w in matches.reasons.items()}
    none = dataclasses.replace(matches, stage=np.full(len(matches), "binocular"), reasons=reasons)
    assert "Check depth_range_mm" in assess_matches(none).sentence


def test_a_file_of_another_kind_is_not_replaced_unless_forced(folder, capsys):
    Path("link.json").symlink_to("rig.json")
    Path("mine.json").write_text('{"mine": 1}')
    Path("mine.npz").write_bytes(b"none of ours")
    Path("mine.html").write_text("<p>mine</p>")
    before = {path: path.read_bytes() for path in folder.iterdir()}
    for file_name in ("rig.json", "link.json", "mine.json"):
        assert main(["pattern", "-o", file_name]) == 1
        assert (
            "which would be overwritten: give another name, or --force" in capsys.readouterr().err
        )
    for file_name in ("mine.npz",):
        assert main([*MATCH, "-o", file_name]) == 1
        assert "which would be overwritten" in capsys.readouterr().err
    evaluate = ("evaluate", "--matches", "upper.npz", "--truth", "sheet.json")
    for arguments in (
        (*MATCH, "-o", "new.npz", "--report", "mine.html"),
        (*evaluate, "-o", "rig.json"),
        ("export", "left.npz", "--to", "json", "-o", "rig.json"),
        ("pattern", "-o", "right.png", "--screen", "size_px=400,300", "pitch_mm=0.3"),
    ):
        assert main([*arguments]) == 1, arguments
        assert "which would be overwritten" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    assert main(["pattern", "-o", "sheet.json"]) == 0
    assert main(["pattern", "-o", "mine.json", "--force"]) == 0
    assert trinoc.load("mine.json").kind == trinoc.load("sheet.json").kind
