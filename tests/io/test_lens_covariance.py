"""A camera.json keeps what is known of the lens's errors, and refuses what cannot be."""

import json

import numpy as np
import pytest

from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.io import load_intrinsics
from trinoc.io.intrinsics_json import load_lens_covariance, save_intrinsics

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
