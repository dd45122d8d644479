"""Writers refuse values that a format cannot hold, and readers name unreadable content."""

import json
import re
import sys

import cv2
import equinox as eqx
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings, strategies as st

from tests.geometry.strategies import LENS
from tests.io.formats.bench import bench_matches, bench_rig
from tests.io.made_wireframe import made_wireframe
from trinoc.errors import InputError
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.io import FORMATS
from trinoc.io.formats.format import LOSSES

RIG = bench_rig(coefficients=4)
POSE = np.asarray(RIG.cameras[0].cam_from_world)
OF_CAMERAS = [name for name, each in FORMATS.items() if "rig" in each.holds]


def place_of(form, folder, kind="rig"):
    in_folder = form.place == "folder" or (kind == "rig" and "folder" in form.place)
    return folder / ("rig" if in_folder else f"rig{form.endings[0]}")


def written(name, folder, value=RIG):
    path = place_of(FORMATS[name], folder)
    FORMATS[name].save(value, path)
    return path


def rig_of(lens, *names):
    """Cameras with one lens and one direction, 100 mm apart."""
    aside = np.zeros((3, 4))
    aside[0, 3] = 100.0
    return Rig(
        {
            name: Camera(lens, Pose(POSE + number * aside))
            for number, name in enumerate(names or ("a", "b"))
        }
    )


def skewed():
    return Intrinsics(focal_length_px=900.0, image_size_px=(640, 480), skew_px=0.5)


@pytest.mark.parametrize("name", [n for n in OF_CAMERAS if n not in ("matlab", "tf")])
def test_skew_is_refused_where_there_is_none(name, tmp_path):
    with pytest.raises(InputError, match=r'"a" has a skew of 0.5 px'):
        written(name, tmp_path, rig_of(skewed()))
    assert list(tmp_path.iterdir()) == []


def test_kalibr_refuses_a_third_radial_coefficient(tmp_path):
    with pytest.raises(InputError, match=r'"upper" has k3 = 0.01, which Kalibr'):
        written("kalibr", tmp_path, bench_rig())


@pytest.mark.parametrize("name", ["opencv", "ros", "kalibr", "mrcal", "nerfstudio"])
def test_another_ending_or_a_wrong_kind_is_refused(name, tmp_path):
    form = FORMATS[name]
    if form.place == "file":
        with pytest.raises(InputError, match="choose such a name"):
            form.save(RIG, tmp_path / "rig.xyz")
    with pytest.raises(InputError, match="not matches: choose"):
        form.save(bench_matches(), tmp_path / f"rig{form.endings[0]}")


@pytest.mark.parametrize("name", ["colmap", "ros", "mrcal", "limap"])
def test_a_folder_with_something_in_it_is_left_alone(name, tmp_path):
    (tmp_path / "rig").mkdir()
    (tmp_path / "rig" / "mine.txt").write_text("keep me")
    value = bench_matches() if name == "limap" else RIG
    with pytest.raises(InputError, match="exists already"):
        FORMATS[name].save(value, tmp_path / "rig")
    assert [file.name for file in (tmp_path / "rig").iterdir()] == ["mine.txt"]


def test_an_empty_folder_is_filled(tmp_path):
    (tmp_path / "rig").mkdir()
    FORMATS["colmap"].save(RIG, tmp_path / "rig")
    assert len(list((tmp_path / "rig").iterdir())) == 5


@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("ros", "left eye"),
        ("tf", "left/eye"),
        ("tf", "world"),
        ("mrcal", "../left"),
        ("nerfstudio", "left/eye"),
        ("colmap-text", "left eye"),
        *((name, "left\n") for name in OF_CAMERAS),
    ],
)
def test_names_that_a_format_cannot_hold_are_refused(name, camera, tmp_path):
    with pytest.raises(InputError, match="camera"):
        written(name, tmp_path, rig_of(LENS, "right", camera))
    assert list(tmp_path.iterdir()) == []


