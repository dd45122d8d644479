"""A rig.json edited by hand: accepted variants, and one sentence for each mistake."""

import copy
import json

import numpy as np
import pytest

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.io.rig_json import load_rig, save_rig

LENS = Intrinsics(focal_length_mm=16, pixel_pitch_mm=(0.0162, 0.0134), image_size_px=(512, 480))
PARAMETERS = ("upper.pan_deg", "upper.tilt_deg", "upper.swing_deg", "upper.distance_mm")


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    """A rig.json of one camera, as a Python object."""
    camera = Camera.from_degrees(
        LENS, pan_deg=2.143, tilt_deg=53.252, swing_deg=-1.714, distance_mm=476.369
    )
    covariance = np.diag(np.square([0.0015, 0.0009, 0.0014, 0.004]))
    rig = Rig({"upper": camera}, parameters=PARAMETERS, covariance=covariance)
    path = tmp_path_factory.mktemp("rig") / "rig.json"
    save_rig(rig, path, provenance={"command": "a test"})
    return json.loads(path.read_text())


def loaded(document, folder):
    (folder / "rig.json").write_text(json.dumps(document))
    return load_rig(folder / "rig.json")


def changed(document, *keys, value):
    """A copy of the document with the entry at `keys` replaced, or removed for None."""
    result = copy.deepcopy(document)
    inner = result
    for key in keys[:-1]:
        inner = inner[key]
    if value is None:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    return result


def test_file_holds_what_the_design_names(document):
    assert document["format"] == "trinoc-rig"
    assert document["version"] == 1
    upper = document["cameras"]["upper"]
    assert upper["image_size_px"] == [512, 480]
    assert upper["intrinsics"] == {
        "focal_length_mm": 16.0,
        "pixel_pitch_mm": [0.0162, 0.0134],
        "principal_point_px": [255.5, 239.5],
        "distortion": {"model": "none", "coefficients": []},
    }
    assert upper["extrinsics"]["pan_deg"] == pytest.approx(2.143, abs=1e-9)
    assert upper["extrinsics"]["aim_mm"] == pytest.approx([0, 0], abs=1e-9)
    assert upper["sigma"]["distance_mm"] == pytest.approx(0.004)
    assert document["covariance"]["parameters"] == list(PARAMETERS)
    assert document["provenance"] == {"command": "a test"}


@pytest.mark.parametrize("key", ["extrinsics", "cam_from_world", "sigma"])
def test_either_form_of_the_pose_is_enough_and_sigma_is_a_reading_aid(document, tmp_path, key):
    complete = loaded(document, tmp_path)
    reduced = loaded(changed(document, "cameras", "upper", key, value=None), tmp_path)
    np.testing.assert_allclose(reduced.matrices_px, complete.matrices_px, rtol=1e-9)
    assert reduced.sigma("upper.pan_deg") == complete.sigma("upper.pan_deg")


def test_rig_without_covariance_is_a_rig(document, tmp_path):
    bare = changed(document, "covariance", value=None)
    bare = changed(bare, "cameras", "upper", "sigma", value=None)
    assert loaded(bare, tmp_path).covariance.shape == (0, 0)


def test_camera_whose_axis_misses_the_sheet_keeps_its_matrix(tmp_path):
    along_the_sheet = np.array([[320.0, 700, 0, 10], [240, 0, 700, 20], [1, 0, 0, 30]])
    rig = Rig.from_matrices({"a": along_the_sheet}, (640, 480))
    save_rig(rig, tmp_path / "rig.json")
    block = json.loads((tmp_path / "rig.json").read_text())["cameras"]["a"]
    assert "extrinsics" not in block
    np.testing.assert_allclose(load_rig(tmp_path / "rig.json").matrices_px, rig.matrices_px)


