"""Metashape's cameras image a point where the equations of its manual have it."""

import numpy as np
import pytest

from tests.io.formats.metashape import CHUNK, LENS, cameras_xml
from tests.io.formats.strategies import pixels
from trinoc.errors import InputError
from trinoc.io import FORMATS

SAME = {"rtol": 0, "atol": 1e-9}


def load(tmp_path, unit_mm=None, **options):
    path = tmp_path / "cameras.xml"
    path.write_text(cameras_xml(**options))
    return FORMATS["metashape"].load(path, unit_mm=unit_mm)


def pixel(x, y, radial):
    """The manual's frame camera with the numbers of `LENS`, centres of pixels at whole numbers."""
    r2, (p1, p2) = x * x + y * y, (0.004, -0.003)
    u = x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    v = y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    u, v = 600 + 12.5 + u * 1000 + u * 3 + v * -2, 400 - 7.25 + v * 1000
    return u - 0.5, v - 0.5


def test_a_point_lies_where_the_manual_says(tmp_path):
    """The file has Agisoft's order of p1 and p2, affinity, skew, and a chunk's motion and scale."""
    x, y, depth = 0.3, -0.2, 0.8
    in_camera = np.array([x, y, 1.0]) * depth
    # The camera's quarter turn takes (x, y) to (-y, x), and so does the chunk's.
    in_chunk = np.array([-in_camera[1] + 2, in_camera[0] - 1, in_camera[2] + 0.5])
    in_world_m = 4 * np.array([-in_chunk[1], in_chunk[0], in_chunk[2]]) + (10, 20, 30)
    rig = load(tmp_path)
    assert rig.names == ("left.jpg",)
    camera = rig["left.jpg"]
    assert camera.image_size_px == (1200, 800)
    r2 = x * x + y * y
    expected = pixel(x, y, 1 - 0.1 * r2 + 0.02 * r2**2 + 0.005 * r2**3)
    np.testing.assert_allclose(pixels(camera, 1000 * in_world_m[None])[0], expected, **SAME)
    in_component = f'<components><component id="7" label="C">{CHUNK}</component></components>'
    text = cameras_xml(chunk=in_component).replace("<camera ", '<camera component_id="7" ')
    (tmp_path / "cameras.xml").write_text(text)
    assert FORMATS["metashape"].load(tmp_path / "cameras.xml") == rig


def test_a_picture_that_is_turned_when_shown_is_read_as_stored(tmp_path):
    """Real exports have opposite axes of cameras with the orientations 6 and 8."""
    rig = load(tmp_path)
    text = cameras_xml().replace("<orientation>1<", "<orientation>6<")
    (tmp_path / "cameras.xml").write_text(text)
    assert FORMATS["metashape"].load(tmp_path / "cameras.xml") == rig


def test_a_fisheye_counts_by_the_angle(tmp_path):
    """Metashape's polynomial in the angle is Kannala and Brandt's."""
    lens = LENS.replace("<p1>0.004</p1> <p2>-0.003</p2>", "<k4>-0.001</k4>")
    camera = load(tmp_path, lens=lens, kind="fisheye", motion="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
                  chunk="", unit_mm=1.0).cameras[0]  # fmt: skip
    x, y = 1.2, -0.9
    r = np.hypot(x, y)
    angle = np.arctan(r)
    radius = angle * (1 - 0.1 * angle**2 + 0.02 * angle**4 + 0.005 * angle**6 - 0.001 * angle**8)
    u, v = x * radius / r, y * radius / r
    expected = 612.5 - 0.5 + 1003 * u - 2 * v, 392.75 - 0.5 + 1000 * v
    np.testing.assert_allclose(pixels(camera, np.array([[x, y, 1.0]]))[0], expected, **SAME)


def test_an_export_without_a_scale_needs_a_unit(tmp_path):
    with pytest.raises(InputError, match="the unit is unknown: scale the chunk"):
        load(tmp_path, chunk="")
    in_mm, in_metres = (load(tmp_path, chunk="", unit_mm=unit).cameras[0] for unit in (1.0, 1000.0))
    np.testing.assert_allclose(in_metres.centre_world_mm, 1000 * in_mm.centre_world_mm, rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"head": '<!DOCTYPE a [<!ENTITY b "b">]>'}, "declarations"),
        ({"head": "<"}, "is not XML"),
        ({"kind": "spherical"}, 'lens model "spherical"'),
        ({"kind": "fisheye"}, "p1 = 0.004"),
        ({"lens": LENS.replace("<f>1000</f>", "")}, "focal lengths 3 and 0"),
        ({"lens": LENS.replace("1000", "x")}, 'f" is "x", but must be a number'),
        ({"lens": LENS.replace('"1200"', '"0"')}, "whole positive pixels"),
        ({"motion": "1 0 0"}, "transform"),
        ({"chunk": CHUNK.replace(">4<", ">-4<")}, "scale"),
        ({"camera": "<master_id>0</master_id>"}, "relative to another camera"),
    ],
)
def test_what_is_no_camera_is_named(options, message, tmp_path):
    with pytest.raises(InputError, match=message) as caught:
        load(tmp_path, **options)
    assert str(tmp_path) in str(caught.value)


def test_the_format_is_not_written(tmp_path):
    rig = load(tmp_path)
    with pytest.raises(InputError, match="only read"):
        FORMATS["metashape"].save(rig, tmp_path / "again.xml")
