"""The readers of other tools take what is written, and project the same points alike."""

import ast
import json
import os
import re
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import scipy.io

from tests.io.formats.bench import bench_rig
from tests.io.formats.strategies import CORNERS, in_frame_of, pixels
from trinoc.geometry.camera import Camera
from trinoc.io import FORMATS

SAME = {"rtol": 0, "atol": 1e-9}
# The interpreter that Debian's python3-mrcal and python3-camera-calibration-parsers are made for.
DEBIAN = Path("/usr/bin/python3")
RIG = bench_rig()


def pose_of(camera: Camera) -> np.ndarray:
    return np.asarray(camera.cam_from_world)


def by_opencv(points, rotation, translation, matrix, distortion):
    """Images of world points by cv2. This function applies the pose exactly."""
    points_cam = points @ np.asarray(rotation).T + np.ravel(translation)
    zeros = np.zeros(3)
    images, _ = cv2.projectPoints(
        points_cam, zeros, zeros, np.asarray(matrix), np.ravel(distortion)
    )
    return images.reshape(-1, 2)


@pytest.mark.parametrize("ending", [".yml", ".json"])
def test_opencv_reads_its_rig(tmp_path, ending):
    FORMATS["opencv"].save(RIG, tmp_path / f"rig{ending}")
    storage = cv2.FileStorage(str(tmp_path / f"rig{ending}"), cv2.FILE_STORAGE_READ)
    cameras = storage.getNode("cameras")
    assert cameras.size() == 3
    for number, (name, camera) in enumerate(RIG.items()):
        node = cameras.at(number)
        assert node.getNode("name").string() == name
        size = [int(node.getNode(key).real()) for key in ("image_width", "image_height")]
        assert tuple(size) == camera.image_size_px
        keys = ("R", "T", "camera_matrix", "distortion_coefficients")
        images = by_opencv(CORNERS, *(node.getNode(key).mat() for key in keys))
        np.testing.assert_allclose(images, pixels(camera), **SAME)


def test_opencv_reads_two_cameras_as_a_stereo_pair(tmp_path):
    pair = bench_rig(cameras=2)
    FORMATS["opencv"].save(pair, tmp_path / "stereo.yml")
    storage = cv2.FileStorage(str(tmp_path / "stereo.yml"), cv2.FILE_STORAGE_READ)
    first, second = pair.cameras
    identity = (np.eye(3), np.zeros(3))
    for camera, pose, keys in (
        (first, identity, ("M1", "D1")),
        (second, [storage.getNode(key).mat() for key in ("R", "T")], ("M2", "D2")),
    ):
        lens = (storage.getNode(key).mat() for key in keys)
        images = by_opencv(in_frame_of(first), *pose, *lens)
        np.testing.assert_allclose(images, pixels(camera), **SAME)


def test_a_stereo_pair_of_opencv_s_sample_is_read(tmp_path):
    """The file has no list of cameras, like the files of OpenCV's stereo_calib."""
    pair = bench_rig(cameras=2)
    FORMATS["opencv"].save(pair, tmp_path / "stereo.json")
    document = json.loads((tmp_path / "stereo.json").read_text())
    del document["cameras"]
    (tmp_path / "stereo.json").write_text(json.dumps(document))
    loaded = FORMATS["opencv"].load(tmp_path / "stereo.json")
    assert loaded.names == ("left", "right")
    np.testing.assert_allclose(
        pixels(loaded["right"], in_frame_of(pair.cameras[0])), pixels(pair.cameras[1]), **SAME
    )


def yaml_readers():
    def by_ruamel(text):
        ruamel = pytest.importorskip("ruamel.yaml", reason="ruamel.yaml is not installed")
        return ruamel.YAML(typ="safe", pure=True).load(text)

    def by_pyyaml(text):
        return pytest.importorskip("yaml", reason="PyYAML is not installed").safe_load(text)

    return [pytest.param(by_ruamel, id="ruamel"), pytest.param(by_pyyaml, id="pyyaml")]


