"""The output streams of the command and its exit codes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import trinoc
from tests.io.formats.bench import bench_matches
from trinoc.cli.main import main

HEAVY = "jax numpy cv2 equinox optimistix jinja2 skimage scipy matplotlib"
MATCHER = "trinoc.match.matcher trinoc.segments.find trinoc.evaluation.lines_of_rig"
CALIBRATIONS = "trinoc.calib.problem trinoc.calib.photometric optimistix lineax"
# Of SciPy what takes a tenth of a second, and is used by few functions.
SCIPY = "scipy.special scipy.spatial scipy.linalg scipy.sparse scipy.io"
PAGES = "trinoc.report.html jinja2 skimage matplotlib"
RUN = "from trinoc.cli.main import main; main({})"
# What a command needs before its work, and what it must not import, by name.
IMPORTS = {
    "import trinoc": HEAVY,
    "from trinoc.cli.main import main": HEAVY,
    RUN.format(["--help"]): HEAVY,
    RUN.format(["match", "--help"]): HEAVY,
    "import trinoc; trinoc.load_rig, trinoc.save": f"{MATCHER} {CALIBRATIONS} {SCIPY} {PAGES}",
    "import trinoc; trinoc.calibrate, trinoc.save, trinoc.Systematics, trinoc.io.read_views": (
        f"{MATCHER} {SCIPY} {PAGES}"
    ),
    "import trinoc, trinoc.report.text; trinoc.match_segments, trinoc.find_segments, trinoc.save; "
    "trinoc.match.improve, trinoc.with_rig_covariance": (
        f"{CALIBRATIONS} {PAGES} trinoc.match.pixels.measure trinoc.match.rims.rim_search "
        "trinoc.match.wire_frame.build"
    ),
}


@pytest.mark.parametrize("statement", IMPORTS)
def test_nothing_is_imported_that_is_not_used(statement, tmp_path):
    assert imported(statement, IMPORTS[statement], tmp_path) == set()


def test_an_export_imports_no_calibration_matcher_or_page(tmp_path):
    trinoc.save(bench_matches(), tmp_path / "m.npz")
    run = RUN.format(["export", "m.npz", "--to", "ply", "-o", "m.ply"])
    names = f"{MATCHER} {CALIBRATIONS} {SCIPY} {PAGES}"
    assert imported(run, names, tmp_path) == set()
    assert (tmp_path / "m.ply").exists()


def imported(statement: str, names: str, folder: Path) -> set[str]:
    """The modules, of those listed, that a new process has imported after a statement."""
    script = f"import sys; {statement}; print(); print(*set('{names}'.split()) & set(sys.modules))"
    process = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(Path(trinoc.__file__).parents[1])},
    )
    return set(process.stdout.split("\n")[-2].split())


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == f"trinoc {trinoc.__version__}"


def test_the_module_is_the_command():
    run = [sys.executable, "-m", "trinoc", "--version"]
    process = subprocess.run(run, capture_output=True, text=True, check=True)
    assert process.stdout.startswith(f"trinoc {trinoc.__version__}\n")


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_shell_is_told_the_commands(shell, capsys):
    assert main(["--tyro-print-completion", shell]) == 0
    script = capsys.readouterr().out
    for word in ("calibrate", "match", "export"):
        assert word in script


def test_help_goes_to_stdout(capsys):
    assert main(["--help"]) == 0
    out, err = capsys.readouterr()
    assert "usage: trinoc" in out
    assert err == ""


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["unknown"],
        ["segments"],
        ["segments", "a.png", "--unknown"],
        ["calibrate", "upper=a.png"],
        ["calibrate", "a/upper.png", "a/upper.png", "--pattern", "p.json"],
        ["calibrate", "--pattern", "p.json"],
        ["match", "upper=a.png", "upper=b.png", "--rig", "rig.json"],
    ],
)
def test_wrong_usage_ends_with_2_and_prints_no_result(arguments, capsys):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err != ""


@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_failure_ends_with_1_and_one_sentence(flags, tmp_path, capsys):
    assert main(["segments", str(tmp_path / "none.png"), *flags]) == 1
    out, err = capsys.readouterr()
    sentence = f"{tmp_path / 'none.png'} does not exist: check the name."
    assert err == f"trinoc: {sentence}\n"
    assert out == "" if not flags else json.loads(out) == {"error": sentence}


def test_result_that_cannot_be_written_is_a_sentence(tmp_path, capsys):
    rig, out = tmp_path / "rig.json", tmp_path / "none" / "matches.npz"
    camera = trinoc.Camera.from_degrees(
        trinoc.Intrinsics(focal_length_px=1000.0, image_size_px=(512, 480)),
        pan_deg=0,
        tilt_deg=50,
        swing_deg=0,
        distance_mm=500,
    )
    trinoc.save(trinoc.Rig({"a": camera}), rig)
    assert main(["match", "a=a.png", "--rig", str(rig), "-o", str(out)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
