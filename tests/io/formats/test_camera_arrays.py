"""Files of aniposelib, Caliscope, multical, MC-Calib and EasyMocap mean what those programs do."""

import json
import re
import tomllib

import cv2
import numpy as np
import pytest

from tests.io.formats.bench import bench_rig
from tests.io.formats.strategies import CORNERS, pixels
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.io import FORMATS

SAME = {"rtol": 0, "atol": 1e-9}
RIG = bench_rig(coefficients=4)
# Points around the axes of cameras at the origin, in their own frame.
NEAR = np.array([[10.0, -20, 500], [-60, 40, 700], [0, 0, 400]])


def fisheye_rig() -> Rig:
    lens = Intrinsics(
        image_size_px=(512, 480),
        focal_length_px=(410.0, 420.0),
        principal_point_px=(250.0, 245.0),
        distortion=(0.05, -0.01, 0.002, -0.0005),
        distortion_model="kannala_brandt",
    )
    return Rig({name: Camera(lens, camera.pose) for name, camera in RIG.items()})


def by_opencv(points, rotation_vector, translation, matrix, distortion, fisheye=False):
    rotation, _ = cv2.Rodrigues(np.asarray(rotation_vector, dtype=np.float64))
    points_cam = points @ rotation.T + np.ravel(translation)
    zeros, lens = np.zeros(3), (np.asarray(matrix), np.ravel(distortion))
    if fisheye:
        return cv2.fisheye.projectPoints(points_cam[None], zeros, zeros, *lens)[0].reshape(-1, 2)
    return cv2.projectPoints(points_cam, zeros, zeros, *lens)[0].reshape(-1, 2)


@pytest.mark.parametrize("rig", [RIG, fisheye_rig()], ids=["perspective", "fisheye"])
@pytest.mark.parametrize(("name", "unit_mm"), [("anipose", 1.0), ("caliscope", 1000.0)])
def test_tables_are_arguments_of_opencv(tmp_path, name, unit_mm, rig):
    FORMATS[name].save(rig, tmp_path / "rig.toml")
    document = tomllib.loads((tmp_path / "rig.toml").read_text())
    tables = document["cameras"].values() if name == "caliscope" else document.values()
    tables = [table for table in tables if "matrix" in table]
    assert len(tables) == 3
    for table, (camera_name, camera) in zip(tables, rig.items(), strict=True):
        assert table.get("name", camera_name) == camera_name
        assert tuple(table["size"]) == camera.image_size_px
        keys = ("rotation", "translation", "matrix", "distortions", "fisheye")
        images = by_opencv(CORNERS / unit_mm, *(table[key] for key in keys))
        np.testing.assert_allclose(images, pixels(camera), **SAME)


FREEMOCAP = """
[cam_0]
name = "Cam1"
size = [ 720, 1280,]
matrix = [ [ 912.7, 0.0, 359.5,], [ 0.0, 912.7, 639.5,], [ 0.0, 0.0, 1.0,],]
distortions = [ -0.13, 0.0, 0.0, 0.0, 0.0,]
rotation = [ 0.04, 0.02, 0.07,]
translation = [ 0.0, 0.0, 0.0,]
world_position = [0.0, 0.0, 0.0]
world_orientation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]

[cam_1]
name = "Cam2"
size = [ 720, 1280,]
matrix = [ [ 858.9, 0.0, 359.5,], [ 0.0, 858.9, 639.5,], [ 0.0, 0.0, 1.0,],]
distortions = [ 0.1, 0.0, 0.0, 0.0,]
rotation = [ 0.1, 0.2, 0.6,]
translation = [ -100.0, 30.0, 20.0,]
fisheye = true

[metadata]
charuco_square_size = 58.0
date_time_calibrated = 2025-03-11T14:19:33
"""


def test_freemocap_s_file_is_read(tmp_path):
    (tmp_path / "rig.toml").write_text(FREEMOCAP)
    rig = FORMATS["anipose"].load(tmp_path / "rig.toml")
    assert rig.names == ("Cam1", "Cam2")
    tables = tomllib.loads(FREEMOCAP)
    for table, camera in zip((tables["cam_0"], tables["cam_1"]), rig.cameras, strict=True):
        keys = ("rotation", "translation", "matrix", "distortions")
        images = by_opencv(NEAR, *(table[key] for key in keys), fisheye="fisheye" in table)
        np.testing.assert_allclose(pixels(camera, NEAR), images, **SAME)


