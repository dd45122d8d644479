"""Readers accept the variants that other tools write: one camera, described in several ways."""

import json
import re

import cv2
import numpy as np
import pytest
import scipy.io

from tests.io.formats.bench import bench_rig
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.rig import Rig
from trinoc.io import FORMATS
from trinoc.io.formats.motions import chain_motions, inverse
from trinoc.io.formats.text_files import yaml_text

RIG = bench_rig(coefficients=4)
PAIR = bench_rig(coefficients=4, cameras=2)
LENSES = {name: camera.intrinsics for name, camera in RIG.items()}
SAME = {"rtol": 0, "atol": 1e-9}


def pose_of(camera: Camera) -> np.ndarray:
    return np.asarray(camera.cam_from_world)


def expect_same_rig(rig: Rig, wanted: Rig) -> None:
    """Assert equal lenses, and equal poses relative to the first camera."""
    for ours, theirs in zip(rig.cameras, wanted.cameras, strict=True):
        np.testing.assert_allclose(
            ours.intrinsics.lens.parameters, theirs.intrinsics.lens.parameters, **SAME
        )
        steps = [
            chain_motions(pose_of(camera), inverse(pose_of(rig.cameras[0])))
            for camera, rig in ((ours, rig), (theirs, wanted))
        ]
        np.testing.assert_allclose(*steps, rtol=0, atol=1e-9)


def yaml_values(path):
    ruamel = pytest.importorskip("ruamel.yaml", reason="ruamel.yaml is not installed")
    return ruamel.YAML(typ="safe", pure=True).load(path.read_text())


def matrix_block(matrix):
    rows, columns = matrix.shape
    return {"rows": rows, "cols": columns, "data": matrix.ravel().tolist()}


def test_a_stereo_pair_of_ros_has_its_poses_in_r_and_p(tmp_path):
    """camera_calibration writes left.yaml and right.yaml after cv2.stereoRectify, and no poses."""
    FORMATS["ros"].save(PAIR, tmp_path / "rig")
    (tmp_path / "rig" / "tf_static.yaml").unlink()
    first, second = PAIR.cameras
    step = chain_motions(pose_of(second), inverse(pose_of(first)))
    k1, d1, k2, d2 = (
        np.asarray(array)
        for camera in PAIR.cameras
        for array in (camera.intrinsics.matrix, camera.intrinsics.distortion)
    )
    size = first.image_size_px
    rotation, shift = step[:, :3].copy(), step[:, 3:] / 1000
    r1, r2, p1, p2, *_ = cv2.stereoRectify(k1, d1, k2, d2, size, rotation, shift)
    for name, turn, projection in zip(PAIR.names, (r1, r2), (p1, p2), strict=True):
        file = tmp_path / "rig" / f"{name}.yaml"
        values = yaml_values(file)
        values["rectification_matrix"] = matrix_block(turn)
        values["projection_matrix"] = matrix_block(projection)
        file.write_text(yaml_text(values))
    # Files are read in the order of their names.
    rig = FORMATS["ros"].load(tmp_path / "rig")
    assert set(rig.names) == set(PAIR.names)
    expect_same_rig(Rig({name: rig[name] for name in PAIR.names}), PAIR)


def test_cameras_without_poses_are_no_rig(tmp_path):
    FORMATS["ros"].save(PAIR, tmp_path / "rig")
    (tmp_path / "rig" / "tf_static.yaml").unlink()
    with pytest.raises(InputError, match="no R and P of a stereo pair: add the poses"):
        FORMATS["ros"].load(tmp_path / "rig")


MESSAGE = """header:
  stamp: {{sec: {stamp}, nanosec: 2}}
  frame_id: cam
height: 960
width: 1280
distortion_model: plumb_bob
d: [-0.1, 0.02, 0.0, 0.0, 0.0]
k: [{focal}, 0.0, 640.0, 0.0, 1202.0, 480.0, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [1200.0, 0.0, 640.0, 0.0, 0.0, 1202.0, 480.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: {binning}
binning_y: {binning}
roi:
  x_offset: 0
  y_offset: 0
  height: {roi}
  width: 0
  do_rectify: {rectified}
"""
FIELDS = {"stamp": 1, "focal": 1200.0, "binning": 0, "roi": 0, "rectified": "false"}


