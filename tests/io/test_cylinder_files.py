"""Cylinders as files: what is written is what is read, and what other tools find in it."""

import dataclasses

import numpy as np
import pytest

import trinoc
from tests.io.formats.bench import bench_matches
from tests.io.made_cylinders import made_cylinders
from trinoc.errors import InputError
from trinoc.io import FORMATS

CYLINDERS = made_cylinders()


def test_what_is_written_is_what_is_read(tmp_path):
    file = tmp_path / "cylinders.npz"
    trinoc.save(CYLINDERS, file)
    for back in (trinoc.load(file), trinoc.load(file)):
        for field in dataclasses.fields(CYLINDERS):
            one, other = getattr(CYLINDERS, field.name), getattr(back, field.name)
            if isinstance(one, np.ndarray):
                np.testing.assert_array_equal(one, other)
                assert one.dtype == other.dtype
            else:
                assert one == other


def test_marked_tracks_stay_marked_in_their_file(tmp_path):
    matches = bench_matches()
    silhouette = np.linspace(0.0, 1.0, len(matches))
    marked = matches.with_marks(silhouette=silhouette, shadow=silhouette[::-1])
    trinoc.save(marked, tmp_path / "matches.npz")
    back = trinoc.load_matches(tmp_path / "matches.npz")
    np.testing.assert_array_equal(back.marks["silhouette"], silhouette)
    np.testing.assert_array_equal(back.marks["shadow"], silhouette[::-1])
    trinoc.save(matches, tmp_path / "plain.npz")
    assert trinoc.load_matches(tmp_path / "plain.npz").marks == {}


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("radius_mm", np.array([12.0, 0.0]), "of row 1 is no radius"),
        ("axis_mm", np.full((2, 2, 3), np.nan), "is not finite or beyond all scenes"),
        ("covariance_mm2", np.full((2, 7, 7), np.nan), "is no covariance"),
        ("posterior", np.full(2, 1.5), "is no probability"),
        ("silhouette", np.full(4, -0.5), "is no probability"),
        ("cylinder", np.full(10, 2), "is no cylinder"),
        ("view", np.full(10, 3), "is no view"),
        ("segment", np.full(10, -1), "is no segment"),
        ("side", np.zeros(10, dtype=int), "is no side"),
    ],
)
def test_what_no_cylinders_have_is_refused(tmp_path, name, value, said):
    file = tmp_path / "cylinders.npz"
    trinoc.save(CYLINDERS, file)
    with np.load(file) as content:
        arrays = dict(content)
    np.savez(tmp_path / "wrong.npz", **{**arrays, name: value})
    with pytest.raises(InputError, match=said):
        trinoc.load(tmp_path / "wrong.npz")


def test_wires_lie_on_their_cylinder():
    wires = CYLINDERS.wires()
    for row, (first, second) in enumerate(CYLINDERS.axis_mm):
        way = (second - first) / np.linalg.norm(second - first)
        pairs = wires.pairs[wires.owner == row]
        for place in wires.places_mm[pairs.ravel()]:
            off = np.linalg.norm(np.cross(place - first, way))
            np.testing.assert_allclose(off, CYLINDERS.radius_mm[row])
            along = (place - first) @ way
            assert -1e-9 < along < np.linalg.norm(second - first) + 1e-9
        # Both circles come first, and are closed.
        for rim in (pairs[:48], pairs[48:96]):
            closed = wires.places_mm[[rim[0, 0], rim[-1, 1]]]
            np.testing.assert_array_equal(*closed)


@pytest.mark.parametrize("unit_mm", [None, 1000.0])
def test_an_obj_and_a_ply_have_the_same_wires(tmp_path, unit_mm):
    pieces = 2 * (2 * 48 + 4)
    unit = unit_mm or 1.0
    texts = {}
    for name in ("obj", "ply"):
        FORMATS[name].save(CYLINDERS, tmp_path / f"c.{name}", unit_mm=unit_mm)
        texts[name] = (tmp_path / f"c.{name}").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in texts["obj"] if line[0] == "v"], dtype=float)
    lines = [line.split()[1:] for line in texts["obj"] if line[0] == "l"]
    assert len(lines) == pieces
    assert f"element edge {pieces}" in texts["ply"]
    body = texts["ply"][texts["ply"].index("end_header") + 1 :]
    same = np.array([row.split() for row in body[: len(vertices)]], dtype=float)
    np.testing.assert_array_equal(same, vertices)
    edges = np.array([row.split() for row in body[len(vertices) :]], dtype=float)
    np.testing.assert_array_equal(edges[:, :2] + 1, np.array(lines, dtype=float))
    head = texts["ply"][texts["ply"].index(f"element edge {pieces}") :]
    names = [line.split()[-1] for line in head if line.startswith("property")]
    own = CYLINDERS.radius_mm[edges[:, names.index("cylinder")].astype(int)] / unit
    np.testing.assert_array_equal(edges[:, names.index("radius")], own)
    ends = vertices[np.array(lines, dtype=int) - 1]
    assert (np.linalg.norm(np.diff(ends, axis=1), axis=2) > 0).all()
