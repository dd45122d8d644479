"""`trinoc undistort`: pictures of a rig or of a lens, rectified or not, and what is refused."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

import trinoc
from tests.geometry.strategies import DISTORTED_LENS
from trinoc.cli.main import main
from trinoc.geometry.camera import Camera, depth_mm
from trinoc.image.ideal_pictures import PictureMaps
from trinoc.io.images import read_image
from trinoc.io.rig_json import load_rig_status, save_rig
from trinoc.synth import table1_rig

VIEWS = ("upper", "left", "right")
PICTURES = tuple(f"{view}={view}.png" for view in VIEWS)
RIG = ("--rig", "rig.json", "--quiet")
NAMES = tuple(f"{view}.{parameter}" for view in VIEWS for parameter in ("pan_deg", "distance_mm"))


def bent_rig(*more: str) -> trinoc.Rig:
    """The paper's cameras with distortion. `more` adds parameters to the covariance."""
    names = (*NAMES, *more)
    cameras = {n: Camera(DISTORTED_LENS, camera.pose) for n, camera in table1_rig().items()}
    return trinoc.Rig(cameras, parameters=names, covariance=1e-6 * np.eye(len(names)))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A rig, a lens, and pictures: of 8 and 16 bit, in colour and grey."""
    monkeypatch.chdir(tmp_path)
    status = {"cameras": {v: {"status": "suspect", "notes": ["It is."]} for v in ("left", "right")}}
    save_rig(bent_rig(), "rig.json", status=status)
    trinoc.save(DISTORTED_LENS, "camera.json")
    random = np.random.default_rng(4)
    for view, kind, channels in zip(
        VIEWS, (np.uint8, np.uint16, np.uint8), ((3,), (), ()), strict=True
    ):
        levels = random.integers(0, np.iinfo(kind).max, (480, 512, *channels)).astype(kind)
        cv2.imwrite(f"{view}.png", cv2.GaussianBlur(levels, (0, 0), 4))
    return tmp_path


def content(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_pictures_of_a_rig_keep_names_depth_and_colours(folder, capsys):
    before = content(folder)
    assert main(["undistort", *PICTURES, *RIG, "-o", "out/of/it", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert {path: data for path, data in content(folder).items() if path in before} == before
    out = Path("out/of/it")
    assert {path.name for path in out.iterdir()} == {
        *(f"{view}.png" for view in VIEWS), *(f"{view}-maps.npz" for view in VIEWS), "rig.json",
    }  # fmt: skip
    assert sorted(record["written"]) == sorted(map(str, out.iterdir()))
    rig, expected = trinoc.load_rig(out / "rig.json"), trinoc.undistort(bent_rig())
    for view in VIEWS:
        np.testing.assert_allclose(rig[view].matrix_px, expected.rig[view].matrix_px, rtol=1e-9)
        undistorted, distorted = read_image(out / f"{view}.png"), read_image(f"{view}.png")
        assert (undistorted.dtype, undistorted.shape) == (distorted.dtype, distorted.shape)
        np.testing.assert_array_equal(undistorted, expected.maps[view].resample(distorted))
        maps = np.load(out / f"{view}-maps.npz")
        by_hand = cv2.remap(
            *(distorted, maps["map_x"], maps["map_y"], cv2.INTER_CUBIC),
            borderMode=cv2.BORDER_REPLICATE,
        )
        np.testing.assert_array_equal(undistorted, by_hand)
        assert record["cameras"][view]["picture"] == str(out / f"{view}.png")
        np.testing.assert_allclose(record["cameras"][view]["matrix"], rig[view].intrinsics.matrix)
    assert rig.parameters == NAMES
    assert record["has_sigmas"]
    assert set(load_rig_status(out / "rig.json").doubts) == {"left", "right"}


def test_names_of_cameras_do_not_leave_the_folder(folder):
    names = ("../left", "a/b")
    cameras = {name: bent_rig().cameras[k] for k, name in enumerate(names)}
    trinoc.save(trinoc.Rig(cameras), "hostile.json")
    Path("x").mkdir()
    Path("x/upper.png").write_bytes(Path("left.png").read_bytes())
    before = content(folder)
    arguments = [
        "undistort",
        "../left=upper.png",
        "a/b=x/upper.png",
        "--rig",
        "hostile.json",
        "--quiet",
    ]
    assert main([*arguments, "-o", "out"]) == 0
    new = {path.relative_to(folder).as_posix() for path in content(folder).keys() - before.keys()}
    assert new == {
        *(f"out/{name}_upper.png" for name in ("%2E%2E%2Fleft", "a%2Fb")),
        *(f"out/{name}-maps.npz" for name in ("%2E%2E%2Fleft", "a%2Fb")),
        "out/rig.json",
    }
    assert trinoc.load_rig("out/rig.json").names == names


def test_maps_come_back_from_their_file(tmp_path):
    maps = trinoc.undistort(DISTORTED_LENS, image_size_px=(40, 30)).maps
    trinoc.save(maps, tmp_path / "maps.npz")
    loaded = trinoc.load(tmp_path / "maps.npz")
    assert isinstance(loaded, PictureMaps)
    assert loaded.size_px == maps.size_px
    np.testing.assert_array_equal(loaded.map_x, maps.map_x)
    np.testing.assert_array_equal(loaded.map_y, maps.map_y)
    for name, wrong in (
        ("map_x", maps.map_x[:3]),
        ("map_y", np.full((30, 40), np.float32(np.nan))),
    ):
        damaged = {**dict(np.load(tmp_path / "maps.npz")), name: wrong}
        np.savez(tmp_path / "damaged.npz", **damaged)
        with pytest.raises(trinoc.errors.InputError, match="holds no maps"):
            trinoc.load(tmp_path / "damaged.npz")
    with pytest.raises(trinoc.errors.InputError, match="maps are written"):
        trinoc.save(maps, tmp_path / "maps.npy")


def test_two_are_rectified_and_depth_is_said(folder, capsys):
    arguments = ["undistort", "left.png", "right.png", "--rectify", *RIG, "-o", "out"]
    assert main(arguments) == 0
    stdout = capsys.readouterr().out
    assert "Depth in mm is" in stdout
    assert "(u_left - u_right - (" in stdout
    assert main([*arguments, "--json", "--alpha", "1"]) == 0
    disparity = json.loads(capsys.readouterr().out)["disparity"]
    rig = trinoc.load_rig("out/rig.json")
    assert rig.names == ("left", "right")
    point = np.array([20.0, -10.0, 35.0])
    left, right = (camera.project(point) for camera in rig.cameras)
    assert left[1] == pytest.approx(right[1], abs=1e-9)
    depth = disparity["product_px_mm"] / (left[0] - right[0] - disparity["offset_px"])
    assert depth == pytest.approx(depth_mm(rig["left"], point))


def test_sigmas_that_do_not_hold_are_left_out_and_said(folder, capsys):
    trinoc.save(bent_rig("left.fx_px"), "open.json")
    arguments = ["undistort", *PICTURES[:2], "--rig", "open.json", "--quiet", "-o", "out"]
    assert main(arguments) == 0
    assert (
        "The new rig has no sigmas: open.json has errors of the lenses" in capsys.readouterr().out
    )
    assert trinoc.load_rig("out/rig.json").parameters == ()
    (note,) = json.loads(Path("out/rig.json").read_text())["provenance"]["notes"]
    assert "no sigmas" in note


def test_pictures_of_one_lens(folder, capsys):
    arguments = [
        "undistort",
        "left.png",
        "upper.png",
        "--lens",
        "camera.json",
        "--quiet",
        "-o",
        "out",
    ]
    assert main(arguments) == 0
    assert "100.0%" in capsys.readouterr().out
    names = {path.name for path in Path("out").iterdir()}
    assert names == {"left.png", "upper.png", "maps.npz", "camera.json"}
    lens, maps = trinoc.undistort(DISTORTED_LENS)
    np.testing.assert_allclose(trinoc.load("out/camera.json").matrix, lens.matrix)
    resampled = maps.resample(read_image("upper.png"))
    np.testing.assert_array_equal(read_image("out/upper.png"), resampled)


def test_pictures_of_equal_names_get_those_of_their_cameras(folder):
    for view in ("left", "right"):
        Path(view).mkdir()
        Path(f"{view}.png").rename(f"{view}/0001.png")
    arguments = ["undistort", "left=left/0001.png", "right=right/0001.png", *RIG, "-o", "out"]
    assert main(arguments) == 0
    assert {path.name for path in Path("out").glob("*.png")} == {"left_0001.png", "right_0001.png"}


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        ((*RIG,), 2, "No picture is given"),
        ((*PICTURES, *RIG, "--alpha", "1.5"), 2, "--alpha is 1.5"),
        ((*PICTURES, "--rig", "none.json"), 1, "none.json does not exist"),
        ((*PICTURES, "--rig", "sheet.json"), 2, "neither a rig nor a lens"),
        (("top=upper.png", *RIG), 1, 'no camera "top"'),
        (("upper=small.png", *RIG), 1, 'picture of "upper" is 60 x 40 px'),
        (("small.png", "--lens", "camera.json"), 1, "small.png is 60 x 40 px, but camera.json"),
        (("left.png", "--lens", "camera.json", "--rectify"), 2, "--rectify needs a rig"),
        ((*PICTURES, *RIG, "--rectify"), 1, "Rectification needs two cameras"),
        (("left.png", "./left.png", "--lens", "camera.json"), 2, "would both become"),
        (("left.png", "none.png", "--lens", "camera.json"), 1, "none.png does not exist"),
        (("left.png", "notes.txt", "--lens", "camera.json"), 1, "not a readable picture"),
        ((*PICTURES, *RIG, "-o", "."), 2, "is an input and would be overwritten"),
        ((*PICTURES, *RIG, "-o", ".", "--force"), 2, "is an input and would be overwritten"),
        (
            ("left.png", "--lens", "camera.json", "-o", "."),
            2,
            "is an input and would be overwritten",
        ),
        ((*PICTURES, *RIG, "-o", "notes.txt"), 2, "is not a folder"),
        ((*PICTURES, *RIG, "-o", "full"), 1, "full/left.png exists and would be overwritten"),
        (
            (*PICTURES, *RIG, "-o", "other"),
            1,
            "contains something else, which would be overwritten",
        ),
    ],
)
def test_what_cannot_be_is_one_sentence_and_writes_nothing(
    folder, arguments, status, message, capsys
):
    trinoc.save(trinoc.Pattern.cross_grid(rows=4, columns=4, pitch_mm=9, radius_mm=3), "sheet.json")
    cv2.imwrite("small.png", np.zeros((40, 60), np.uint8))
    Path("notes.txt").write_text("mine")
    for name in ("full/left.png", "other/left-maps.npz"):
        Path(name).parent.mkdir()
        Path(name).write_bytes(b"mine")
    before = content(folder)
    assert main(["undistort", *arguments, *([] if "-o" in arguments else ["-o", "out"])]) == status
    err = capsys.readouterr().err
    assert re.search(message, err)
    assert len([line for line in err.splitlines() if "SUSPECT" not in line]) == 1
    assert content(folder) == before


def test_results_of_before_are_replaced_and_others_by_force(folder, capsys):
    arguments = ["undistort", *PICTURES, *RIG, "-o", "out"]
    assert main(arguments) == 0
    first = Path("out/left.png").read_bytes()
    assert main([*arguments, "--alpha", "1"]) == 0
    assert Path("out/left.png").read_bytes() != first
    Path("full").mkdir()
    Path("full/left.png").write_bytes(b"mine")
    assert main([*arguments[:-1], "full"]) == 1
    assert main([*arguments[:-1], "full", "--force"]) == 0
    assert Path("full/left.png").read_bytes() == first