UPPER = ("cameras", "upper")
MISTAKES = {
    "another format": (("format",), "trinoc-camera", r'format "trinoc-camera", but "trinoc-rig"'),
    "another version": (("version",), 2, "version 2 of trinoc-rig.*update"),
    "no camera": (("cameras",), {}, '"cameras" names no camera'),
    "key misspelt": (
        (*UPPER, "intrinsics", "focal_lenght_mm"),
        16,
        '"cameras.upper.intrinsics.focal_lenght_mm" is an unknown key: did you mean "focal_len',
    ),
    "key unknown": (("colour",), "red", '"colour" is an unknown key: remove it'),
    "text for a number": ((*UPPER, "extrinsics", "pan_deg"), "2", "pan_deg.*finite number, but"),
    "true for a number": ((*UPPER, "extrinsics", "pan_deg"), True, "must be a finite number"),
    "infinite": (
        (*UPPER, "extrinsics", "pan_deg"),
        float("inf"),
        "Infinity is not a finite number",
    ),
    "not a number": (
        (*UPPER, "cam_from_world"),
        [[float("nan")] * 4] * 3,
        "NaN is not a finite number",
    ),
    "too large a number": ((*UPPER, "extrinsics", "pan_deg"), 10**400, "must be a finite number"),
    "poses disagree": ((*UPPER, "extrinsics", "pan_deg"), 2.144, "describe different cameras"),
    "no rotation": ((*UPPER, "cam_from_world"), [[1, 0, 0, 0]] * 3, "with a rotation R"),
    "distance behind": ((*UPPER, "extrinsics", "distance_mm"), -476.0, "must be positive"),
    "size of no picture": ((*UPPER, "image_size_px"), [512.5, 480], "whole positive pixels"),
    "no focal length": ((*UPPER, "intrinsics", "focal_length_mm"), None, "not determined. Give"),
    "distortion unnamed": (
        (*UPPER, "intrinsics", "distortion"),
        {"model": "none", "coefficients": [0.1]},
        'must be empty for the model "none"',
    ),
    "sigma off": ((*UPPER, "sigma", "pan_deg"), 0.1, "differs from the covariance"),
    "matrix too small": (("covariance", "matrix"), [[1.0]], "list of 4 x 4 finite numbers"),
    "matrix ragged": (("covariance", "matrix"), [[1.0], [1.0, 2.0]], "list of 4 x 4 finite"),
    "matrix not symmetric": (("covariance", "matrix", 0, 1), 1.0, "is no covariance"),
    "camera not there": (("covariance", "parameters", 0), "lower.pan_deg", 'no camera "lower"'),
    "twice the same": (("covariance", "parameters", 0), PARAMETERS[1], "a parameter twice"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_each_mistake_is_one_sentence_with_the_file(document, tmp_path, mistake):
    keys, value, sentence = MISTAKES[mistake]
    with pytest.raises(InputError, match=sentence) as caught:
        loaded(changed(document, *keys, value=value), tmp_path)
    text = str(caught.value)
    assert str(tmp_path / "rig.json") in text
    assert "\n" not in text
    assert text[-1] in ".?"


def test_files_that_are_no_json(tmp_path):
    path = tmp_path / "rig.json"
    with pytest.raises(InputError, match="does not exist"):
        load_rig(path)
    for text, sentence in [
        (" ", "is empty: give another file"),
        ("{", r"is not JSON \(line 1, column 2"),
        ("[]", "has the format missing"),
        ('{"format": "trinoc-rig", "format": "trinoc-rig"}', 'key "format" occurs twice'),
    ]:
        path.write_text(text)
        with pytest.raises(InputError, match=sentence):
            load_rig(path)
    path.write_bytes(b"\x89PNG\xff")
    with pytest.raises(InputError, match="no text file"):
        load_rig(path)


def test_covariance_that_says_nothing_is_not_written(tmp_path):
    camera = Camera.from_degrees(LENS, pan_deg=0, tilt_deg=50, swing_deg=0, distance_mm=500)
    rig = Rig({"a": camera}, parameters=("a.pan_deg",), covariance=np.array([[np.nan]]))
    with pytest.raises(InputError, match=r'"covariance\.matrix" is not finite'):
        save_rig(rig, tmp_path / "rig.json")
    assert list(tmp_path.iterdir()) == []
