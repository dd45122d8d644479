"""No reader passes over a key that changes the projection: it is read, or refused by its name."""

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given, strategies as st

from tests.io.formats.bench import bench_rig
from tests.io.formats.metashape import LENS as METASHAPE_LENS, cameras_xml
from trinoc.errors import InputError
from trinoc.io import FORMATS
from trinoc.io.formats.keys import Keys, Refused
from trinoc.io.formats.text_files import yaml_text
from trinoc.io.json_document import Block

RIG = bench_rig(coefficients=4, cameras=2)
LENSES = {name: camera.intrinsics for name, camera in RIG.items()}
# Formats whose numbers are told apart by their places, and have no keys.
BY_PLACE = {"colmap", "colmap-text", "lsd", "elsed", "limap-segments"}
SUFFIX = {"opencv": ".json", "tf": ".json"}
# Where the lens stands in a file: the keys on the way to it.
LENS = {
    "opencv": ("cameras", 0),
    "ros": (),
    "kalibr": ("cam0",),
    "mrcal": (),
    "matlab": ("stereoParams", "CameraParameters1"),
    "nerfstudio": ("frames", 0),
    "anipose": (),
    "caliscope": (),
    "multical": ("cameras", "upper"),
    "mc-calib": (),
    "easymocap": (),
    "metashape": (),
    "tf": ("transforms", 0),
}
# What other tools' files say of a projection, that trinoc's cameras or readers do not have.
CHANGING = {
    "opencv": {
        "xi": 1.2,
        "alpha": 0.01,
        "skew": 3.0,
        "distortion_model": "omni",
        "fisheye": "yes",
        "model": "ucm",
        "binning": 2,
        "k7": 0.1,
        "dist_coeff": 0.1,
        "coeffs": [0.1],
    },
    "ros": {"binning_x": 2, "binning_y": 4, "roi": {"x_offset": 8}, "xi": 1.0},
    "kalibr": {"line_delay": 1e-5, "xi": 1.5, "camera_model": "omni", "alpha": 0.5},
    "mrcal": {"lensmodel": "LENSMODEL_CAHVOR", "distortions": [0.1], "skew": 2.0},
    "matlab": {"MappingCoefficients": np.ones((1, 4)), "WorldUnits": "palms", "StretchMatrix": 2.0},
    "nerfstudio": {
        "rolling_shutter": [0.0, 0.0, 0.0, 0.02],
        "equirectangular": True,
        "camera_model": "EQUIRECTANGULAR",
        "k4": 0.2,
        "k6": 0.01,
        "is_fisheye": True,
        "ftheta_p0": 1.0,
        "lens": "cylinder",
    },
    "anipose": {"xi": 1.2, "camera_model": "omni", "skew": 0.1, "fisheye": "yes", "k4": 0.1},
    "caliscope": {"xi": 1.2, "model": "omni", "binning": 2, "fisheye": 1},
    "multical": {"model": "fix_k1", "has_skew": True, "xi": 1.0, "rolling_shutter": 0.01},
    "mc-calib": {"distortion_type": 2, "xi": 1.2, "alpha": 0.5, "camera_group": 1},
    "easymocap": {"xi": 1.2, "fisheye": 1, "alpha": 0.1},
    "metashape": {"k4": 0.1, "p3": 0.1, "p4": 0.1, "k5": 0.1, "fx": 9, "fy": 9, "skew": 1},
    "tf": {"scale": 2.0},
}
# Files whose keys are set as text: the line before the keys of the first lens, and such a line.
LINES = {
    "anipose": ("[cam_0]", "{key} = {value}"),
    "caliscope": ("[cameras.0]", "{key} = {value}"),
    "mc-calib": ("camera_0:", "   {key}: {value}"),
    "easymocap": ("---", "{key}_upper: {value}"),
    "metashape": (METASHAPE_LENS, "<{key}>{value}</{key}>"),
}
# Values of such keys that change nothing, and further keys that a file may have.
HARMLESS = {
    "opencv": {"xi": 0, "fisheye": False, "distortion_model": "plumb_bob", "rms": 0.2},
    "ros": {"binning_x": 1, "binning_y": 0, "date": "today"},
    "kalibr": {"timeshift_cam_imu": 0.004, "cam_overlaps": [1], "line_delay": 0},
    "mrcal": {"valid_intrinsics_region": [], "icam_intrinsics": 0},
    "matlab": {"EstimateSkew": False, "WorldUnits": "millimeters"},
    "nerfstudio": {"sharpness": 3.0, "applied_scale": 0.5, "rolling_shutter": [0, 0, 0, 0]},
    "anipose": {"fisheye": False, "world_position": [1.0, 2.0, 3.0], "error": 0.2, "index": 3},
    "caliscope": {"rotation_count": 1, "exposure": -7, "grid_count": 24, "cam_id": 5},
    "multical": {"has_skew": False, "rms": 0.1},
    "mc-calib": {"camera_group": 0},
    "easymocap": {"ccm": [1.0]},
    "metashape": {"k4": 0, "p3": 0.0, "skew": 0},
    "tf": {"stamp": 3},
}


