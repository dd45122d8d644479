"""The readers of other tools find every 3-D segment, end to end."""

import csv
import json

import numpy as np
import pytest

from tests.io.formats.bench import bench_matches
from trinoc.io import FORMATS

MATCHES = bench_matches()
ENDS = MATCHES.lines_mm


@pytest.fixture
def written(tmp_path):
    def write(name, ending, **more):
        path = tmp_path / f"lines{ending}"
        FORMATS[name].save(MATCHES, path, **more)
        return path

    return write


def test_plyfile_reads_edges_with_their_covariance(written):
    plyfile = pytest.importorskip("plyfile", reason="plyfile is not installed")
    data = plyfile.PlyData.read(str(written("ply", ".ply")))
    vertex = data["vertex"]
    points = np.stack([vertex[axis] for axis in "xyz"], axis=1)
    edges = np.stack([data["edge"]["vertex1"], data["edge"]["vertex2"]], axis=1)
    np.testing.assert_array_equal(points[edges], ENDS)
    np.testing.assert_array_equal(data["edge"]["posterior"], MATCHES.posterior)
    np.testing.assert_array_equal(data["edge"]["trinocular"] == 1, MATCHES.stage == "trinocular")
    np.testing.assert_array_equal(data["edge"]["cov_x1_z2"], MATCHES.covariance_mm2[:, 0, 5])


def test_obj_has_a_line_for_each_track(written):
    rows = [line.split() for line in written("obj", ".obj").read_text().splitlines()]
    points = np.array([list(map(float, fields[1:])) for fields in rows if fields[0] == "v"])
    lines = np.array([list(map(int, fields[1:])) for fields in rows if fields[0] == "l"])
    np.testing.assert_array_equal(points[lines - 1], ENDS)


def test_the_unit_of_a_format_without_one_is_the_caller_s(written):
    rows = written("obj", ".obj", unit_mm=25.4).read_text().splitlines()
    first = [float(word) for word in rows[1].split()[1:]]
    np.testing.assert_allclose(np.array(first) * 25.4, ENDS[0, 0], rtol=1e-14)


@pytest.mark.parametrize("ending", [".glb", ".gltf"])
def test_trimesh_reads_gltf_in_metres_with_y_up(written, ending):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    scene = trimesh.load(str(written("gltf", ending)))
    (path,) = scene.geometry.values()
    # It takes the lines of a primitive for one polyline; every second piece of it is a segment.
    (polyline,) = path.entities
    x, y, z = np.asarray(path.vertices)[polyline.points].T * 1000
    ends = np.stack([x, -z, y], axis=1).reshape(-1, 2, 3)
    np.testing.assert_allclose(ends, ENDS, rtol=0, atol=1e-5)


def test_gltf_says_how_it_is_laid_out(written):
    document = json.loads(written("gltf", ".gltf").read_text())
    assert document["meshes"][0]["primitives"][0]["mode"] == 1
    assert document["accessors"][0]["count"] == 2 * len(MATCHES)


def test_ezdxf_reads_lines_on_layers(written):
    ezdxf = pytest.importorskip("ezdxf", reason="ezdxf is not installed")
    drawing = ezdxf.readfile(str(written("dxf", ".dxf")))
    lines = list(drawing.modelspace().query("LINE"))
    ends = np.array([[tuple(line.dxf.start), tuple(line.dxf.end)] for line in lines])
    np.testing.assert_array_equal(ends, ENDS)
    layers = [line.dxf.layer.lower() for line in lines]
    assert layers == list(MATCHES.stage)
    assert not drawing.audit().has_errors


def test_csv_holds_every_number_to_its_last_digit(written):
    with open(written("csv", ".csv"), encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    columns = MATCHES.named_columns()
    assert list(rows[0]) == list(columns)
    for name, column in columns.items():
        read = [row[name] for row in rows]
        if column.dtype.kind == "f":
            numbers = np.array([float(word) if word else np.nan for word in read])
            np.testing.assert_array_equal(numbers, column)
        else:
            assert read == [str(item) for item in column]
    assert sum(name.startswith("cov_") for name in columns) == 21
    assert float(rows[3]["cov_y1_x2_mm2"]) == MATCHES.covariance_mm2[3, 1, 3]


def test_pyarrow_reads_the_same_table(written):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    table = parquet.read_table(str(written("parquet", ".parquet")))
    for name, column in MATCHES.named_columns().items():
        np.testing.assert_array_equal(table[name].to_numpy(), column)


def test_limap_s_tracks_have_the_layout_of_its_reader(tmp_path):
    FORMATS["limap"].save(MATCHES, tmp_path / "tracks")
    files = list((tmp_path / "tracks").iterdir())
    assert len(files) == len(MATCHES)
    for track in range(len(MATCHES)):
        fields = iter((tmp_path / "tracks" / f"track_{track}.txt").read_text().split())
        ends = np.array([float(next(fields)) for _ in range(6)]).reshape(2, 3)
        np.testing.assert_array_equal(ends, ENDS[track])
        count, images = int(next(fields)), int(next(fields))
        assert count == images == (MATCHES.index[track] >= 0).sum()
        assert next(fields) == "image_id_list"
        views = [int(next(fields)) for _ in range(count)]
        assert next(fields) == "line_id_list"
        assert [int(next(fields)) for _ in range(count)] == MATCHES.index[track, views].tolist()
        assert next(fields) == "line2d_list"
        fragments = np.array([float(next(fields)) for _ in range(4 * count)]).reshape(-1, 2, 2)
        np.testing.assert_allclose(
            fragments - 0.5, MATCHES.fragments_px[track, views], rtol=0, atol=1e-12
        )
        assert list(fields) == ["END"]


@pytest.mark.parametrize(
    ("name", "ending"),
    [("ply", ".ply"), ("obj", ".obj"), ("dxf", ".dxf"), ("csv", ".csv"), ("limap", "")],
)
def test_no_track_is_an_empty_file(tmp_path, name, ending):
    path = tmp_path / f"none{ending}"
    FORMATS[name].save(bench_matches(0), path)
    assert path.exists()
