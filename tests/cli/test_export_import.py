"""`trinoc export`: files out and in, what is said, and what is refused."""

import json
from typing import get_args

import numpy as np
import pytest

import trinoc
from tests.io.formats.bench import bench_matches, bench_rig
from trinoc.cli.export import ReadFormat, WrittenFormat
from trinoc.cli.main import main
from trinoc.io import FORMATS, load_intrinsics
from trinoc.io.formats.format import NAMES
from trinoc.io.intrinsics_json import save_intrinsics

RIG = bench_rig(coefficients=4)


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs a command in a folder with files of each kind: (status, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    trinoc.save(RIG, "rig.json")
    trinoc.save(RIG["upper"].intrinsics, "camera.json")
    trinoc.save(bench_matches(), "matches.npz")
    trinoc.save(trinoc.Segments.from_endpoints(np.array([[1.0, 2, 3, 4]])), "segments.npz")

    def run_one(*arguments):
        status = main(list(arguments))
        return status, *capsys.readouterr()

    return run_one


def test_the_formats_on_offer_are_those_of_the_registry():
    assert get_args(WrittenFormat) == tuple(name for name, each in FORMATS.items() if each.holds)
    assert get_args(ReadFormat) == tuple(name for name, each in FORMATS.items() if each.reads)


@pytest.mark.parametrize("name", [n for n in FORMATS if "rig" in FORMATS[n].holds])
def test_a_rig_leaves_and_comes_back(run, name):
    form = FORMATS[name]
    out = "out" if "folder" in form.place else f"out{form.endings[0]}"
    status, stdout, warned = run("export", "rig.json", "--to", name, "-o", out)
    assert status == 0
    assert f"written: {out}" in stdout
    assert warned.count("\n") == 1
    assert "loses: " in warned
    keeps = name in ("opencv", "matlab")
    assert ("the covariance" in warned) != keeps
    more = ["--names", "upper,right,left"] if NAMES in form.loses else []
    lenses = ["--lens", "rig.json"] if name == "tf" else []
    status, stdout, warned = run("export", out, "--from", name, "-o", "back.json", *more, *lenses)
    assert (status, warned) == (0, "")
    assert f"3 cameras, {'with' if keeps else 'without'} covariance: " in stdout
    loaded = trinoc.load_rig("back.json")
    assert set(loaded.names) == set(RIG.names)
    assert loaded.parameters == (RIG.parameters if keeps else ())
    for camera_name, camera in RIG.items():
        np.testing.assert_allclose(
            loaded[camera_name].intrinsics.matrix, camera.intrinsics.matrix, rtol=0, atol=1e-9
        )
    with open("back.json", encoding="utf-8") as file:
        provenance = json.load(file)["provenance"]
    assert provenance["command"].startswith("trinoc export ")
    assert provenance["inputs"]


def test_poses_take_their_lenses_from_camera_files(run):
    assert run("export", "rig.json", "--to", "tf", "-o", "tf.json", "--quiet")[0] == 0
    lenses = [word for name in RIG for word in ("--lens", f"{name}=camera.json")]
    assert run("export", "tf.json", "--from", "tf", "-o", "back.json", *lenses)[0] == 0
    loaded = trinoc.load_rig("back.json")
    for camera_name, camera in RIG.items():
        np.testing.assert_allclose(
            loaded[camera_name].cam_from_world, camera.cam_from_world, atol=1e-9
        )


def test_a_lens_leaves_and_comes_back(run):
    assert run("export", "camera.json", "--to", "ros", "-o", "upper.yaml")[0] == 0
    status, stdout, _ = run("export", "upper.yaml", "--from", "ros", "-o", "back.json")
    assert status == 0
    assert "a lens, without covariance" in stdout
    loaded = load_intrinsics("back.json")
    np.testing.assert_array_equal(loaded.distortion, RIG["upper"].intrinsics.distortion)


def test_a_lens_that_folds_in_the_corners_is_warned_of_where_it_is_read(run):
    lens = trinoc.Intrinsics(
        image_size_px=(1280, 720), focal_length_px=900.0, distortion=(-0.25, 0.0, 0.0005, -0.001)
    )
    trinoc.save(lens, "folds.json")
    rig = trinoc.Rig({name: trinoc.Camera(lens, camera.pose) for name, camera in RIG.items()})
    trinoc.save(rig, "rig.json", overwrite=True)
    assert run("export", "folds.json", "--to", "opencv", "-o", "folds.yml")[0] == 0
    status, _, warned = run("export", "folds.yml", "--from", "opencv", "-o", "back.json")
    assert status == 0
    assert warned == (
        "trinoc: folds.yml: The distortion of the lens folds the image 686 px from the "
        "principal point (two rays have one pixel there, and the farthest corner is 734 px away); "
        "lines and points beyond this radius, in 1.4 % of the image, are not used.\n"
    )
    np.savetxt("ends.csv", [[1.0, 2, 3, 4]], delimiter=",")
    files = [f"{name}=ends.csv" for name in rig]
    status, _, warned = run("match", *files, "--rig", "rig.json", "--dry-run")
    assert status == 0
    assert warned.count("folds the image 686 px") == len(rig)
    assert 'rig.json: The distortion of "upper" folds' in warned


def test_the_covariance_of_a_lens_is_said_to_be_lost(run):
    save_intrinsics(RIG["upper"].intrinsics, "known.json", covariance=np.eye(9))
    for file, lost in (("known.json", True), ("camera.json", False)):
        _, _, warned = run("export", file, "--to", "opencv", "-o", "lens.yml")
        assert ("the covariance" in warned) == lost


@pytest.mark.parametrize("name", [n for n in FORMATS if "matches" in FORMATS[n].holds])
def test_matches_leave(run, name):
    if name == "parquet":
        pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    out = f"out{(FORMATS[name].endings or ('',))[0]}"
    status, stdout, warned = run("export", "matches.npz", "--to", name, "-o", out, "--json")
    assert status == 0
    record = json.loads(stdout)
    assert record["format"] == name
    assert record["written"] == [out]
    assert bool(record["lost"]) == bool(warned)


def test_segments_leave_and_come_back(run):
    assert run("export", "segments.npz", "--to", "elsed", "-o", "segments.txt")[0] == 0
    status, stdout, _ = run("export", "segments.txt", "--from", "elsed", "-o", "back.npz", "--json")
    assert status == 0
    assert json.loads(stdout)["segments"] == 1
    np.testing.assert_array_equal(
        trinoc.load_segments("back.npz").endpoints_px, [[[1.0, 2], [3, 4]]]
    )


def test_units_are_the_user_s(run):
    out = ("--to", "opencv", "-o", "metres.yml", "--unit-mm", "1000")
    assert run("export", "rig.json", *out)[0] == 0
    import_arguments = ("--from", "opencv", "-o", "back.json")
    assert run("export", "metres.yml", *import_arguments)[0] == 0
    small = np.linalg.norm(trinoc.load_rig("back.json")["upper"].centre_world_mm)
    assert small == pytest.approx(0.476369)
    assert run("export", "metres.yml", *import_arguments, "--unit-mm", "1000")[0] == 0
    full = np.linalg.norm(trinoc.load_rig("back.json")["upper"].centre_world_mm)
    assert full == pytest.approx(476.369)


WRONG_USAGE = {
    "no format": ("export", "rig.json", "-o", "x"),
    "an unknown format": ("export", "rig.json", "--to", "blender", "-o", "x"),
    "no place": ("export", "rig.json", "--to", "opencv"),
    "only written": ("export", "x.ply", "--from", "ply", "-o", "x"),
    "a lens without a name": (
        *("export", "x.json", "--from", "tf", "-o", "y.json"),
        *("--lens", "=camera.json"),
    ),
}
REFUSED = {
    "no such file": (("export", "no.json", "--to", "opencv", "-o", "x.yml"), "does not exist"),
    "no such npz": (("export", "no.npz", "--to", "csv", "-o", "x.csv"), "does not exist"),
    "a pattern": (("export", "other.json", "--to", "opencv", "-o", "x.yml"), "has version missing"),
    "a picture": (("export", "other.png", "--to", "csv", "-o", "x.csv"), "is no value"),
    "matches as cameras": (
        ("export", "matches.npz", "--to", "kalibr", "-o", "x.yaml"),
        "can contain a rig, not matches",
    ),
    "a lens as a rig": (
        ("export", "camera.json", "--to", "colmap", "-o", "x"),
        "can contain a rig, not a lens",
    ),
    "no folder": (("export", "rig.json", "--to", "colmap", "-o", "a/b"), "does not exist"),
    "no file to read": (("export", "no.yml", "--from", "opencv", "-o", "x.json"), "not exist"),
    "no lenses": (("export", "other.json", "--from", "tf", "-o", "x.json"), "--lens rig.json"),
    "an ending": (("export", "tf.json", "--from", "tf", "-o", "x.npz", "--lens", "rig.json"),
                  "is written as .json"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG_USAGE | REFUSED)
def test_what_is_refused(run, tmp_path, case):
    (tmp_path / "other.json").write_text('{"format": "trinoc-pattern"}')
    (tmp_path / "other.png").write_text("no picture")
    run("export", "rig.json", "--to", "tf", "-o", "tf.json")
    before = sorted(tmp_path.iterdir())
    arguments, message = REFUSED.get(case, (WRONG_USAGE.get(case), ""))
    status, out, err = run(*arguments)
    assert status == (2 if case in WRONG_USAGE else 1)
    assert out == ""
    assert message in err
    assert sorted(tmp_path.iterdir()) == before
    if case in REFUSED:
        assert err.count("\n") == 1