def written(name: str, folder: Path) -> Path:
    form = FORMATS[name]
    if name in ("ros", "mrcal"):
        path = folder / f"camera{form.endings[0]}"
        form.save(RIG.cameras[0].intrinsics, path)
    elif name == "metashape":
        path = folder / "cameras.xml"
        path.write_text(cameras_xml())
    elif name == "easymocap":
        path = folder / "rig"
        form.save(RIG, path)
    else:
        path = folder / f"rig{SUFFIX.get(name, form.endings[0])}"
        form.save(RIG, path)
    return path


def set_keys(name: str, path: Path, values: dict) -> None:
    """Write the file again with other values of the keys of its first lens."""
    if name in LINES:
        file = path / "intri.yml" if path.is_dir() else path
        head, line = LINES[name]
        text = file.read_text()
        for key, value in values.items():
            added = line.format(key=key, value=json.dumps(value))
            before = added.split(json.dumps(value))[0]
            text = re.sub(rf"^{re.escape(before)}.*\n", "", text, count=1, flags=re.MULTILINE)
            text = text.replace(head, f"{head}\n{added}", 1)
        file.write_text(text)
        return
    match name:
        case "mrcal":
            document = ast.literal_eval(path.read_text())
        case "matlab":
            loaded = scipy.io.loadmat(path, simplify_cells=True)
            document = {key: value for key, value in loaded.items() if key[:2] != "__"}
        case "ros" | "kalibr":
            ruamel = pytest.importorskip("ruamel.yaml", reason="ruamel.yaml is not installed")
            document = ruamel.YAML(typ="safe", pure=True).load(path.read_text())
        case _:
            document = json.loads(path.read_text())
    lens = document
    for key in LENS[name]:
        lens = lens[key]
    lens |= values
    match name:
        case "mrcal":
            path.write_text(repr(document))
        case "matlab":
            pair = document["stereoParams"]
            for camera in ("CameraParameters1", "CameraParameters2"):
                for key in ("RadialDistortion", "TangentialDistortion", "ImageSize"):
                    pair[camera][key] = np.atleast_2d(pair[camera][key])
            pair["TranslationOfCamera2"] = np.atleast_2d(pair["TranslationOfCamera2"])
            scipy.io.savemat(path, document)
        case "ros" | "kalibr":
            path.write_text(yaml_text(document))
        case _:
            path.write_text(json.dumps(document))


def loaded(name: str, path: Path):
    return FORMATS[name].load(path, lenses=LENSES)


def test_every_format_that_has_keys_declares_them():
    readable = {name for name, form in FORMATS.items() if form.reads}
    assert {name for name in readable if FORMATS[name].keys} == readable - BY_PLACE
    assert set(CHANGING) == set(HARMLESS) == set(LENS) == readable - BY_PLACE


@pytest.mark.parametrize(
    ("name", "key"), [(name, key) for name, keys in CHANGING.items() for key in keys]
)
def test_a_key_that_changes_the_projection_is_refused_by_its_name(name, key, tmp_path):
    path = written(name, tmp_path)
    set_keys(name, path, {key: CHANGING[name][key]})
    with pytest.raises(InputError, match=str(path)) as caught:
        loaded(name, path)
    value = CHANGING[name][key]
    assert key in str(caught.value) or (isinstance(value, str) and value in str(caught.value))


@pytest.mark.parametrize("name", list(HARMLESS))
def test_keys_that_change_nothing_change_nothing(name, tmp_path):
    path = written(name, tmp_path)
    before = loaded(name, path)
    set_keys(name, path, HARMLESS[name])
    assert loaded(name, path) == before


KEYS = Keys(
    read=("focal_length", "width"),
    left_out=("lens_name",),
    refused={"xi": Refused("it bends rays", (0,))},
)


def block(**values):
    return Block(values, "lens.json", "")


@given(st.dictionaries(st.sampled_from(["focal_length", "width", "lens_name", "date"]), st.none()))
def test_a_reader_gets_the_keys_that_it_declares_and_no_others(values):
    values = dict.fromkeys(values, 3.0)
    taken = KEYS.take(block(**values)).values
    assert taken == {key: 3.0 for key in values if key in KEYS.read}


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("xi", '"xi" is 2: it bends rays.'),
        ("lens_tilt", '"lens_tilt" may change the projection of points'),
        ("lens_focal_length", 'did you mean "focal_length"'),
    ],
)
def test_a_key_that_is_not_read_says_why(key, message):
    with pytest.raises(InputError, match=message):
        KEYS.take(block(width=3, **{key: 2}))
    assert KEYS.take(block(width=3, xi=0)).values == {"width": 3}