@pytest.mark.parametrize("read", yaml_readers())
def test_ros_files_say_the_lens_and_the_pose(tmp_path, read):
    FORMATS["ros"].save(RIG, tmp_path / "rig")
    transforms = read((tmp_path / "rig" / "tf_static.yaml").read_text())["transforms"]
    for entry, (name, camera) in zip(transforms, RIG.items(), strict=True):
        info = read((tmp_path / "rig" / f"{name}.yaml").read_text())
        assert info["distortion_model"] == "plumb_bob"
        assert (info["image_width"], info["image_height"]) == camera.image_size_px
        matrix = np.reshape(info["camera_matrix"]["data"], (3, 3))
        assert info["projection_matrix"]["data"] == np.c_[matrix, np.zeros(3)].ravel().tolist()
        assert entry["header"]["frame_id"] == "world"
        assert entry["child_frame_id"] == f"{name}_optical_frame"
        pose = entry["transform"]
        centre_mm = np.array([pose["translation"][axis] for axis in "xyz"]) * 1000
        np.testing.assert_allclose(centre_mm, camera.centre_world_mm, rtol=0, atol=1e-9)
        x, y, z, w = (pose["rotation"][axis] for axis in "xyzw")
        world_from_cam = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        distortion = info["distortion_coefficients"]["data"]
        rotation = world_from_cam.T
        images = by_opencv(CORNERS, rotation, -rotation @ centre_mm, matrix, distortion)
        np.testing.assert_allclose(images, pixels(camera), **SAME)


def test_tf_json_has_the_arguments_of_a_launch_file(tmp_path):
    FORMATS["tf"].save(RIG, tmp_path / "tf.json")
    document = json.loads((tmp_path / "tf.json").read_text())
    arguments = document["static_transform_publisher"]["left"]
    options = dict(zip(arguments[::2], arguments[1::2], strict=True))
    assert options["--frame-id"] == "world"
    assert options["--child-frame-id"] == "left_optical_frame"
    centre_mm = [1000 * float(options[key]) for key in ("--x", "--y", "--z")]
    np.testing.assert_allclose(centre_mm, RIG["left"].centre_world_mm, rtol=0, atol=1e-9)


def test_frames_between_world_and_camera_are_followed(tmp_path):
    """A camera may hang from a tripod, which hangs from the world."""
    FORMATS["tf"].save(RIG, tmp_path / "tf.json")
    document = json.loads((tmp_path / "tf.json").read_text())
    for entry in document["transforms"]:
        entry["header"]["frame_id"] = "tripod"
    quarter = {"x": 0.0, "y": 0.0, "z": np.sqrt(0.5), "w": np.sqrt(0.5)}
    pose = {"translation": {"x": 1.0, "y": 0.0, "z": 0.5}, "rotation": quarter}
    document["transforms"].append(
        {"header": {"frame_id": "map"}, "child_frame_id": "tripod", "transform": pose}
    )
    (tmp_path / "tf.json").write_text(json.dumps(document))
    lenses = {name: camera.intrinsics for name, camera in RIG.items()}
    loaded = FORMATS["tf"].load(tmp_path / "tf.json", lenses=lenses)
    moved = CORNERS @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]) + (1000, 0, 500)
    for name, camera in RIG.items():
        np.testing.assert_allclose(pixels(loaded[name], moved), pixels(camera), rtol=0, atol=1e-8)


@pytest.mark.parametrize("read", yaml_readers())
def test_kalibr_s_chain_leads_from_camera_to_camera(tmp_path, read):
    rig = bench_rig(coefficients=4)
    FORMATS["kalibr"].save(rig, tmp_path / "camchain.yaml")
    chain = read((tmp_path / "camchain.yaml").read_text())
    assert list(chain) == ["cam0", "cam1", "cam2"]
    assert "T_cn_cnm1" not in chain["cam0"]
    pose = np.eye(4)
    for entry, camera in zip(chain.values(), rig.cameras, strict=True):
        assert all(isinstance(number, float) for number in entry["intrinsics"])
        pose = np.array(entry.get("T_cn_cnm1", np.eye(4).tolist())) @ pose
        fx, fy, cx, cy = entry["intrinsics"]
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        points = in_frame_of(rig.cameras[0]) / 1000  # metres
        images = by_opencv(points, pose[:3, :3], pose[:3, 3], matrix, entry["distortion_coeffs"])
        np.testing.assert_allclose(images, pixels(camera), **SAME)


@pytest.mark.parametrize("name", ["colmap", "colmap-text"])
@pytest.mark.parametrize("coefficients", [0, 4, 5])
def test_pycolmap_projects_alike(tmp_path, name, coefficients):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    rig = bench_rig(coefficients)
    FORMATS[name].save(rig, tmp_path / "model")
    model = pycolmap.Reconstruction(str(tmp_path / "model"))
    assert (model.num_rigs(), model.num_frames(), model.num_reg_images()) == (1, 1, 3)
    (one_rig,) = model.rigs.values()
    assert one_rig.num_sensors() == 3
    for camera_name, camera in rig.items():
        image = model.find_image_with_name(camera_name)
        points_cam = CORNERS @ image.cam_from_world().matrix()[:, :3].T
        points_cam = points_cam + image.cam_from_world().matrix()[:, 3]
        images = model.cameras[image.camera_id].img_from_cam(points_cam)
        np.testing.assert_allclose(images - 0.5, pixels(camera), **SAME)