def read_messages(folder, *changes):
    pytest.importorskip("ruamel.yaml", reason="ruamel.yaml is not installed")
    file = folder / "echo.yaml"
    file.write_text("".join(MESSAGE.format(**(FIELDS | change)) + "---\n" for change in changes))
    return FORMATS["ros"].load(file)


def test_messages_as_ros2_topic_echo_prints_them(tmp_path):
    lens = read_messages(tmp_path, {}, {"stamp": 2})
    np.testing.assert_allclose(lens.focal_length_px, (1200, 1202))
    np.testing.assert_allclose(lens.distortion[:2], (-0.1, 0.02))
    with pytest.raises(InputError, match="document 2 differs from the first"):
        read_messages(tmp_path, {}, {"focal": 1300.0})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"binning": 2}, '"binning_x" is 2'),
        ({"roi": 480}, '"roi" is a part of the picture'),
        ({"rectified": "true"}, '"roi.do_rectify" is true'),
    ],
)
def test_messages_of_other_pictures_than_the_lens_is_of(change, message, tmp_path):
    with pytest.raises(InputError, match=re.escape(message)):
        read_messages(tmp_path, change)


def test_a_camera_that_is_not_calibrated_has_no_lens(tmp_path):
    pytest.importorskip("ruamel.yaml", reason="ruamel.yaml is not installed")
    text = MESSAGE.format(**FIELDS)
    file = tmp_path / "zeros.yaml"
    file.write_text(re.sub(r"k: \[.*\]", f"k: {[0.0] * 9}", text))
    with pytest.raises(InputError, match="a camera matrix of zeros"):
        FORMATS["ros"].load(file)


def write_chain(path, change):
    """Kalibr's file of the rig after a change of its values."""
    FORMATS["kalibr"].save(RIG, path)
    values = yaml_values(path)
    change(values)
    path.write_text("%YAML:1.0\n---\n" + yaml_text(values))


def hang_on_imu(values, *, keep_chain):
    """Each camera's pose from an inertial unit, which stands anywhere."""
    cam_from_imu = np.array([[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, 0.3], [0, 0, 0, 1.0]])
    for entry in values.values():
        step = np.array(entry.get("T_cn_cnm1", np.eye(4)))
        cam_from_imu = step @ cam_from_imu
        entry["T_cam_imu"] = cam_from_imu.tolist()
        if not keep_chain:
            entry.pop("T_cn_cnm1", None)


@pytest.mark.parametrize("keep_chain", [True, False])
def test_kalibr_s_cameras_hang_on_an_inertial_unit(keep_chain, tmp_path):
    path = tmp_path / "camchain-imucam.yaml"
    write_chain(path, lambda values: hang_on_imu(values, keep_chain=keep_chain))
    expect_same_rig(FORMATS["kalibr"].load(path), RIG)


def test_two_poses_of_one_camera_must_agree(tmp_path):
    def move(values):
        hang_on_imu(values, keep_chain=True)
        values["cam1"]["T_cam_imu"][0][3] += 0.01

    write_chain(tmp_path / "chain.yaml", move)
    with pytest.raises(InputError, match=r'"cam1.T_cam_imu" contradicts T_cn_cnm1'):
        FORMATS["kalibr"].load(tmp_path / "chain.yaml")


def test_colmap_s_images_may_lack_their_line_of_points(tmp_path):
    FORMATS["colmap-text"].save(RIG, tmp_path / "model")
    file = tmp_path / "model" / "images.txt"
    lines = [line for line in file.read_text().splitlines() if line]
    file.write_text("\n".join(lines) + "\n")
    assert FORMATS["colmap-text"].load(tmp_path / "model") == FORMATS["colmap-text"].load(
        write_points(tmp_path / "points")
    )


def write_points(folder):
    """A model with points below one image and none below the others."""
    FORMATS["colmap-text"].save(RIG, folder)
    text = (folder / "images.txt").read_text()
    (folder / "images.txt").write_text(text.replace("\n\n", "\n1.5 2.5 -1 3.0 4.0 7\n", 1))
    return folder


