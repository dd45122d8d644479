"""A first calibration in an empty folder, the lens from its data sheet, and what reads it."""

import json
from pathlib import Path

import numpy as np
import pytest

import trinoc
from tests.cli.conftest import EDGES
from trinoc.cli.main import main
from trinoc.io import read_image
from trinoc.synth import table1_rig

LENS = ("--lens-mm", "16", "0.0162", "0.0134")
EXACT = ("--sigma", "lens=0", "aim_mm=0", "flatness_mm=0", "print_scale=0")
RIG = table1_rig()
VIEWS = [f"{name}={name}.png" for name in RIG]


@pytest.fixture(scope="module")
def folder(sheet_and_box: Path) -> Path:
    """The files of a new user: a sheet, its picture by each camera, and a scene's segments."""
    return sheet_and_box


@pytest.fixture
def run(folder, monkeypatch, capsys):
    """Runs a command in the folder: (status, stdout, stderr)."""
    monkeypatch.chdir(folder)

    def run_one(*arguments):
        status = main([*arguments, "--quiet"])
        return status, *capsys.readouterr()

    return run_one


def calibrate(*options: str) -> tuple[str, ...]:
    return "calibrate", *VIEWS, "--pattern", "sheet.json", *LENS, *options


@pytest.mark.slow
def test_what_a_data_sheet_gives_is_read_by_every_command(run, folder):
    status, out, err = run(*calibrate("--report", "report.html", "--json"))
    assert (status, err) == (0, "")
    record = json.loads(out)
    rig = trinoc.load_rig(folder / "rig.json")
    assert isinstance(record["notes"], list)
    # What no picture shows is said wherever the sigmas are.
    included = record["sigmas_include"]
    assert "print size (0.2 %)" in included
    assert json.loads((folder / "rig.json").read_text())["provenance"]["sigmas_include"] == included
    assert "print size (0.2 %)" in (folder / "report.html").read_text(encoding="utf-8")
    for name, camera in RIG.items():
        camera_record = record["cameras"][name]
        assert camera_record["method"] in ("pixels", "points")
        # The paper's four are told; the rig also holds the aim and the lens.
        assert set(camera_record["parameters"]) == {
            "pan_deg",
            "tilt_deg",
            "swing_deg",
            "distance_mm",
        }
        for key, estimate in camera_record["parameters"].items():
            assert estimate["sigma"] == pytest.approx(rig.sigma(f"{name}.{key}"), rel=1e-12)
            assert abs(estimate["value"] - getattr(camera, key)) < 4 * estimate["sigma"]
        assert rig.sigma(f"{name}.aim_x_mm") > 0
        assert rig.sigma(f"{name}.fx_px") > 0
    # Pose and lens err together, so that points near the sheet are known well all the same.
    sigma_mm = np.sqrt(np.trace(trinoc.calib.point_covariance(rig, np.array([5.0, 9.0, 3.0]))))
    assert sigma_mm < 0.1 * rig.sigma("upper.distance_mm")
    scene = [f"{name}={name}.csv" for name in RIG]
    assert run("match", *scene, "--rig", "rig.json", "-o", "matches.npz")[0] == 0
    matches = trinoc.load_matches(folder / "matches.npz")
    assert len(matches) >= len(EDGES) - 3
    status, out, _ = run("check", "--rig", "rig.json", "--matches", "matches.npz", "--json")
    assert status == 0
    assert json.loads(out)["moved"] == []
    refine = ("refine", "--rig", "rig.json", "--matches", "matches.npz", "-o", "refined.json")
    assert run(*refine)[0] == 0
    assert trinoc.load_rig(folder / "refined.json").sigma("upper.fx_px") > 0
    status, out, _ = run("compare", "refined.json", "rig.json", "--json")
    assert status == 0
    compared = json.loads(out)
    assert compared["moved"] == []
    for name in RIG:
        # The refined rig holds what the sheet's rig knew.
        assert 0 < compared["cameras"][name]["field_sigmas"] < 1
    trinoc.save(trinoc.Rig(dict(rig.items())), folder / "plain.json")
    status, out, _ = run("compare", "plain.json", "rig.json", "--json")
    assert status == 0
    # What nobody stated is not known, and no number of JSON.
    assert json.loads(out)["cameras"]["upper"]["sigmas"] is None
    assert "not known" in run("compare", "plain.json", "rig.json")[1]


def test_bars_that_measure_what_they_should_are_measured_all_the_same(run):
    """The advice names the largest error source, and omits a source that was measured."""
    points = calibrate("--method", "points", "--sigma", "lens=0", "-o", "bars.json", "--json")
    assumed = json.loads(run(*points)[1])
    assert "measure the two bars of the sheet (--print-scale)" in assumed["advice"]
    measured = json.loads(run(*points, "--print-scale", "1", "1", "--force")[1])
    assert "bars" not in measured["advice"]
    assert "The sigmas assume that the lens is exact" in measured["advice"]
    sigmas = [
        record["cameras"]["upper"]["parameters"]["distance_mm"] for record in (assumed, measured)
    ]
    assert sigmas[1]["sigma"] < 0.3 * sigmas[0]["sigma"]


def test_all_that_is_exact_is_the_model_of_the_paper(run, folder):
    status, out, _ = run(*calibrate("--method", "points", *EXACT, "-o", "exact.json", "--json"))
    assert status == 0
    record = json.loads(out)
    assert record["sigmas_include"] == ["noise"]
    pattern = trinoc.load_pattern(folder / "sheet.json")
    images = {name: read_image(folder / f"{name}.png") for name in RIG}
    lens = trinoc.Intrinsics(
        focal_length_mm=16.0, pixel_pitch_mm=(0.0162, 0.0134), image_size_px=(512, 480)
    )
    exact = trinoc.Systematics()
    result = trinoc.calibrate(images, pattern, lens, method="points", systematics=exact)
    for parameter, value in zip(result.parameters, result.values, strict=True):
        name, _, key = parameter.partition(".")
        estimate = record["cameras"][name]["parameters"][key]
        assert estimate["value"] == pytest.approx(value, rel=1e-12)
        assert estimate["sigma"] == pytest.approx(result.sigma(parameter), rel=1e-9)
    assert trinoc.load_rig(folder / "exact.json").parameters == result.parameters
    assert all(record["cameras"][name]["method"] == "points" for name in RIG)


@pytest.mark.parametrize("value", ["-1", "nan", "inf"])
@pytest.mark.parametrize("name", ["flatness_mm", "aim_mm", "print_scale", "lens"])
def test_what_is_no_sigma_is_refused_before_anything_is_read(name, value, capsys):
    files = ("--board", "none.json", "a=none.png")
    assert main(["calibrate", *files, *LENS, "--sigma", f"{name}={value}", "--quiet"]) == 2
    stderr = capsys.readouterr().err
    why = "no standard deviation" if value == "-1" else "give a finite number"
    assert f"--sigma {name}={value}" in stderr
    assert why in stderr
    assert "Traceback" not in stderr