@pytest.mark.parametrize("write", ["write_text", "write_binary"])
def test_a_model_that_pycolmap_writes_is_read(tmp_path, write):
    """The model has points, observations and every lens model that trinoc supports."""
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    for model_name in ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"):
        options = pycolmap.SyntheticDatasetOptions()
        options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 2, 2, 2
        options.num_points3D = 20
        options.camera_model_id = getattr(pycolmap.CameraModelId, model_name)
        extra = {"SIMPLE_RADIAL": 1, "RADIAL": 2, "OPENCV": 4}.get(model_name, 0)
        focals = [1280.0] * (2 if model_name in ("PINHOLE", "OPENCV") else 1)
        options.camera_params = [*focals, 512.0, 384.0, *[0.01] * extra]
        dataset = pycolmap.synthesize_dataset(options)
        folder = tmp_path / model_name
        folder.mkdir()
        getattr(dataset, write)(str(folder))
        loaded = FORMATS["colmap"].load(folder)
        assert len(loaded) == dataset.num_reg_images() == 8
        points = np.array([point.xyz for point in dataset.points3D.values()])
        for image in dataset.images.values():
            matrix = image.cam_from_world().matrix()
            points_cam = points @ matrix[:, :3].T + matrix[:, 3]
            expected = dataset.cameras[image.camera_id].img_from_cam(points_cam) - 0.5
            np.testing.assert_allclose(pixels(loaded[image.name], points), expected, **SAME)


def test_a_cameramodel_is_what_mrcal_documents(tmp_path):
    """The file is a Python literal in metres. Its lens is OpenCV's with as many coefficients."""
    FORMATS["mrcal"].save(RIG, tmp_path / "models")
    for name, camera in RIG.items():
        model = ast.literal_eval((tmp_path / "models" / f"{name}.cameramodel").read_text())
        assert model["lensmodel"] == "LENSMODEL_OPENCV5"
        assert tuple(model["imagersize"]) == camera.image_size_px
        fx, fy, cx, cy, *distortion = model["intrinsics"]
        rotation, _ = cv2.Rodrigues(np.array(model["extrinsics"][:3]))
        translation = 1000 * np.array(model["extrinsics"][3:])
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        images = by_opencv(CORNERS, rotation, translation, matrix, distortion)
        np.testing.assert_allclose(images, pixels(camera), **SAME)