@pytest.mark.parametrize(
    ("unit", "mm"), [("mm", 1.0), ("cm", 10.0), ("Meters", 1000.0), ("in", 25.4), ("", 1.0)]
)
def test_matlab_states_its_unit(unit, mm, tmp_path):
    FORMATS["matlab"].save(PAIR, tmp_path / "mm.mat")
    before = FORMATS["matlab"].load(tmp_path / "mm.mat")
    write_matlab_unit(tmp_path, unit)
    after = FORMATS["matlab"].load(tmp_path / "changed.mat")
    for one, other in zip(before.cameras, after.cameras, strict=True):
        np.testing.assert_allclose(pose_of(other)[:, 3], mm * pose_of(one)[:, 3], atol=1e-8)


def write_matlab_unit(folder, unit):
    FORMATS["matlab"].save(PAIR, folder / "written.mat")
    values = {
        key: value
        for key, value in scipy.io.loadmat(folder / "written.mat").items()
        if key[:2] != "__"
    }
    for camera in ("CameraParameters1", "CameraParameters2"):
        values["stereoParams"][0, 0][camera][0, 0]["WorldUnits"] = np.array([unit])
    scipy.io.savemat(folder / "changed.mat", values)


def test_a_unit_that_is_unknown_or_contradicted_is_refused(tmp_path):
    write_matlab_unit(tmp_path, "ells")
    with pytest.raises(InputError, match='"ells": give the length of this unit'):
        FORMATS["matlab"].load(tmp_path / "changed.mat")
    FORMATS["matlab"].load(tmp_path / "changed.mat", unit_mm=685.8)
    write_matlab_unit(tmp_path, "m")
    with pytest.raises(InputError, match="omit --unit-mm"):
        FORMATS["matlab"].load(tmp_path / "changed.mat", unit_mm=10.0)


@pytest.mark.parametrize("unit_mm", [1.0, 25.4, 1000.0, 7.0])
def test_matlab_s_file_says_the_unit_that_it_was_written_in(unit_mm, tmp_path):
    FORMATS["matlab"].save(PAIR, tmp_path / "rig.mat", unit_mm=unit_mm)
    expect_same_rig(FORMATS["matlab"].load(tmp_path / "rig.mat"), PAIR)


def test_the_optical_frame_is_the_camera(tmp_path):
    """By REP 103 the frame of the name alone looks along x."""
    file = tmp_path / "tf.json"
    FORMATS["tf"].save(RIG, file)
    document = json.loads(file.read_text())
    name = RIG.names[0]
    body = {
        "header": {"frame_id": "world"},
        "child_frame_id": name,
        "transform": {
            "translation": {"x": 9.0, "y": 0.0, "z": 0.0},
            "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        },
    }
    document["transforms"].insert(0, body)
    file.write_text(json.dumps(document))
    expect_same_rig(FORMATS["tf"].load(file, lenses=LENSES), RIG)
    document["transforms"] = [
        entry
        for entry in document["transforms"]
        if entry["child_frame_id"] != f"{name}_optical_frame"
    ]
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=f'"{name}", but no {name}_optical_frame: by REP 103'):
        FORMATS["tf"].load(file, lenses=LENSES)


def test_messages_of_several_publishers_are_joined(tmp_path):
    pytest.importorskip("ruamel.yaml", reason="ruamel.yaml is not installed")
    file = tmp_path / "tf.yaml"
    FORMATS["tf"].save(RIG, file)
    entries = yaml_values(file)["transforms"]
    file.write_text("".join(yaml_text({"transforms": [entry]}) + "---\n" for entry in entries * 2))
    expect_same_rig(FORMATS["tf"].load(file, lenses=LENSES), RIG)
    entries[1]["transform"]["translation"]["x"] += 1.0
    file.write_text(file.read_text() + yaml_text({"transforms": [entries[1]]}))
    with pytest.raises(InputError, match="the child frame of an earlier"):
        FORMATS["tf"].load(file, lenses=LENSES)


def nerf_document(**values):
    frames = [
        {"file_path": f"images/{name}.png", "transform_matrix": matrix.tolist()}
        for name, matrix in zip("ab", moved_matrices(), strict=True)
    ]
    return {"w": 1280, "h": 720, "frames": frames, **values}


def moved_matrices():
    matrix = np.eye(4)
    aside = np.eye(4)
    aside[0, 3] = 0.5
    return matrix, aside


def read_nerf(folder, **values):
    file = folder / "transforms.json"
    file.write_text(json.dumps(nerf_document(**values)))
    return FORMATS["nerfstudio"].load(file, unit_mm=1000)