def test_one_camera_is_no_pair_and_no_segment_no_mesh(tmp_path):
    with pytest.raises(InputError, match="two cameras"):
        FORMATS["matlab"].save(rig_of(LENS, "a"), tmp_path / "rig.mat")
    with pytest.raises(InputError, match="no 3-D segment"):
        FORMATS["gltf"].save(bench_matches(0), tmp_path / "lines.glb")


@pytest.mark.parametrize("name", [n for n, each in FORMATS.items() if each.holds])
def test_numbers_that_are_not_finite_do_not_leave(name, tmp_path):
    form = FORMATS[name]
    if "segments" in form.holds:
        with pytest.raises(InputError, match="not finite"):
            Segments.from_endpoints(np.array([[0, 0, np.nan, 1]]))
        return
    if "matches" in form.holds:
        lines = np.full((12, 2, 3), np.nan)
        value = eqx.tree_at(lambda matches: matches.lines_mm, bench_matches(), lines)
    elif "wireframe" in form.holds:
        vertices = np.full((7, 3), np.nan)
        value = eqx.tree_at(lambda frame: frame.vertices_mm, made_wireframe(), vertices)
    else:
        value = Rig(
            dict(RIG.items()), parameters=("upper.pan_deg",), covariance=np.full((1, 1), np.nan)
        )
    path = place_of(form, tmp_path, "matches" if "matches" in form.holds else "rig")
    with pytest.raises(InputError, match="not finite"):
        form.save(value, path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("unit", [0.0, -1.0, float("nan"), float("inf")])
def test_units_are_lengths(unit, tmp_path):
    with pytest.raises(InputError, match="must be the length of a unit"):
        FORMATS["opencv"].save(RIG, tmp_path / "rig.yml", unit_mm=unit)


@pytest.mark.parametrize(
    ("name", "message"), [("kalibr", "by definition"), ("tf", "by definition")]
)
def test_a_unit_that_a_format_fixes_is_not_the_caller_s(name, message, tmp_path):
    with pytest.raises(InputError, match=message):
        FORMATS[name].save(RIG, place_of(FORMATS[name], tmp_path), unit_mm=1.0)
    with pytest.raises(InputError, match="contains no lengths"):
        FORMATS["lsd"].load(__file__, unit_mm=1.0)


def test_what_is_lost_is_said_only_where_there_is_something_to_lose():
    everything = FORMATS["kalibr"].lost(RIG)
    assert len(everything) == 4
    assert LOSSES["covariance"] in everything
    plain = rig_of(Intrinsics(focal_length_px=900.0, image_size_px=(640, 480)))
    assert FORMATS["opencv"].lost(plain) == ()
    assert FORMATS["opencv"].lost(LENS) == (LOSSES["pixel pitch"],)
    assert FORMATS["csv"].lost(bench_matches()) == ()
    assert LOSSES["covariance"] in FORMATS["obj"].lost(bench_matches())
    segments = Segments.from_endpoints(np.array([[0.0, 0, 9, 9]]))
    assert FORMATS["lsd"].lost(segments) == (LOSSES["covariance"],)


def test_only_written_formats_are_not_read(tmp_path):
    with pytest.raises(InputError, match="only written"):
        FORMATS["ply"].load(tmp_path)


@pytest.mark.parametrize("name", [n for n, each in FORMATS.items() if each.reads])
@settings(max_examples=25)
@given(content=st.binary(max_size=200) | st.text(max_size=80).map(str.encode))
def test_any_other_content_is_an_input_error(name, content, tmp_path_factory):
    form = FORMATS[name]
    folder = tmp_path_factory.mktemp("any")
    path = folder / f"rig{(form.endings or ('.bin',))[-1]}"
    if form.place == "folder":
        path = folder
        for file in ("cameras.bin", "images.bin"):
            (folder / file).write_bytes(content)
    else:
        path.write_bytes(content)
    try:
        value = form.load(path, lenses={"a": LENS})
    except InputError as error:
        problem = str(error)
    else:  # a few numbers in rows are segments
        assert isinstance(value, Segments)
        return
    assert "\n" not in problem
    assert str(path) in problem


# Each file of MATLAB's takes a child process; `test_mat_file.py` damages these.
IN_PROCESS = [n for n in OF_CAMERAS if FORMATS[n].place == "file" and n != "matlab"]


@pytest.mark.parametrize("name", IN_PROCESS)
@settings(max_examples=40)
@given(
    offset=st.integers(0, 10**6), removed_count=st.integers(0, 9), inserted=st.binary(max_size=4)
)
def test_a_damaged_file_is_a_rig_or_an_input_error(
    name, offset, removed_count, inserted, tmp_path_factory
):
    path = written(name, tmp_path_factory.mktemp("damaged"))
    content = path.read_bytes()
    offset %= len(content)
    path.write_bytes(content[:offset] + inserted + content[offset + removed_count :])
    try:
        value = FORMATS[name].load(path, lenses=dict.fromkeys(RIG, LENS))
    except InputError as error:
        problem = str(error)
    else:
        assert isinstance(value, Rig)
        return
    assert "\n" not in problem


# (format, a word of what is written, what stands there instead, what the sentence says).
SPOILT = [
    ("opencv", r"image_width: 512", "image_width: 0", "whole positive pixels"),
    ("opencv", r"image_width: 512", "image_weight: 512", "image_width.* is missing: add the width"),
    ("opencv", r"(camera_matrix:.*\n.*\n.*\n.*\n.*data: \[)[-\d.]+", r"\g<1>-900.0", "positive"),
    ("opencv", r"(camera_matrix:.*\n.*\n.*\n.*\n.*data: \[)[-\d.]+", r"\g<1>.Nan", "finite"),
    ("opencv", r"(R: .*\n.*\n.*\n.*\n.*data: \[)[-\d.]+", r"\g<1>0.5", "no rotation"),
    ("opencv", r"cols: 3\n(.*\n.*data: )\[1.0e-06", r"cols: 3\n\1[-1.0e-06", "is no covariance"),
    ("opencv", r'"right.pan_deg"', '"wrong.pan_deg"', 'no camera "wrong"'),
    ("opencv", r'name: "right"', 'name: "upper"', "the name of an earlier camera"),
    ("kalibr", r"distortion_coeffs: \[[^\]]*\]", "distortion_coeffs: [0.1]", "four of radtan"),
    ("kalibr", r"radtan", "fov", 'lens model "fov"'),
    ("kalibr", r"pinhole", "omni", "trinoc reads pinhole"),
    ("kalibr", r"cam1", "cam5", "the position of cam1"),
    ("kalibr", r"cam1:", "cam0:", "not YAML"),
    ("kalibr", r"intrinsics: \[[^\]]*\]", "intrinsics: [.nan, 1.0, 1.0, 1.0]", "finite"),
    ("kalibr", r"resolution: \[", "resolution: !!python/tuple [", "a tag or an anchor"),
    ("kalibr", r"resolution: \[", "resolution: &a [", "a tag or an anchor"),
    ("kalibr", r"T_cn_cnm1", "T_cam_imu", "T_cn_cnm1"),
    ("kalibr", r"cam1:", "T_cam1_cam0:\n  - [1, 0, 0, 5]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n"
     "  - [0, 0, 0, 1]\ncam1:", "contradicts the chain of poses"),
    ("tf", r'world"', 'upper_optical_frame"', "form a cycle"),
    ("tf", r'(_id: )"right_optical_frame"', r'\1"upper_optical_frame"', "remove one"),
    ("tf", r"w: [-\d.]+", "w: 7.0", "no unit quaternion"),
    ("mrcal", r"LENSMODEL_OPENCV4", "LENSMODEL_CAHVOR", "LENSMODEL_CAHVOR"),
    ("mrcal", r"'imagersize'", "'imagesize'", "imagersize"),
    ("mrcal", r"\[512", "[__import__('os').getcwd()", "not a .cameramodel"),
    ("nerfstudio", r'"OPENCV"', '"EQUIRECTANGULAR"', "EQUIRECTANGULAR"),
    ("nerfstudio", r"images/right", "images/upper", "repeats an earlier one"),
    ("nerfstudio", r'"fl_x": [\d.]+', '"fl_x": NaN', "finite"),
    ("nerfstudio", r'"w":', '"width":', "is missing: add w and h"),
    ("nerfstudio", r'"frames"', '"frame"', "list of frames"),
    ("colmap-text", r"OPENCV 512", "FOV 512", 'lens model "FOV"'),
    ("colmap-text", r"(\n1 OPENCV 512 480 [\d.]+) [\d.]+", r"\1", "11 numbers|7 numbers"),
    ("colmap-text", r" 2 right", " 2 upper", "occurs twice"),
    ("colmap-text", r" 2 right", " 9 right", "which is missing"),
    ("ros", r"plumb_bob", "mirror", 'lens model "mirror"'),
    ("ros", r"distortion_model", "distortion", "distortion_model"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "old", "new", "message"), SPOILT)
def test_a_spoilt_file_is_named_with_what_is_wrong(name, old, new, message, tmp_path):
    path = written(name, tmp_path)
    lenses = {camera_name: camera.intrinsics for camera_name, camera in RIG.items()}
    FORMATS[name].load(path, lenses=lenses)
    changed = 0
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        text = file.read_text()
        spoilt = re.sub(old, new, text)
        changed += spoilt != text
        file.write_text(spoilt)
    assert changed
    with pytest.raises(InputError, match=message) as caught:
        FORMATS[name].load(path, lenses=lenses)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_reflection_is_no_pose(tmp_path):
    FORMATS["nerfstudio"].save(RIG, tmp_path / "rig.json")
    document = json.loads((tmp_path / "rig.json").read_text())
    matrix = np.array(document["frames"][1]["transform_matrix"])
    matrix[:3, 0] *= -1
    document["frames"][1]["transform_matrix"] = matrix.tolist()
    (tmp_path / "rig.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="a reflection"):
        FORMATS["nerfstudio"].load(tmp_path / "rig.json")


def test_rotations_of_single_precision_are_made_rotations(tmp_path):
    FORMATS["nerfstudio"].save(RIG, tmp_path / "rig.json")
    document = json.loads((tmp_path / "rig.json").read_text())
    for frame in document["frames"]:
        single = np.array(frame["transform_matrix"], dtype=np.float32)
        frame["transform_matrix"] = single.tolist()
    (tmp_path / "rig.json").write_text(json.dumps(document))
    for camera in FORMATS["nerfstudio"].load(tmp_path / "rig.json").cameras:
        rotation = np.asarray(camera.cam_from_world)[:, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-14)


def test_coefficients_beyond_ours_must_be_zero(tmp_path):
    FORMATS["opencv"].save(LENS, tmp_path / "lens.json")
    document = json.loads((tmp_path / "lens.json").read_text())
    lens = document["distortion_coefficients"]
    for last in (0.0, 0.1):
        lens["cols"], lens["data"] = 14, [0.1, *[0] * 12, last]
        (tmp_path / "lens.json").write_text(json.dumps(document))
        if last:
            with pytest.raises(InputError, match=r"has tau_y = 0.1, which trinoc's lens"):
                FORMATS["opencv"].load(tmp_path / "lens.json")
        else:
            read = FORMATS["opencv"].load(tmp_path / "lens.json")
            np.testing.assert_array_equal(read.distortion, [0.1, 0, 0, 0, 0])


def test_poses_alone_need_lenses(tmp_path):
    path = written("tf", tmp_path)
    with pytest.raises(InputError, match="contains only poses"):
        FORMATS["tf"].load(path)
    with pytest.raises(InputError, match='no frame of the camera "middle"'):
        FORMATS["tf"].load(path, lenses={"middle": LENS})


def test_cameras_that_nothing_joins_are_no_rig(tmp_path):
    FORMATS["tf"].save(RIG, tmp_path / "tf.json")
    document = json.loads((tmp_path / "tf.json").read_text())
    document["transforms"][0]["header"]["frame_id"] = "elsewhere"
    (tmp_path / "tf.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"different roots \(elsewhere, world\)"):
        FORMATS["tf"].load(tmp_path / "tf.json", lenses=dict.fromkeys(RIG.names, LENS))


def test_pairs_of_matlab_must_share_their_first_camera(tmp_path):
    FORMATS["matlab"].save(RIG, tmp_path / "rig.mat")
    variables = {
        key: value
        for key, value in scipy.io.loadmat(tmp_path / "rig.mat").items()
        if not key.startswith("__")
    }
    spoilt = variables["stereoParams_3"]["CameraParameters1"][0, 0]
    spoilt["IntrinsicMatrix"][0, 0][0, 0] += 1
    scipy.io.savemat(tmp_path / "rig.mat", variables)
    with pytest.raises(InputError, match="differs between pairs"):
        FORMATS["matlab"].load(tmp_path / "rig.mat")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("lsd", "1 2 3\n", "line 1, must be 4 or 5 or 7 numbers"),
        ("elsed", "1 2 3 4\n1 2 nan 4\n", "not finite"),
        ("lsd", "1 2 3 four\n", "line 1"),
        ("limap-segments", "3\n1 2 3 4\n", "must be the number of segments, 1"),
        ("limap-segments", "", "must be the number of segments, 0"),
        ("elsed", "1 2 1 2\n", "two equal ends"),
    ],
)
def test_segments_that_are_none_are_named(name, text, message, tmp_path):
    (tmp_path / "segments.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        FORMATS[name].load(tmp_path / "segments.txt")


def test_lsd_s_other_columns_are_left_out(tmp_path):
    (tmp_path / "lsd.txt").write_text("1.5 2 3 4 2.1 0.125 14.2\n# remark\n5 6 7 8 1 0.125 99\n")
    read = FORMATS["lsd"].load(tmp_path / "lsd.txt")
    ends = [[1.5, 2, 3, 4], [5, 6, 7, 8]]
    np.testing.assert_array_equal(read.endpoints_px.reshape(-1, 4), ends)


def test_names_given_must_be_as_many_and_different(tmp_path):
    path = written("kalibr", tmp_path)
    for names in (("a", "b"), ("a", "b", "b"), ("a", "b", "")):
        with pytest.raises(InputError, match="as many different names"):
            FORMATS["kalibr"].load(path, names=names)
    FORMATS["opencv"].save(LENS, tmp_path / "lens.yml")
    with pytest.raises(InputError, match="omit the names"):
        FORMATS["opencv"].load(tmp_path / "lens.yml", names=("a",))


def test_opencv_says_nothing_of_a_broken_file_and_keeps_its_voice(tmp_path, capfd):
    new = hasattr(cv2.utils, "logging")
    log_level = cv2.utils.logging.getLogLevel if new else cv2.getLogLevel  # pyright: ignore
    before = log_level()
    (tmp_path / "rig.yml").write_text("%YAML:1.0\n---\na: [1,\n")
    with pytest.raises(InputError, match=r"not a file of cv2\.FileStorage"):
        FORMATS["opencv"].load(tmp_path / "rig.yml")
    assert capfd.readouterr().err == ""
    assert log_level() == before


@pytest.mark.parametrize(("module", "extra"), [("pyarrow", "parquet"), ("ruamel.yaml", "export")])
def test_a_library_that_is_missing_is_named_with_its_extra(module, extra, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    chain = written("kalibr", tmp_path)
    use = {
        "parquet": lambda: FORMATS["parquet"].save(bench_matches(), tmp_path / "lines.parquet"),
        "export": lambda: FORMATS["kalibr"].load(chain),
    }[extra]
    with pytest.raises(InputError, match=rf"pip install 'trinoc\[{extra}\]'"):
        use()


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    with open(tmp_path / "rig.yaml", "wb") as file:
        file.truncate(17_000_000)
    with pytest.raises(InputError, match="has 17 MB, but"):
        FORMATS["kalibr"].load(tmp_path / "rig.yaml")
