"""What is written can be read: writers and readers refuse the same lenses and cameras."""

import numpy as np
import pytest

import trinoc
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics, describe_fold
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io import FORMATS

FOLDS = Intrinsics(
    image_size_px=(640, 480), focal_length_px=350.0, distortion=(-0.27, 0.0, 0.0, 0.0, 0.0)
)
SAYS = "lens has a distortion that folds the picture 259 px from the principal point"


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
    with pytest.raises(InputError, match=r"was not written: the cameras .* stand at one place"):
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
    if describe_fold(lens) is not None:
        with pytest.raises(InputError, match="folds the picture"):
            trinoc.save(rig_of(lens), path)
        assert not path.exists()
        return
    trinoc.save(rig_of(lens), path)
    assert trinoc.load_rig(path).names == ("a", "b")


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
    again = trinoc.load_rig(path)
    for name, camera in again.items():
        rotation = np.asarray(camera.cam_from_world)[:, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        written = np.asarray(rounded[name].cam_from_world)
        np.testing.assert_allclose(camera.cam_from_world, written, atol=10.0**-digits)
    trinoc.save(again, path, overwrite=True)
    assert trinoc.load_rig(path) == again
