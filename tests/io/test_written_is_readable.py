"""Every written file can be read: writers and readers refuse the same lenses and cameras."""

import json

import numpy as np
import pytest

import trinoc
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import (
    Intrinsics,
    describe_fold,
    describe_unusable_fold,
    share_beyond_fold,
)
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io import FORMATS
from trinoc.io.intrinsics_json import fold_notes

FOLDS = Intrinsics(
    image_size_px=(640, 480), focal_length_px=350.0, distortion=(-0.27, 0.0, 0.0, 0.0, 0.0)
)
SAYS = "lens has a distortion that folds the image 258 px from the principal point"


def rig_of(lens: Intrinsics, *, pan_deg: tuple[float, float] = (0.0, 20.0)) -> Rig:
    return Rig(
        {
            name: Camera.from_degrees(lens, pan_deg=pan, tilt_deg=40, swing_deg=0, distance_mm=500)
            for name, pan in zip(("a", "b"), pan_deg, strict=True)
        }
    )


def test_a_lens_that_folds_is_not_written(tmp_path) -> None:
    with pytest.raises(InputError, match=rf"camera\.json was not written: the {SAYS}"):
        trinoc.save(FOLDS, tmp_path / "camera.json")
    with pytest.raises(InputError, match=r'rig\.json was not written: the camera "a" has'):
        trinoc.save(rig_of(FOLDS), tmp_path / "rig.json")
    assert not list(tmp_path.iterdir())


def test_cameras_at_one_place_are_not_written(tmp_path) -> None:
    lens = Intrinsics(image_size_px=(640, 480), focal_length_px=800.0)
    with pytest.raises(InputError, match=r"was not written: the cameras .* have the same position"):
        trinoc.save(rig_of(lens, pan_deg=(10.0, 10.0)), tmp_path / "rig.json")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "name", [name for name, each in FORMATS.items() if "lens" in each.holds and each.read]
)
def test_files_of_other_tools_get_no_lens_that_folds(name, tmp_path) -> None:
    path = tmp_path / f"lens{FORMATS[name].endings[0]}"
    with pytest.raises(InputError, match=f"was not written: the {SAYS}"):
        FORMATS[name].save(FOLDS, path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("k1", np.linspace(-0.3, 0.1, 9))
def test_what_is_written_is_read_and_what_is_not_read_is_not_written(k1, tmp_path) -> None:
    lens = Intrinsics(image_size_px=(640, 480), focal_length_px=350.0, distortion=(float(k1),))
    path = tmp_path / "rig.json"
    if describe_unusable_fold(lens) is not None:
        with pytest.raises(InputError, match="folds the image"):
            trinoc.save(rig_of(lens), path)
        assert not path.exists()
        return
    trinoc.save(rig_of(lens), path)
    assert trinoc.load_rig(path) == rig_of(lens)
    has_radius = "valid_radius_px" in path.read_text()
    assert has_radius == (describe_fold(lens) is not None) == (share_beyond_fold(lens) > 0)


# They fold inside the image of 1280 x 720 px, beyond most of it.
USABLE = {
    "brown_conrady": (-0.25, 0.0, 0.0005, -0.001, 0.0),
    "rational": (-0.25, 0.0, 0.0005, -0.001, -0.01, 0.02, 0.0, 0.0),
    "thin_prism": (-0.25, 0.0, 0.0005, -0.001, -0.01, 0.02, 0.0, 0.0, 1e-4, 0.0, 1e-4, 0.0),
    "kannala_brandt": (-0.25, -0.02, 0.0, 0.0),
}


def usable_lens(model: str) -> Intrinsics:
    return Intrinsics(
        image_size_px=(1280, 720),
        focal_length_px=(898.5, 893.25),
        principal_point_px=(609.5, 339.25),
        distortion=USABLE[model],
        distortion_model=model,
    )


@pytest.mark.parametrize("model", USABLE)
@pytest.mark.parametrize(
    ("name", "holds"),
    [
        (name, kind)
        for name, each in FORMATS.items()
        for kind in ("lens", "rig")
        if kind in each.holds and each.read
    ],
)
def test_a_lens_that_folds_in_the_corners_is_read_once_it_is_written(name, holds, model, tmp_path):
    """This holds in every format with the lens model. The coefficients fix the fold radius."""
    lens, target = usable_lens(model), FORMATS[name]
    assert describe_unusable_fold(lens) is None
    assert describe_fold(lens) is not None
    path = tmp_path / f"lens{target.endings[0] if target.endings else ''}"
    value = lens if holds == "lens" else rig_of(lens)
    try:
        target.save(value, path)
    except InputError as error:
        refusal = str(error)
    else:
        refusal = ""
    if refusal:
        assert f"{model}, which" in refusal
        return
    loaded = target.load(path, lenses=dict.fromkeys(("a", "b"), lens))
    read = loaded if isinstance(loaded, Intrinsics) else next(iter(loaded.cameras)).intrinsics
    assert read.distortion_model == model
    np.testing.assert_allclose(read.valid_radius_px, lens.valid_radius_px, rtol=1e-6)
    (note, *_) = fold_notes(loaded)
    assert f"folds the image {lens.valid_radius_px:.0f} px" in note


@pytest.mark.parametrize("kind", ["camera", "rig"])
def test_the_radius_of_a_file_must_be_that_of_its_coefficients(kind, tmp_path):
    lens, path = usable_lens("brown_conrady"), tmp_path / f"{kind}.json"
    trinoc.save(lens if kind == "camera" else rig_of(lens), path)
    document = json.loads(path.read_text())
    block = document if kind == "camera" else document["cameras"]["a"]
    assert block["intrinsics"]["valid_radius_px"] == lens.valid_radius_px
    block["intrinsics"]["valid_radius_px"] = 0.9 * lens.valid_radius_px
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=f"one to one, {lens.valid_radius_px:.6g} px: remove"):
        trinoc.load(path)
    del block["intrinsics"]["valid_radius_px"]
    path.write_text(json.dumps(document))
    read = trinoc.load(path)
    assert (read if kind == "camera" else read["a"].intrinsics) == lens
    block["intrinsics"] |= {"distortion": {"model": "none", "coefficients": []}}
    block["intrinsics"]["valid_radius_px"] = 500.0
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match="one to one, inf px: remove the key"):
        trinoc.load(path)


@pytest.mark.parametrize("digits", [1, 2, 3, 5, 6, 7, 8, 9])
def test_a_rotation_rounded_to_some_digits_is_read_once_it_is_written(digits, tmp_path) -> None:
    rig = rig_of(Intrinsics(image_size_px=(640, 480), focal_length_px=800.0))
    rounded = {}
    for name, camera in rig.items():
        pose = np.array(camera.cam_from_world)
        pose[:, :3] = pose[:, :3].round(digits)
        rounded[name] = Camera(camera.intrinsics, Pose(pose))
    path = tmp_path / "rig.json"
    if digits < 4:
        with pytest.raises(InputError, match=r'the pose of the camera ".*" is no rotation matrix'):
            trinoc.save(Rig(rounded), path)
        assert not path.exists()
        return
    trinoc.save(Rig(rounded), path)
    loaded = trinoc.load_rig(path)
    for name, camera in loaded.items():
        rotation = np.asarray(camera.cam_from_world)[:, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        written = np.asarray(rounded[name].cam_from_world)
        np.testing.assert_allclose(camera.cam_from_world, written, atol=10.0**-digits)
    trinoc.save(loaded, path, overwrite=True)
    assert trinoc.load_rig(path) == loaded
