"""Files of rims: the round trip is exact, and other formats contain the circles."""

import dataclasses

import numpy as np
import pytest

import trinoc
from tests.io.formats.bench import bench_matches
from tests.io.made_rims import made_rims
from trinoc.errors import InputError
from trinoc.io import FORMATS

RIMS = made_rims()


def fields_are_equal(one: object, other: object) -> None:
    for field in dataclasses.fields(one):  # pyright: ignore[reportArgumentType]
        first, second = getattr(one, field.name), getattr(other, field.name)
        if dataclasses.is_dataclass(first):
            fields_are_equal(first, second)
        elif isinstance(first, np.ndarray):
            np.testing.assert_array_equal(first, second)
            assert first.dtype.kind == second.dtype.kind
        elif isinstance(first, dict):
            np.testing.assert_equal(first, second)
        else:
            assert first == second


def test_what_is_written_is_what_is_read(tmp_path):
    file = tmp_path / "rims.npz"
    trinoc.save(RIMS, file)
    for loaded in (trinoc.load(file), trinoc.load(file)):
        fields_are_equal(RIMS, loaded)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("radius_mm", np.array([12.0, 0.0]), "of row 1 is no radius"),
        ("centre_mm", np.full((2, 3), np.nan), "is not finite or beyond all scenes"),
        ("normal", np.full((2, 3), 1.0), "is no unit vector"),
        ("covariance_mm2", np.full((2, 7, 7), np.nan), "is no covariance"),
        ("covered", np.full(2, 1.5), "is no share"),
        ("rim", np.full(5, 2), "is no rim"),
        ("view", np.full(5, 9), "is no view"),
        ("segment", np.full(5, -1), "is no segment"),
        ("kept", np.full(2, -1), "is no track"),
        ("views", np.array(["a", "b"]), "are not those of the matches"),
        ("matches/posterior", np.full(len(RIMS.matches), 2.0), "is no probability"),
    ],
)
def test_what_no_rims_have_is_refused(tmp_path, name, value, message):
    file = tmp_path / "rims.npz"
    trinoc.save(RIMS, file)
    with np.load(file) as content:
        arrays = dict(content)
    np.savez(tmp_path / "wrong.npz", **{**arrays, name: value})
    with pytest.raises(InputError, match=message):
        trinoc.load(tmp_path / "wrong.npz")


def test_an_obj_has_the_circles(tmp_path):
    FORMATS["obj"].save(RIMS, tmp_path / "rims.obj", unit_mm=10.0)
    lines = (tmp_path / "rims.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line[0] == "v"], dtype=float) * 10
    pairs = np.array([line.split()[1:] for line in lines if line[0] == "l"], dtype=int) - 1
    assert len(pairs) == 2 * 48
    for row, circle in enumerate(np.split(vertices, 2)):
        np.testing.assert_array_equal(circle[0], circle[-1])
        spoke = circle - RIMS.centre_mm[row]
        np.testing.assert_allclose(np.linalg.norm(spoke, axis=1), RIMS.radius_mm[row])
        np.testing.assert_allclose(spoke @ RIMS.normal[row], 0.0, atol=1e-9)
    assert (np.linalg.norm(np.diff(vertices[pairs], axis=1), axis=2) > 0).all()


def test_marked_tracks_stay_marked_in_their_file(tmp_path):
    matches = bench_matches()
    silhouette = np.linspace(0.0, 1.0, len(matches))
    trinoc.save(matches.with_marks(silhouette=silhouette), tmp_path / "matches.npz")
    loaded = trinoc.load_matches(tmp_path / "matches.npz")
    np.testing.assert_array_equal(loaded.marks["silhouette"], silhouette)
    trinoc.save(matches, tmp_path / "plain.npz")
    assert trinoc.load_matches(tmp_path / "plain.npz").marks == {}


def test_cylinders_of_before_are_refused_by_name(tmp_path):
    np.savez(tmp_path / "cylinders.npz", format="trinoc-cylinders", version=1)
    with pytest.raises(InputError, match="holds cylinders, which trinoc no longer reads"):
        trinoc.load(tmp_path / "cylinders.npz")