FOCAL = {"fl_x": 900.0, "fl_y": 900.0, "cx": 640.0, "cy": 360.0}
BENT = {"k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002}


@pytest.mark.parametrize("model", ["PINHOLE", "SIMPLE_RADIAL", "RADIAL", None])
def test_nerfstudio_bends_rays_whatever_the_perspective_model_is_called(model, tmp_path):
    named = {} if model is None else {"camera_model": model}
    wanted = read_nerf(tmp_path, camera_model="OPENCV", **FOCAL, **BENT)
    assert read_nerf(tmp_path, **named, **FOCAL, **BENT) == wanted
    as_list = [*(BENT[key] for key in ("k1", "k2")), 0.0, 0.0, BENT["p1"], BENT["p2"]]
    assert read_nerf(tmp_path, **named, **FOCAL, distortion_params=as_list) == wanted


def test_instant_ngp_says_the_focal_length_by_an_angle(tmp_path):
    angle = 2 * np.arctan(640 / 900)
    by_angle = read_nerf(tmp_path, camera_angle_x=angle)
    by_length = read_nerf(tmp_path, **FOCAL)
    for one, other in zip(by_angle.cameras, by_length.cameras, strict=True):
        np.testing.assert_allclose(one.intrinsics.matrix, other.intrinsics.matrix, rtol=1e-12)
    bent = {"k1": 0.1, "k2": 0.01}
    fisheye = read_nerf(tmp_path, is_fisheye=True, **FOCAL, **bent)
    assert fisheye == read_nerf(tmp_path, camera_model="OPENCV_FISHEYE", **FOCAL, **bent)


WORDS = [
    ("fisheye", 1, "kannala_brandt"),
    ("is_fisheye", "true", "kannala_brandt"),
    ("camera_model", "fisheye", "kannala_brandt"),
    ("distortion_model", "equidistant", "kannala_brandt"),
    ("distortion_model", "radtan", "brown_conrady"),
    ("fisheye_model", 0, "brown_conrady"),
]


@pytest.mark.parametrize(("key", "word", "model"), WORDS)
def test_opencv_s_files_name_a_fisheye_in_several_words(key, word, model, tmp_path):
    lens = PAIR.cameras[0].intrinsics
    FORMATS["opencv"].save(lens, tmp_path / "lens.json")
    values = json.loads((tmp_path / "lens.json").read_text())
    values["distortion_coefficients"] |= {"cols": 4, "data": [0.1, 0.01, 0.001, 0.0]}
    (tmp_path / "lens.json").write_text(json.dumps(values | {key: word}))
    assert FORMATS["opencv"].load(tmp_path / "lens.json").distortion_model == model


def test_words_that_contradict_are_refused(tmp_path):
    FORMATS["opencv"].save(PAIR.cameras[0].intrinsics, tmp_path / "lens.json")
    values = json.loads((tmp_path / "lens.json").read_text())
    both = values | {"fisheye_model": 0, "camera_model": "fisheye"}
    (tmp_path / "lens.json").write_text(json.dumps(both))
    with pytest.raises(InputError, match="to another lens model than fisheye_model"):
        FORMATS["opencv"].load(tmp_path / "lens.json")


def test_opencv_s_older_sample_calls_its_keys_otherwise(tmp_path):
    lens = PAIR.cameras[0].intrinsics
    FORMATS["opencv"].save(lens, tmp_path / "lens.yml")
    text = (tmp_path / "lens.yml").read_text()
    for new, old in {
        "image_width": "image_Width",
        "image_height": "image_Height",
        "camera_matrix": "Camera_Matrix",
        "distortion_coefficients": "Distortion_Coefficients",
    }.items():
        text = text.replace(new, old)
    (tmp_path / "old.yml").write_text(text)
    assert FORMATS["opencv"].load(tmp_path / "old.yml") == FORMATS["opencv"].load(
        tmp_path / "lens.yml"
    )


def test_pictures_of_two_folders_keep_their_paths_as_names(tmp_path):
    document = nerf_document(**FOCAL)
    for frame, folder in zip(document["frames"], ("./train", "test"), strict=True):
        frame["file_path"] = f"{folder}/r_0.png"
    file = tmp_path / "transforms.json"
    file.write_text(json.dumps(document))
    assert FORMATS["nerfstudio"].load(file).names == ("train/r_0", "test/r_0")
