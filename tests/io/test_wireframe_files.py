"""Files of wireframes: the round trip is exact, and other formats contain the edges."""

import dataclasses
import json

import numpy as np
import pytest

import trinoc
from tests.io.made_wireframe import made_wireframe
from trinoc.errors import InputError
from trinoc.io import FORMATS

FRAME = made_wireframe()


def test_what_is_written_is_what_is_read(tmp_path):
    trinoc.save(FRAME, tmp_path / "wireframe.npz")
    for loaded in (
        trinoc.load(tmp_path / "wireframe.npz"),
        trinoc.load(tmp_path / "wireframe.npz"),
    ):
        for field in dataclasses.fields(FRAME):
            written, loaded_values = getattr(FRAME, field.name), getattr(loaded, field.name)
            if field.name == "joint_covariance_mm2":
                for a, b in zip(written, loaded_values, strict=True):
                    np.testing.assert_array_equal(a, b)
            elif isinstance(written, np.ndarray):
                np.testing.assert_array_equal(written, loaded_values)
                assert written.dtype == loaded_values.dtype
            else:
                assert written == loaded_values


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("edges", np.full((7, 2), 7), "names a vertex that is not there"),
        ("part", np.array([0] * 6 + [2]), "leaves a part without a vertex"),
        ("posterior", np.full(7, 1.5), "is no probability"),
        ("face_vertex", np.full(7, -1), "names no vertex"),
        ("joint_covariance_mm2", np.full(225 + 36, np.nan), "is no covariance"),
    ],
)
def test_what_no_wire_frame_has_is_refused(tmp_path, name, value, message):
    file = tmp_path / "wireframe.npz"
    trinoc.save(FRAME, file)
    with np.load(file) as content:
        arrays = dict(content)
    np.savez(tmp_path / "wrong.npz", **{**arrays, name: value})
    with pytest.raises(InputError, match=message):
        trinoc.load(tmp_path / "wrong.npz")


def lines_of(tmp_path, name, ending, **options):
    FORMATS[name].save(FRAME, tmp_path / f"frame{ending}", **options)
    return (tmp_path / f"frame{ending}").read_text().splitlines()


def test_an_obj_has_vertices_edges_and_faces_and_is_a_shape_again(tmp_path):
    rows = [line.split() for line in lines_of(tmp_path, "obj", ".obj")]
    assert [sum(row[0] == kind for row in rows) for kind in "vlf"] == [7, 7, 2]
    assert ["f", "1", "2", "3", "4"] in rows
    # What leaves as a wire frame comes back as a known shape.
    shape = trinoc.io.load_shape(tmp_path / "frame.obj")
    np.testing.assert_allclose(
        sorted(np.linalg.norm(np.diff(shape.edges_mm, axis=1)[:, 0], axis=1)),
        sorted(np.linalg.norm(np.diff(FRAME.lines_mm, axis=1)[:, 0], axis=1)),
    )


def test_a_ply_has_a_row_for_each_element(tmp_path):
    lines = lines_of(tmp_path, "ply", ".ply", unit_mm=1000.0)
    head = lines.index("end_header")
    assert {"element vertex 7", "element face 2", "element edge 7"} <= set(lines[:head])
    vertex = np.array(lines[head + 3].split(), dtype=float)
    np.testing.assert_allclose(vertex[:3], FRAME.vertices_mm[2] / 1000)
    np.testing.assert_allclose(vertex[4], FRAME.covariance_of([2])[0, 0] / 1e6)
    assert lines[head + 8] == "4 0 1 2 3"
    assert len(lines) == head + 1 + 7 + 2 + 7


def test_a_dxf_has_lines_on_layers_and_faces(tmp_path):
    lines = lines_of(tmp_path, "dxf", ".dxf")
    codes = list(zip(lines[::2], lines[1::2], strict=True))
    assert codes.count(("0", "LINE")) == 7
    assert codes.count(("8", "BINOCULAR")) == 2
    assert codes.count(("0", "3DFACE")) == 2


def test_a_face_of_many_corners_is_a_fan_of_triangles(tmp_path):
    loop = np.array([0, 1, 4, 2, 3])
    pentagon = dataclasses.replace(
        FRAME,
        face=np.zeros(5, dtype=int),
        face_vertex=loop,
        **{
            name: getattr(FRAME, name)[:1]
            for name in (
                *("planes", "planes_covariance", "face_chi_square", "face_degrees", "facing"),
            )
        },
    )
    FORMATS["dxf"].save(pentagon, tmp_path / "fan.dxf")
    lines = (tmp_path / "fan.dxf").read_text().splitlines()
    codes = list(zip(lines[::2], lines[1::2], strict=True))
    assert codes.count(("0", "3DFACE")) == 3
    assert [value for code, value in codes if code == "70"] == ["4", "5", "1"]


def test_json_names_everything(tmp_path):
    document = json.loads("\n".join(lines_of(tmp_path, "json", ".json", unit_mm=1000.0)))
    assert [len(document[kind]) for kind in ("vertices", "edges", "faces", "let_go")] == [
        7,
        7,
        2,
        1,
    ]
    assert document["edges"][0]["tracks"] == [0, 1]
    np.testing.assert_allclose(document["edges"][1]["covariance"], FRAME.covariance_mm2[1] / 1e6)
    assert document["faces"][1]["vertices"] == [0, 1, 4]
    with pytest.raises(InputError, match="not a wire frame: choose"):
        FORMATS["limap"].save(FRAME, tmp_path / "tracks")
