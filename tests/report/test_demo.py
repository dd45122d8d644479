"""`trinoc demo`, once, on the bundled pictures: what it says, writes and reaches."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run_command import Run, run_command
from trinoc.cli.main import main
from trinoc.io.compile_cache import COMPILE_CACHE_VARIABLE
from trinoc.io.rig_json import load_rig
from trinoc.io.saving import load_matches
from trinoc.synth import table1_rig


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    parent = tmp_path_factory.mktemp("demo")
    folder = parent / "new" / "folder"
    return run_command(["demo", "--out", str(folder), "--keep-inputs", "--json"], parent)._replace(
        folder=folder
    )


def test_one_object_on_stdout_and_progress_on_stderr(run: Run) -> None:
    assert run.status == 0
    assert isinstance(run.record, dict)
    assert run.record["status"] == "matched"
    assert run.record["verdict"].startswith("You can use these matches. ± ")
    assert "calibrating" in run.stderr
    assert "matching" in run.stderr


def test_the_files_are_there(run: Run) -> None:
    results = {"report.html", "rig.json", "matches.npz"}
    assert {file.name for file in run.folder.iterdir()} == {*results, "inputs", "trinoc.toml"}
    inputs = {f"inputs/{kind}_{view}.png" for kind in ("sheet", "scene") for view in table1_rig()}
    input_files = {"inputs/sheet.json", "trinoc.toml", *inputs}
    written = {str(Path(file).relative_to(run.folder)) for file in run.record["written"]}
    assert written == results | input_files
    assert all((run.folder / name).is_file() for name in written)
    page = (run.folder / "report.html").read_text(encoding="utf-8")
    # Four that are asked for, and the aim, which is not exact.
    assert page.count("data-parameter=") == 3 * 6
    assert "Against the truth" in page


def test_every_parameter_is_within_the_aim(run: Run) -> None:
    comparison = run.record["table_1"]
    assert len(comparison) == 12
    for name, row in comparison.items():
        aim = 0.03 if name.endswith("_mm") else 0.005
        assert abs(row["error"]) < aim, name
        assert abs(row["error_over_sigma"]) < 5, name


def test_the_rig_file_holds_what_was_printed(run: Run) -> None:
    rig, true_rig = load_rig(run.folder / "rig.json"), table1_rig()
    for name in true_rig:
        printed = run.record["cameras"][name]["parameters"]
        assert rig[name].pan_deg == pytest.approx(printed["pan_deg"]["value"], abs=1e-9)
        assert rig.sigma(f"{name}.pan_deg") == pytest.approx(printed["pan_deg"]["sigma"])
        assert rig[name].distance_mm == pytest.approx(true_rig[name].distance_mm, abs=0.03)


def test_the_matches_file_holds_what_was_counted(run: Run) -> None:
    matches = load_matches(run.folder / "matches.npz")
    tracks = run.record["tracks"]
    assert len(matches) == tracks["trinocular"] + tracks["binocular"]
    assert tracks["trinocular"] > 0
    assert np.isfinite(matches.lines_mm).all()
    for view, count in run.record["segments"].items():
        assert len(matches.reasons[view]) == count
        assert sum(run.record["reasons"][view].values()) == count


def test_most_of_what_is_put_out_is_right(run: Run) -> None:
    score = run.record["score"]
    assert 0.95 < score["length_precision"] <= 1
    assert 0.8 < score["length_recall"] <= 1
    assert 0.7 < score["length_recall_with_rims"] <= score["length_recall"]


def test_the_commands_printed_make_the_same_results(
    run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, "off")
    monkeypatch.chdir(run.folder)
    for line in run.record["commands"]:
        program, *arguments = shlex.split(line)
        assert program == "trinoc"
        assert main([*arguments, "--quiet"]) == 0, capsys.readouterr().err
    mine, demo = load_rig("my-rig.json"), load_rig("rig.json")
    np.testing.assert_allclose(mine.matrices_px, demo.matrices_px, rtol=1e-9)
    assert len(load_matches("my-matches.npz")) == len(load_matches("matches.npz"))
    assert Path("my-calibration.html").stat().st_size < 1_000_000


def test_the_file_in_the_folder_stands_in_for_all_arguments(
    run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, "off")
    monkeypatch.chdir(run.folder)
    before = sorted(run.folder.iterdir())
    assert main(["calibrate", "--dry-run", "--quiet"]) == 0
    stdout = capsys.readouterr().out
    assert "upper: inputs/sheet_upper.png, 512 x 480 px" in stdout
    assert "my-rig.json" in stdout
    assert main(["match", "--rig", "rig.json", "--dry-run", "--json", "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out)["would_write"] == ["my-matches.npz"]
    assert sorted(run.folder.iterdir()) == before


def test_a_folder_that_cannot_be_made_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, "off")
    (tmp_path / "file").write_text("")
    assert main(["demo", "--out", str(tmp_path / "file" / "out"), "--quiet"]) == 1
    assert "cannot be made a folder" in capsys.readouterr().err
