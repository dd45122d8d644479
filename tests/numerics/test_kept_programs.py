"""Stored programs return what `jax.jit` returns, and are loaded when nothing has changed."""

from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from trinoc.geometry import Pose
from trinoc.numerics import programs
from trinoc.numerics.programs import kept_jit, prefetch_programs, set_program_store
from trinoc.numerics.tails import (
    chi_square_limit,
    chi_square_quantile,
    chi_square_tail,
    normal_limit,
)


class _Drawer(dict[str, bytes]):
    """A store in memory that counts the programs loaded from it."""

    loaded = 0

    def get(self, name: str, modules: frozenset[str] = frozenset()) -> bytes | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        content = super().get(name)
        self.loaded += content is not None
        return content

    def put(self, name: str, content: bytes, modules: frozenset[str] = frozenset()) -> None:
        self[name] = content


@pytest.fixture
def drawer() -> Iterator[_Drawer]:
    drawer = _Drawer()
    before = set_program_store(drawer)
    yield drawer
    set_program_store(before)


def line_up(pose: Pose, by: jax.Array, times: int = 1) -> Pose:
    """A program whose argument and result are values of trinoc, and which calls LAPACK."""
    root = jnp.linalg.cholesky(by @ by.T + 3.0 * jnp.eye(3))
    return Pose(pose.cam_from_world * times + root @ jnp.ones((3, 4)))


@pytest.fixture
def arguments() -> tuple[Pose, np.ndarray]:
    rng = np.random.default_rng(3)
    return Pose(np.eye(3, 4)), rng.normal(size=(3, 3))


def test_a_program_found_again_gives_the_same_bits(drawer, arguments) -> None:
    plain = jax.jit(line_up)(*arguments)
    first = kept_jit(line_up)(*arguments)
    assert len(drawer) == 1
    second = kept_jit(line_up)(*arguments)
    assert drawer.loaded == 1
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(one, other)
    assert isinstance(second, Pose)
    np.testing.assert_array_equal(second.cam_from_world, plain.cam_from_world)


def test_a_prefetched_program_gives_the_same_bits(drawer, arguments) -> None:
    compiled = kept_jit(line_up)(*arguments)
    # A damaged program among them, and one that no function asks for, change nothing.
    with prefetch_programs([b"damaged", *drawer.values()]):
        (content,) = drawer.values()
        assert content in programs._prefetched
        loaded = kept_jit(line_up)(*arguments)
        assert content not in programs._prefetched
    assert not programs._prefetched
    np.testing.assert_array_equal(loaded.cam_from_world, compiled.cam_from_world)


def test_a_program_whose_prefetch_failed_is_compiled(drawer, arguments) -> None:
    compiled = kept_jit(line_up)(*arguments)
    (name,) = drawer
    drawer[name] = b"damaged"
    with prefetch_programs(drawer.values()):
        recompiled = kept_jit(line_up)(*arguments)
    np.testing.assert_array_equal(recompiled.cam_from_world, compiled.cam_from_world)


def test_other_arguments_and_settings_are_other_programs(drawer, arguments) -> None:
    pose, by = arguments
    stored = kept_jit(line_up, static_argnames=("times",))
    stored(pose, by)
    stored(pose, by, times=2)
    stored(pose, np.ones((3, 5)))
    stored(pose=pose, by=by, times=1)
    assert len(drawer) == 3


def doubled(x: jax.Array) -> jax.Array:
    return x + x


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int32])
def test_each_kind_of_number_is_a_program_of_its_own(drawer, kind) -> None:
    others = [k for k in (np.float64, np.float32, np.int32) if k is not kind]
    for other in others:
        kept_jit(doubled)(np.ones(3, other))
    result = kept_jit(doubled)(np.ones(3, kind))
    assert result.dtype == kind
    assert len(drawer) == 3
    # A number of Python takes the kind of what it meets: another program again.
    kept_jit(doubled)(1.0)
    kept_jit(doubled)(np.float64(1.0))
    assert len(drawer) == 5


def test_damage_is_compiled_anew(drawer, arguments) -> None:
    expected = kept_jit(line_up)(*arguments)
    (name,) = drawer
    for damage in (b"", b"poison", drawer[name][:-9]):
        drawer[name] = damage
        result = kept_jit(line_up)(*arguments)
        np.testing.assert_array_equal(result.cam_from_world, expected.cam_from_world)


class OwnLens(eqx.Module):
    """A class of the user, whose methods are not covered by trinoc's version number."""

    strength: jax.Array

    def bend(self, x: jax.Array) -> jax.Array:
        return self.strength * x


def bent(lens: OwnLens, x: jax.Array) -> jax.Array:
    return lens.bend(x)


def test_what_a_user_may_edit_is_not_kept(drawer) -> None:
    lens = OwnLens(jnp.asarray(2.0))
    assert float(kept_jit(bent)(lens, 3.0)) == 6.0
    assert drawer == {}


def test_inside_traces_it_is_jit(drawer, arguments) -> None:
    pose, by = arguments
    stored = kept_jit(line_up)
    gradient = jax.grad(lambda by: jnp.sum(stored(pose, by).cam_from_world))(by)
    expected = jax.grad(lambda by: jnp.sum(line_up(pose, by).cam_from_world))(by)
    np.testing.assert_allclose(gradient, expected, rtol=1e-12)
    np.testing.assert_allclose(jax.jit(lambda x: stored(pose, x).cam_from_world)(by).shape, (3, 4))
    assert drawer == {}


def test_without_a_store_it_is_jit(arguments) -> None:
    before = set_program_store(None)
    try:
        assert isinstance(kept_jit(line_up)(*arguments), Pose)
    finally:
        set_program_store(before)


@given(value=st.floats(0, 500), degrees=st.integers(1, 400), tail=st.floats(1e-12, 1.0))
def test_tails_are_those_of_scipy_stats(value: float, degrees: int, tail: float) -> None:
    assert chi_square_tail(value, degrees) == stats.chi2.sf(value, degrees)
    assert chi_square_limit(tail, degrees) == stats.chi2.isf(tail, degrees)
    assert chi_square_quantile(tail, degrees) == stats.chi2.ppf(tail, degrees)
    assert normal_limit(tail) == stats.norm.isf(tail)