def test_caliscope_s_earlier_files_are_read(tmp_path):
    """Such a file has counts of quarter turns, rotation matrices and unrelated tables."""
    FORMATS["caliscope"].save(RIG, tmp_path / "rig.toml")
    before = FORMATS["caliscope"].load(tmp_path / "rig.toml")
    text = (tmp_path / "rig.toml").read_text().replace("[cameras.", "[cam_")
    text = text.replace("rotation_count = 0", "rotation_count = -1\nignore = false")

    def matrix(line):
        rotation, _ = cv2.Rodrigues(np.array(json.loads(line[1])))
        return f"rotation = {rotation.tolist()}"

    text = re.sub(r"^rotation = (.*)$", matrix, text, flags=re.MULTILINE)
    others = '[charuco]\ncolumns = 4\n[stereo_0_1]\ntranslation = "null"\n'
    ignored = '[cam_7]\nsize = [4, 3]\nignore = true\nrotation = "null"\n'
    text = f"CreationDate = 2023-05-06T11:12:27\n{text}\n{others}{ignored}"
    (tmp_path / "rig.toml").write_text(text)
    loaded = FORMATS["caliscope"].load(tmp_path / "rig.toml")
    assert loaded.names == before.names == ("cam_0", "cam_1", "cam_2")
    for camera, other in zip(loaded.cameras, before.cameras, strict=True):
        np.testing.assert_allclose(pixels(camera), pixels(other), rtol=0, atol=1e-8)


