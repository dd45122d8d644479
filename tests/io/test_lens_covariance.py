"""A camera.json keeps what is known of the lens's errors, as a rig.json does, and refuses what
cannot be."""

import json

import numpy as np
import pytest

from trinoc.cli.lens_options import read_lenses
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.io import load_intrinsics
from trinoc.io.intrinsics_json import load_lens_covariance, save_intrinsics
from trinoc.io.rig_json import load_lens, save_rig

LENS = Intrinsics(image_size_px=(512, 480), focal_length_px=1000.0, distortion=(-0.2, 0.1))


def covariance() -> np.ndarray:
    root = np.random.default_rng(5).normal(size=(9, 9))
    root[8] = 0.0
    return root @ root.T


def test_covariance_comes_back_and_the_lens_with_it(tmp_path):
    save_intrinsics(LENS, tmp_path / "camera.json", covariance=covariance())
    np.testing.assert_array_equal(load_lens_covariance(tmp_path / "camera.json"), covariance())
    np.testing.assert_array_equal(
        load_intrinsics(tmp_path / "camera.json").distortion, LENS.distortion
    )
    sigma = json.loads((tmp_path / "camera.json").read_text())["sigma"]
    assert sigma["fx_px"] == pytest.approx(np.sqrt(covariance()[0, 0]))
    assert sigma["k3"] == 0.0


def test_a_lens_without_covariance_has_none(tmp_path):
    save_intrinsics(LENS, tmp_path / "camera.json")
    assert load_lens_covariance(tmp_path / "camera.json") is None


@pytest.mark.parametrize("change", ["order", "sign", "shape"])
def test_what_is_no_covariance_is_refused(tmp_path, change):
    file = tmp_path / "camera.json"
    save_intrinsics(LENS, file, covariance=covariance())
    document = json.loads(file.read_text())
    block = document["covariance"]
    if change == "order":
        block["parameters"] = block["parameters"][::-1]
    elif change == "sign":
        block["matrix"][0][0] *= -1
    else:
        block["matrix"] = block["matrix"][:8]
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match="covariance"):
        load_lens_covariance(file)


def rig_of(*names: str) -> Rig:
    """Cameras of one lens, with a joint covariance of the k1, distance and fx of each camera."""
    cameras = {
        name: Camera.from_degrees(
            LENS, pan_deg=20.0 * k, tilt_deg=40.0, swing_deg=0.0, distance_mm=500.0
        )
        for k, name in enumerate(names)
    }
    parameters = [f"{name}.{each}" for name in names for each in ("k1", "distance_mm", "fx_px")]
    root = np.random.default_rng(6).normal(size=(len(parameters),) * 2)
    return Rig(cameras, parameters=parameters, covariance=root @ root.T)


def test_the_lens_of_a_rig_has_its_part_of_the_covariance(tmp_path):
    rig = rig_of("a", "b")
    save_rig(rig, tmp_path / "rig.json")
    lens, loaded_covariance = load_lens(tmp_path / "rig.json", "b")
    np.testing.assert_array_equal(lens.distortion, LENS.distortion)
    assert loaded_covariance is not None
    # The lens's parameters are fx, fy, cx, cy, k1, ..., the rig's k1, distance and fx of each.
    expected = np.zeros((9, 9))
    expected[np.ix_([4, 0], [4, 0])] = np.asarray(rig.covariance)[np.ix_([3, 5], [3, 5])]
    np.testing.assert_array_equal(loaded_covariance, expected)


def test_one_file_of_all_cameras_is_one_lens_or_that_of_each(tmp_path):
    one, both, exact = (tmp_path / name for name in ("one.json", "both.json", "exact.json"))
    save_rig(rig_of("a"), one)
    save_rig(rig_of("a", "b"), both)
    save_intrinsics(LENS, exact)
    lenses, shared = read_lenses((str(one),), ("left", "right"))
    assert list(lenses) == ["left", "right"]
    np.testing.assert_array_equal(shared, load_lens(one).covariance)
    _, covariances = read_lenses((f"left={one}", f"right={exact}"), ())
    assert list(covariances) == ["left"]
    assert read_lenses((str(exact),), ("left", "right"))[1] is None
    for arguments, message in (((str(both),), 'none of which is "left"'), ((f"c={both}",), '"c"')):
        with pytest.raises(InputError, match=message):
            read_lenses(arguments, ("left",))
    with pytest.raises(InputError, match="a lens is that of one"):
        load_lens(both)
