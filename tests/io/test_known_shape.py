"""Known shapes from files: what is written is read, and mistakes are named by their line."""

import json

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as arrays

from trinoc.errors import InputError
from trinoc.io import load_shape
from trinoc.io.demo import demo_folder

NUMBERS = st.floats(-1e4, 1e4, allow_nan=False, width=32)
FEW = settings(max_examples=25)
EDGES = arrays.arrays(
    np.float64, st.tuples(st.integers(1, 6), st.just(2), st.just(3)), elements=NUMBERS
).filter(lambda edges: bool(np.any(edges[:, 0] != edges[:, 1], axis=1).all()))

L_BLOCK = """# corners of an L, below and above
v 0 0 0\nv 4 0 0\nv 4 1 0\nv 1 1 0\nv 1 3 0\nv 0 3 0
v 0 0 2\nv 4 0 2\nv 4 1 2\nv 1 1 2\nv 1 3 2\nv 0 3 2
f 6 5 4 3 2 1
f 7/1/1 8/2/1 9/3/1 10/4/1 11/5/1 12/6/1
f 1 2 8 7\nf 2 3 9 8\nf 3 4 10 9\nf 4 5 11 10\nf 5 6 12 11\nf 6 1 7 12
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("shapes")


def read(folder, name, text, **options):
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return load_shape(file, **options)


@FEW
@given(edges=EDGES, separator=st.sampled_from([",", " ", "; ", "\t"]), head=st.booleans())
def test_rows_of_edges(folder, edges, separator, head):
    rows = [separator.join(map(repr, row.tolist())) for row in edges.reshape(-1, 6)]
    text = "\n".join(["# made up", *(["x1,y1,z1,x2,y2,z2"] if head else []), *rows, ""])
    np.testing.assert_array_equal(read(folder, "edges.csv", text).edges_mm, edges)


@FEW
@given(edges=EDGES, form=st.sampled_from(["list", "flat", "edges_mm", "edges"]))
def test_json_of_edges(folder, edges, form):
    entries = edges.reshape(-1, 6).tolist() if form == "flat" else edges.tolist()
    document = {form: entries} if form.startswith("edges") else entries
    shape = read(folder, "edges.json", json.dumps(document))
    np.testing.assert_array_equal(shape.edges_mm, edges)
    np.testing.assert_allclose(shape.wanted_mm, edges, atol=1e-8)


@FEW
@given(edges=EDGES)
def test_obj_polylines_are_edges(folder, edges):
    points = [f"v {x!r} {y!r} {z!r}" for x, y, z in edges.reshape(-1, 3).tolist()]
    links = [f"l {2 * i + 1} {2 * i + 2}" for i in range(len(edges))]
    loaded = read(folder, "lines.obj", "\n".join([*points, *links])).edges_mm
    # Vertices closer than a ten-millionth of the model's size are one.
    size = max(np.ptp(edges.reshape(-1, 3), axis=0).max(), 1e-30)
    if len(loaded) == len(edges):
        np.testing.assert_allclose(loaded, edges, atol=1e-6 * size)
    else:
        lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
        assert lengths.min() < 1e-6 * size


def test_units(folder):
    shape = read(folder, "inch.csv", "0 0 0 1 0 0\n", unit_mm=25.4)
    np.testing.assert_array_equal(shape.edges_mm, [[[0, 0, 0], [25.4, 0, 0]]])
    obj = read(folder, "metre.obj", L_BLOCK, unit_mm=1000.0)
    assert obj.edges_mm.max() == obj.triangles_mm.max() == 4000.0


def test_polylines_run_straight_on(folder):
    square = "0 0 0\n5 0 0\n10 0 0\n10 10 0\n0 10 0\n0 4 0\n0 0 0\n"
    separate_polyline = "\n20,0,0\n21,0,0\n22,0,1e-7\n"
    edges = read(folder, "polylines.txt", square + "\n" + separate_polyline).edges_mm
    assert sorted(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).round(6)) == [2, 10, 10, 10, 10]


def test_a_polyline_that_turns_back_is_two_edges(folder):
    edges = read(folder, "back.txt", "0 0 0\n10 0 0\n4 0 0\n").edges_mm
    np.testing.assert_array_equal(edges[:, :, 0], [[0, 10], [10, 4]])


def test_a_closed_polyline_may_begin_within_an_edge(folder):
    edges = read(folder, "from_middle.txt", "5 0 0\n10 0 0\n10 9 0\n0 9 0\n0 0 0\n5 0 0\n").edges_mm
    assert sorted(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)) == [9, 9, 10, 10]


def test_chords_of_a_circle_stay(folder):
    angle = np.linspace(0, 2 * np.pi, 181)
    rows = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    text = "\n".join(" ".join(f"{x:.9f}" for x in row) for row in rows)
    assert len(read(folder, "circle.txt", text).edges_mm) == 180


def area(triangles):
    sides = triangles[:, 1:] - triangles[:, :1]
    return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2


def test_obj_creases_and_faces(folder):
    shape = read(folder, "l.obj", L_BLOCK)
    assert len(shape.edges_mm) == 18
    assert area(shape.triangles_mm) == pytest.approx(2 * 6 + 14 * 2)


@pytest.mark.parametrize("flip", [False, True])
def test_flat_seams_are_no_edges_whichever_way_faces_are_wound(folder, flip):
    # A square of two triangles, each with its own vertices, as exporters write them.
    second = "f 4 6 5" if flip else "f 4 5 6"
    text = f"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\n{second}\n"
    shape = read(folder, "square.obj", text)
    assert len(shape.edges_mm) == 4
    assert area(shape.triangles_mm) == pytest.approx(1.0)


def test_the_crease_angle_decides(folder):
    roof = "v 0 0 0\nv 0 4 0\nv 3 0 1\nv 3 4 1\nv 6 0 0\nv 6 4 0\nf -6 -4 -3 -5\nf -4 -2 -1 -3\n"
    # The faces turn by twice atan(1/3), 36.9 degrees.
    assert len(read(folder, "roof.obj", roof, crease_deg=36.0).edges_mm) == 7
    assert len(read(folder, "roof.obj", roof, crease_deg=38.0).edges_mm) == 6


def test_creases_in_pieces_are_one_edge(folder):
    # Two squares upright on two quarters of a strip: the crease between has a vertex in its middle.
    text = (
        "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 1 1 0\nv 2 1 0\nv 0 0 1\nv 1 0 1\nv 2 0 1\n"
        "f 1 2 5 4\nf 2 3 6 5\nf 1 2 8 7\nf 2 3 9 8\n"
    )
    edges = read(folder, "strip.obj", text).edges_mm
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    assert sorted(lengths) == [1, 1, 1, 1, 2, 2, 2]


def test_truth_of_a_made_scene(tmp_path):
    shape = load_shape(demo_folder() / "truth.json")
    assert "two pictures" in shape.wanted
    assert len(load_shape(demo_folder() / "truth.json", grey_step=60.0).wanted_edge) < len(
        shape.wanted_edge
    )
    with pytest.raises(InputError, match="millimetres already"):
        load_shape(demo_folder() / "truth.json", unit_mm=10.0)


REFUSED = {
    "a word among numbers": ("a.csv", "0 0 0 1 1 1\n0 0 x 1 1 1\n", "line 2: these are not all"),
    "not finite": ("a.csv", "0 0 0 1 1 nan\n", "line 1: these are not all finite"),
    "four numbers": ("a.csv", "0 0 0 1\n", "line 1: there are 4 numbers instead of three or six"),
    "rows that differ": ("a.txt", "0 0 0 1 1 1\n0 0 0\n", "line 2: there are 3 numbers"),
    "no length": ("a.csv", "\n1 2 3 1 2 3\n", "line 2: the edge has no length"),
    "nothing": ("a.txt", "# nothing\n", "holds no edge"),
    "one point": ("a.txt", "1 2 3\n", "holds no edge"),
    "broken json": ("a.json", "[[0, 0, 0,", "is not JSON (line 1"),
    "json of a text": ("a.json", '"edges"', "contains no list of edges"),
    "json without edges": ("a.json", "{}", "contains no list of edges"),
    "json of points": ("a.json", "[[[0,0,0],[1,1,1]], [[0,0,0]]]", "edge 1 of the list"),
    "json, no length": ("a.json", "[[0,0,0,0,0,0]]", "edge 0 of the list"),
    "a vertex of two": ("a.obj", "v 0 0 0\nv 1 1\n", "line 2: a vertex needs three"),
    "no such vertex": ("a.obj", "v 0 0 0\nl 1 2\n", 'line 2: "2" names none of the 1 vertices'),
    "vertex zero": ("a.obj", "v 0 0 0\nv 1 0 0\nl 0 1\n", "line 3"),
    "a face of two": ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3: 2 corners are too few"),
    "after a long line": ("a.obj", "v 0 0 \\\n0\nv 1 0\n", "line 3: a vertex"),
    "smooth": ("a.obj", "v 0 0 0\nv 1 0 0\n", "holds no edge"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_mistakes_are_named(folder, case):
    name, text, message = REFUSED[case]
    with pytest.raises(InputError) as caught:
        read(folder, name, text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_not_there_or_no_text(folder):
    with pytest.raises(InputError, match="does not exist"):
        load_shape(folder / "none.obj")
    (folder / "picture.csv").write_bytes(b"\x89PNG\xff\xfe\x00")
    with pytest.raises(InputError, match="no text file"):
        load_shape(folder / "picture.csv")
    with pytest.raises(InputError, match="must be positive"):
        read(folder, "a.csv", "0 0 0 1 1 1\n", unit_mm=0.0)
