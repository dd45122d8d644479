"""Lenses beyond Brown-Conrady's come back from the formats that have a name for them."""

import cv2
import numpy as np
import pytest

from tests.io.formats.bench import POSES
from tests.io.formats.strategies import CORNERS, in_frame_of, pixels
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.registry import LENS_MODELS
from trinoc.geometry.rig import Rig
from trinoc.io import FORMATS
from trinoc.io.formats.format import NAMES
from trinoc.io.rig_json import load_rig
from trinoc.io.saving import save

RATIONAL = [-0.1, 0.03, 0.002, -0.001, 0.01, 0.05, -0.02, 0.004]
COEFFICIENTS = {
    "rational": RATIONAL,
    "thin_prism": [*RATIONAL, 0.003, -0.001, -0.002, 0.0005],
    "kannala_brandt": [0.05, -0.02, 0.003, -0.0001],
}
HELD = {
    "rational": ("opencv", "ros", "colmap", "colmap-text", "mrcal"),
    "thin_prism": ("opencv", "ros", "mrcal"),
    "kannala_brandt": ("opencv", "ros", "kalibr", "colmap", "colmap-text", "nerfstudio"),
}
SAME = {"rtol": 0, "atol": 1e-9}


def rig_with(model: str, coefficients: list[float], cameras: int = 2) -> Rig:
    lens = Intrinsics(
        focal_length_px=(900.0, 910.0),
        image_size_px=(640, 480),
        distortion=coefficients,
        distortion_model=model,
    )
    members = {}
    for name, (pan, tilt, swing, distance) in list(POSES.items())[:cameras]:
        members[name] = Camera.from_degrees(
            lens, pan_deg=pan, tilt_deg=tilt, swing_deg=swing, distance_mm=distance
        )
    return Rig(members)


def place(name, folder):
    form = FORMATS[name]
    return folder / (f"rig{form.endings[0]}" if form.place == "file" else "rig")


@pytest.mark.parametrize(
    ("model", "name"), [(model, name) for model, names in HELD.items() for name in names]
)
def test_a_lens_comes_back(model, name, tmp_path):
    rig = rig_with(model, COEFFICIENTS[model])
    FORMATS[name].save(rig, place(name, tmp_path))
    names = rig.names if NAMES in FORMATS[name].loses else None
    loaded_rig = FORMATS[name].load(place(name, tmp_path), names=names)
    for camera_name, camera in rig.items():
        loaded = loaded_rig[camera_name]
        assert loaded.intrinsics.lens.model == model
        world = in_frame_of(rig.cameras[0]) if name == "kalibr" else CORNERS
        np.testing.assert_allclose(pixels(loaded, world), pixels(camera), **SAME)


@pytest.mark.parametrize("name", ["opencv", "ros", "colmap", "mrcal"])
def test_the_simplest_lens_that_holds_the_numbers_is_read(name, tmp_path):
    rig = rig_with("brown_conrady", [-0.1, 0.03, 0.002, -0.001, 0.0])
    FORMATS[name].save(rig, place(name, tmp_path))
    loaded_rig = FORMATS[name].load(place(name, tmp_path))
    assert {camera.intrinsics.lens.model for camera in loaded_rig.cameras} == {"brown_conrady"}


@pytest.mark.parametrize("name", ["mrcal", "matlab"])
def test_a_fisheye_is_never_written_as_a_pinhole(name, tmp_path):
    with pytest.raises(InputError, match="kannala_brandt, which"):
        FORMATS[name].save(rig_with("kannala_brandt", [0.0] * 4), place(name, tmp_path))
    FORMATS["opencv"].save(rig_with("kannala_brandt", [0.0] * 4), tmp_path / "rig.yml")
    loaded_rig = FORMATS["opencv"].load(tmp_path / "rig.yml")
    assert loaded_rig.cameras[0].intrinsics.lens.model == "kannala_brandt"


def test_opencv_s_fisheye_projects_what_is_written(tmp_path):
    rig = rig_with("kannala_brandt", COEFFICIENTS["kannala_brandt"])
    FORMATS["opencv"].save(rig, tmp_path / "rig.yml")
    storage = cv2.FileStorage(str(tmp_path / "rig.yml"), cv2.FILE_STORAGE_READ)
    node, zeros = storage.getNode("cameras").at(0), np.zeros(3)
    assert node.getNode("fisheye_model").real() == 1
    matrix, distortion = (
        node.getNode(key).mat() for key in ("camera_matrix", "distortion_coefficients")
    )
    points_cam = in_frame_of(rig.cameras[0])[:, None]
    images, _ = cv2.fisheye.projectPoints(points_cam, zeros, zeros, matrix, distortion)
    np.testing.assert_allclose(images.reshape(-1, 2), pixels(rig.cameras[0]), **SAME)


@pytest.mark.parametrize("model", LENS_MODELS)
def test_every_lens_survives_rig_json(model, tmp_path):
    few = [-0.1][: len(LENS_MODELS[model].coefficient_names)]
    rig = rig_with(model, COEFFICIENTS.get(model, few))
    save(rig, tmp_path / "rig.json")
    loaded_rig = load_rig(tmp_path / "rig.json")
    for name, camera in rig.items():
        np.testing.assert_allclose(pixels(loaded_rig[name]), pixels(camera), **SAME)