def read_by_debian(module, program, *arguments):
    """JSON output of a program run by Debian's Python. Skips if its module is not installed."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    call = {"capture_output": True, "text": True, "env": environment}
    if not DEBIAN.exists() or subprocess.run([DEBIAN, "-c", f"import {module}"], **call).returncode:
        pytest.skip(f"Debian's {module} is not installed")
    process = subprocess.run([DEBIAN, "-c", program, *map(str, arguments)], **call)
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout)


def test_mrcal_projects_the_same_points_alike(tmp_path):
    program = """if True:
        import json, sys, mrcal, numpy as np
        points = np.array(json.loads(sys.argv[1])) / 1000
        models = [mrcal.cameramodel(name) for name in sys.argv[2:]]
        seen = [mrcal.transform_point_rt(m.extrinsics_rt_fromref(), points) for m in models]
        images = [mrcal.project(s, *m.intrinsics()) for s, m in zip(seen, models)]
        print(json.dumps([each.tolist() for each in images]))
    """
    FORMATS["mrcal"].save(RIG, tmp_path / "models")
    files = [tmp_path / "models" / f"{name}.cameramodel" for name in RIG]
    for camera, images in zip(
        RIG.cameras,
        read_by_debian("mrcal", program, json.dumps(CORNERS.tolist()), *files),
        strict=True,
    ):
        np.testing.assert_allclose(images, pixels(camera), **SAME)


def test_ros_reads_the_lens_of_each_camera(tmp_path):
    program = """if True:
        import json, sys, camera_calibration_parsers
        found = [camera_calibration_parsers.readCalibration(name) for name in sys.argv[1:]]
        keys = ("width", "height", "distortion_model")
        print(json.dumps([[name, [getattr(info, key) for key in keys], info.K, info.D]
                          for name, info in found]))
    """
    FORMATS["ros"].save(RIG, tmp_path / "ros")
    files = [tmp_path / "ros" / f"{name}.yaml" for name in RIG]
    for (name, camera), parsed in zip(
        RIG.items(), read_by_debian("camera_calibration_parsers", program, *files), strict=True
    ):
        assert parsed[:2] == [name, [*camera.image_size_px, "plumb_bob"]]
        identity = np.eye(3), np.zeros(3)
        matrix, distortion = np.reshape(parsed[2], (3, 3)), parsed[3]
        images = by_opencv(in_frame_of(camera), *identity, matrix, distortion)
        np.testing.assert_allclose(images, pixels(camera), **SAME)


def test_matlab_s_rows_and_pixels_count_from_one(tmp_path):
    FORMATS["matlab"].save(RIG, tmp_path / "rig.mat")
    loaded = scipy.io.loadmat(tmp_path / "rig.mat", simplify_cells=True)
    assert list(loaded["camera_names"]) == list(RIG.names)
    first = RIG.cameras[0]
    for number, camera in enumerate(RIG.cameras[1:], 2):
        pair = loaded[f"stereoParams_{number}"]
        points_cam = in_frame_of(first) @ pair["RotationOfCamera2"] + pair["TranslationOfCamera2"]
        lens = pair["CameraParameters2"]
        assert tuple(lens["ImageSize"][::-1]) == camera.image_size_px
        x, y = (points_cam[:, :2] / points_cam[:, 2:]).T
        r2 = x * x + y * y
        k1, k2, k3 = lens["RadialDistortion"]
        p1, p2 = lens["TangentialDistortion"]
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        distorted = np.stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
                np.ones_like(x),
            ],
            axis=1,
        )
        images = (distorted @ lens["IntrinsicMatrix"])[:, :2] - 1
        np.testing.assert_allclose(images, pixels(camera), **SAME)


def test_nerfstudio_s_cameras_look_back_along_z(tmp_path):
    FORMATS["nerfstudio"].save(RIG, tmp_path / "transforms.json")
    document = json.loads((tmp_path / "transforms.json").read_text())
    for frame, (name, camera) in zip(document["frames"], RIG.items(), strict=True):
        assert frame["file_path"] == f"images/{name}.png"
        world_from_gl = np.array(frame["transform_matrix"])
        np.testing.assert_allclose(world_from_gl[:3, 3], camera.centre_world_mm, atol=1e-9)
        np.testing.assert_allclose(-world_from_gl[:3, 2], pose_of(camera)[2, :3], atol=1e-12)
        points_gl = (CORNERS - world_from_gl[:3, 3]) @ world_from_gl[:3, :3]
        assert (points_gl[:, 2] < 0).all()
        points_cam = points_gl * (1, -1, -1)  # to y down, z forward
        matrix = np.array(
            [[frame["fl_x"], 0, frame["cx"]], [0, frame["fl_y"], frame["cy"]], [0, 0, 1]]
        )
        distortion = [frame[key] for key in ("k1", "k2", "p1", "p2", "k3")]
        images = by_opencv(points_cam, np.eye(3), np.zeros(3), matrix, distortion)
        np.testing.assert_allclose(images - 0.5, pixels(camera), **SAME)


def test_a_pose_that_a_chain_states_twice_is_read_once(tmp_path):
    """Public calibrations repeat the pose of the chain, beside poses from the inertial unit."""
    rig = bench_rig(coefficients=4)
    FORMATS["kalibr"].save(rig, tmp_path / "camchain.yaml")
    before = FORMATS["kalibr"].load(tmp_path / "camchain.yaml")
    text = (tmp_path / "camchain.yaml").read_text()
    (rows, *_) = re.findall(r"T_cn_cnm1:\n((?: +- .*\n){4})", text)
    (tmp_path / "camchain.yaml").write_text(f"{text}T_cam1_cam0:\n{rows}")
    assert FORMATS["kalibr"].load(tmp_path / "camchain.yaml") == before


def test_names_of_colmap_s_pictures_may_have_blanks(tmp_path):
    FORMATS["colmap-text"].save(RIG, tmp_path / "model")
    file = tmp_path / "model" / "images.txt"
    file.write_text(
        file.read_text().replace(" left\n", " Image 2020-04-24 at 5.12.56 PM (1).jpeg\n")
    )
    names = FORMATS["colmap-text"].load(tmp_path / "model").names
    assert "Image 2020-04-24 at 5.12.56 PM (1).jpeg" in names