def test_multical_s_relative_poses_lead_from_the_first_camera(tmp_path):
    """NAME_to_FIRST holds x_NAME = R x_FIRST + T, whatever its name says."""
    FORMATS["multical"].save(RIG, tmp_path / "calibration.json")
    document = json.loads((tmp_path / "calibration.json").read_text())
    for name, camera in RIG.items():
        entry, pose = document["cameras"][name], document["camera_poses"][name]
        vector, _ = cv2.Rodrigues(np.array(pose["R"]))
        images = by_opencv(CORNERS / 1000, vector, pose["T"], entry["K"], entry["dist"])
        np.testing.assert_allclose(images, pixels(camera), rtol=0, atol=1e-8)
    first = RIG.names[0]
    document["camera_poses"] = {
        name if name == first else f"{name}_to_{first}": pose
        for name, pose in document["camera_poses"].items()
    }
    (tmp_path / "calibration.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=f'must contain the identity as the pose of "{first}"'):
        FORMATS["multical"].load(tmp_path / "calibration.json")
    document["camera_poses"][first] = {"R": np.eye(3).tolist(), "T": [0, 0, 0]}
    (tmp_path / "calibration.json").write_text(json.dumps(document))
    loaded = FORMATS["multical"].load(tmp_path / "calibration.json")
    assert loaded.names == RIG.names
    for name, camera in list(RIG.items())[1:]:
        np.testing.assert_allclose(loaded[name].cam_from_world, camera.cam_from_world, atol=1e-9)


def test_a_column_of_four_is_multical_s_fisheye(tmp_path):
    FORMATS["multical"].save(RIG, tmp_path / "calibration.json")
    document = json.loads((tmp_path / "calibration.json").read_text())
    for name, dist in (("upper", [[0.1], [0.0], [0.0], [0.0]]), ("left", [0.1, 0.0, 0.0, 0.0])):
        document["cameras"][name]["dist"] = dist
    (tmp_path / "calibration.json").write_text(json.dumps(document))
    loaded = FORMATS["multical"].load(tmp_path / "calibration.json")
    models = [loaded[name].intrinsics.lens.model for name in ("upper", "left")]
    assert models == ["kannala_brandt", "brown_conrady"]
    with pytest.raises(InputError, match="kannala_brandt, which multical"):
        FORMATS["multical"].save(fisheye_rig(), tmp_path / "again.json")


@pytest.mark.parametrize("rig", [RIG, fisheye_rig()], ids=["perspective", "fisheye"])
def test_mc_calib_s_pose_is_of_the_camera_in_its_group(tmp_path, rig):
    FORMATS["mc-calib"].save(rig, tmp_path / "cameras.yml")
    storage = cv2.FileStorage(str(tmp_path / "cameras.yml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("nb_camera").real() == 3
    for number, camera in enumerate(rig.cameras):
        node = storage.getNode(f"camera_{number}")
        pose = np.linalg.inv(node.getNode("camera_pose_matrix").mat())
        vector, _ = cv2.Rodrigues(pose[:3, :3])
        lens = [node.getNode(key).mat() for key in ("camera_matrix", "distortion_vector")]
        fisheye = bool(node.getNode("distortion_type").real())
        images = by_opencv(CORNERS, vector, pose[:3, 3], *lens, fisheye=fisheye)
        np.testing.assert_allclose(images, pixels(camera), rtol=0, atol=1e-8)


def test_a_group_of_mc_calib_that_lacks_cameras_is_named(tmp_path):
    FORMATS["mc-calib"].save(RIG, tmp_path / "cameras.yml")
    text = (tmp_path / "cameras.yml").read_text()
    # Early versions wrote no 1 at the end of the matrix.
    (tmp_path / "cameras.yml").write_text(
        text.replace("0.0, 0.0, 1.0]\n   distortion", "0, 0, 0.0]\n   distortion")
    )
    assert len(FORMATS["mc-calib"].load(tmp_path / "cameras.yml")) == 3
    (tmp_path / "cameras.yml").write_text(text.replace("nb_camera: 3", "nb_camera: 4"))
    with pytest.raises(InputError, match="is 4, but the file has camera_0, camera_1, camera_2"):
        FORMATS["mc-calib"].load(tmp_path / "cameras.yml")


def test_easymocap_s_two_files_are_arguments_of_opencv(tmp_path):
    FORMATS["easymocap"].save(RIG, tmp_path / "rig")
    files = [cv2.FileStorage(str(tmp_path / "rig" / name), cv2.FILE_STORAGE_READ)
             for name in ("extri.yml", "intri.yml")]  # fmt: skip
    names = files[0].getNode("names")
    assert [names.at(k).string() for k in range(names.size())] == list(RIG.names)
    for name, camera in RIG.items():
        pose = [files[0].getNode(f"{key}_{name}").mat() for key in "RT"]
        lens = [files[1].getNode(f"{key}_{name}").mat() for key in ("K", "dist")]
        images = by_opencv(CORNERS / 1000, pose[0], pose[1], lens[0], lens[1])
        np.testing.assert_allclose(images, pixels(camera), **SAME)
        assert files[1].getNode(f"H_{name}").real() == camera.image_size_px[1]


def spoil(path, old, new):
    text = path.read_text()
    assert re.search(old, text)
    path.write_text(re.sub(old, new, text, count=1))


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("intri.yml", "W_upper: 512\n", "", "has no W_upper: add H_upper and W_upper"),
        ("extri.yml", r'- "upper"|"upper", ', "", 'does not name "upper"'),
        ("extri.yml", r"(Rot_upper: .*\n.*\n.*\n.*\n   data: \[)[^,]*", r"\g<1>0.123", "Rot"),
        ("extri.yml", "R_upper", "Q_upper", '"upper.R" must be'),
    ],
)
def test_what_easymocap_s_files_lack_is_named(file, old, new, message, tmp_path):
    FORMATS["easymocap"].save(RIG, tmp_path / "rig")
    spoil(tmp_path / "rig" / file, old, new)
    with pytest.raises(InputError, match=message):
        FORMATS["easymocap"].load(tmp_path / "rig")


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("anipose", r"\[cam_0\]", "[cameras.0]", "import the file with the format caliscope"),
        ("anipose", "name = .*", 'name = "right"', "the name of an earlier camera"),
        ("anipose", "rotation = .*", 'rotation = "null"', "calibrate all cameras together"),
        ("anipose", "rotation = .*", "rotation = [0.0, 1.0]", "axis times angle"),
        ("anipose", "size = .*", "size = [1979-05-27]", "size"),
        ("anipose", "size = .*", "", "size"),
        ("anipose", "matrix = .*", "matrix = [[9.0, 1.0, 5.0], [0.0, 9.0, 5.0], [0.0, 0.0, 1.0]]",
         "must be fx 0 cx"),
        ("caliscope", r"\[cameras.0\]", "[cameras.0", "is not TOML"),
        ("caliscope", r"\[cameras.0\]", f"[{'a.' * 20_000}a]", "nested more than 64 deep"),
        ("multical", '"standard"', '"fix_k1"', "trinoc reads standard, rational"),
        ("multical", '"camera_poses"', '"poses"', "is missing, as in intrinsic.json"),
    ],
)  # fmt: skip
def test_what_a_file_lacks_is_named(name, old, new, message, tmp_path):
    path = tmp_path / f"rig{FORMATS[name].endings[0]}"
    FORMATS[name].save(RIG, path)
    spoil(path, old, new)
    with pytest.raises(InputError, match=message) as caught:
        FORMATS[name].load(path)
    assert str(path) in str(caught.value)
