"""What is promised to be bit-identical is: repeats, threads, number types, JAX's settings."""

from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import pytest

import trinoc
from tests.match.made import loose_lines, pictures, rig_of

RIG = rig_of("upper", "right", "left")


@pytest.fixture(scope="module")
def seen():
    return {n: e.reshape(-1, 4) for n, e in pictures(RIG, loose_lines(30, 3), 0.3, seed=4).items()}


def bytes_of(value):
    """All arrays of a value, as bytes, with their types and shapes."""
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(value)]
    return [(a.dtype.str, a.shape, a.tobytes()) for a in arrays]


def test_a_match_is_the_same_again_and_in_threads(seen):
    once = bytes_of(trinoc.match_segments(seen, RIG))
    assert bytes_of(trinoc.match_segments(seen, RIG)) == once
    with ThreadPoolExecutor(3) as pool:
        others = [pool.submit(trinoc.match_segments, seen, RIG) for _ in range(6)]
    assert all(bytes_of(other.result()) == once for other in others)


def test_a_match_does_not_depend_on_the_caller_s_precision(seen):
    once = bytes_of(trinoc.match_segments(seen, RIG))
    with jax.enable_x64(False):
        assert bytes_of(trinoc.match_segments(seen, RIG)) == once


def test_ends_in_single_precision_are_those_numbers_in_double(seen):
    single = {name: ends.astype(np.float32) for name, ends in seen.items()}
    double = {name: ends.astype(np.float64) for name, ends in single.items()}
    found = trinoc.match_segments(double, RIG)
    assert bytes_of(trinoc.match_segments(single, RIG)) == bytes_of(found)
    # Rounding ends to single precision moves them by 2^-24 of 512 px at most, and lines with them.
    exact = trinoc.match_segments(seen, RIG)
    assert max(np.abs(double[n] - seen[n]).max() for n in seen) <= 512 * 2.0**-24
    np.testing.assert_array_equal(found.index, exact.index)
    sigma_mm = np.sqrt(np.diagonal(exact.covariance_mm2, axis1=1, axis2=2))
    moved = np.abs(found.lines_mm - exact.lines_mm).reshape(-1, 6)
    assert (moved < 1e-3 * sigma_mm).all()


@pytest.fixture(scope="module")
def picture():
    random = np.random.default_rng(5)
    scene = np.kron(random.integers(60, 200, (6, 8)), np.ones((20, 20)))
    return (scene + random.normal(0, 2, scene.shape)).astype(np.uint8)


def test_segments_are_the_same_again_in_threads_and_in_wider_types(picture):
    once = bytes_of(trinoc.find_segments(picture))
    assert len(trinoc.find_segments(picture)) > 5
    with ThreadPoolExecutor(3) as pool:
        others = list(pool.map(trinoc.find_segments, [picture] * 6))
    others.append(trinoc.find_segments(picture.astype(np.uint16)))
    assert all(bytes_of(other) == once for other in others)
