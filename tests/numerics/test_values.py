"""Values are read-only and equal by content; the caller's arrays stay unchanged."""

import copy
import dataclasses
import pickle
from typing import Any

import jax
import numpy as np
import pytest

import trinoc
from tests.io.formats.bench import bench_matches
from trinoc.errors import InputError
from trinoc.io.demo import demo_pattern
from trinoc.numerics.values import Value, equal_values
from trinoc.synth import table1_rig

RIG = table1_rig()
ENDS = np.random.default_rng(2).uniform(20, 400, (9, 4))
LENS = trinoc.Intrinsics(
    focal_length_px=900.0, image_size_px=(640, 480), distortion=(-0.1, 0.02), distortion_model=None
)
CHARUCO = trinoc.Charuco(rows=5, columns=7, square_mm=30.0)
VALUES: list[Any] = [
    RIG,
    LENS,
    RIG["left"],
    demo_pattern(),
    CHARUCO,
    bench_matches(),
    trinoc.Segments.from_endpoints(ENDS),
    trinoc.Rig(dict(RIG.items()), parameters=("left.pan_deg",), covariance=np.array([[0.25]])),
]


def arrays_of(value: Any) -> list[np.ndarray]:
    return [leaf for leaf in jax.tree.leaves(value) if isinstance(leaf, np.ndarray)]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_no_array_of_a_value_can_be_written_to(value: Any) -> None:
    for array in arrays_of(value):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = array


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_a_value_equals_its_copies_and_no_other(value: Any) -> None:
    for same in (
        value,
        copy.copy(value),
        copy.deepcopy(value),
        pickle.loads(pickle.dumps(value)),
        jax.tree.map(np.copy, value),
    ):
        assert value == same
        assert hash(value) == hash(same)
    others = [other for other in VALUES if other is not value]
    assert all(value != other for other in others)
    assert value != "a word"
    for k, array in enumerate(jax.tree.leaves(value)):
        if isinstance(array, np.ndarray) and array.dtype.kind == "f" and np.isfinite(array).any():
            leaves, structure = jax.tree.flatten(value)
            leaves[k] = array + 1.0
            assert jax.tree.unflatten(structure, leaves) != value


def test_unknown_numbers_equal_each_other_alone() -> None:
    assert equal_values(np.array([np.nan, 1.0]), np.array([np.nan, 1.0]))
    assert not equal_values(np.array([np.nan, 1.0]), np.array([np.nan, 2.0]))
    assert equal_values({"a": (np.nan, "b")}, {"a": (np.nan, "b")})
    assert not equal_values({"a": np.nan}, {"b": np.nan})
    assert not equal_values((1, 2), (1, 2, 3))
    matches = bench_matches()
    assert np.isnan(matches.fragments_px).any() or (matches.index >= 0).all()
    assert dataclasses.replace(matches, posterior=matches.posterior / 2) != matches
    assert dataclasses.replace(matches, views=matches.views[::-1]) != matches


def test_the_maker_s_arrays_stay_writable_and_are_not_copied() -> None:
    covariance = np.zeros((4, 4))
    rig = trinoc.Rig(dict(RIG.items()), parameters=tuple("abcd"), covariance=covariance)
    covariance[0, 0] = 1.0
    assert np.shares_memory(rig.covariance, covariance)
    assert not np.asarray(rig.covariance).flags.writeable
    with pytest.raises(dataclasses.FrozenInstanceError):
        rig.names = ()


def test_a_file_of_something_else_is_not_overwritten(tmp_path) -> None:
    file = tmp_path / "rig.json"
    trinoc.save(RIG, file)
    trinoc.save(RIG, file)
    before = file.read_bytes()
    for value in (demo_pattern(), LENS):
        with pytest.raises(
            InputError,
            match=r"rig\.json exists and contains a file of trinoc-rig.*"
            "overwrite=True",
        ):
            trinoc.save(value, file)
    assert file.read_bytes() == before
    trinoc.save(LENS, file, overwrite=True)
    assert trinoc.load(file) == LENS
    table = tmp_path / "matches.npz"
    trinoc.save(bench_matches(), table)
    with pytest.raises(InputError, match="contains a file of trinoc-matches"):
        trinoc.save(trinoc.Segments.from_endpoints(ENDS), table)
    assert trinoc.load(table) == bench_matches()


def test_values_stay_values_inside_a_trace() -> None:
    """Inside `jit` the arrays are JAX's, and the result of `==` is an array of JAX, too."""
    twice = jax.jit(lambda lens: jax.tree.map(lambda leaf: 2 * leaf, lens))(LENS)
    assert isinstance(twice, Value)
    assert bool(jax.jit(lambda a, b: a == b)(LENS, LENS))
