"""Results are bit-identical across repeats, threads, number types and JAX's settings."""

from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import pytest

import trinoc
from tests.match.made import loose_lines, pictures, rig_of

RIG = rig_of("upper", "right", "left")


@pytest.fixture(scope="module")
def pictures_px():
    return {n: e.reshape(-1, 4) for n, e in pictures(RIG, loose_lines(30, 3), 0.3, seed=4).items()}


def bytes_of(value):
    """All arrays of a value, as bytes, with their types and shapes."""
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(value)]
    return [(a.dtype.str, a.shape, a.tobytes()) for a in arrays]


def test_a_match_is_the_same_again_and_in_threads(pictures_px):
    once = bytes_of(trinoc.match_segments(pictures_px, RIG))
    assert bytes_of(trinoc.match_segments(pictures_px, RIG)) == once
    with ThreadPoolExecutor(3) as pool:
        others = [pool.submit(trinoc.match_segments, pictures_px, RIG) for _ in range(6)]
    assert all(bytes_of(other.result()) == once for other in others)


def test_a_match_does_not_depend_on_the_caller_s_precision(pictures_px):
    once = bytes_of(trinoc.match_segments(pictures_px, RIG))
    with jax.enable_x64(False):
        assert bytes_of(trinoc.match_segments(pictures_px, RIG)) == once


def test_ends_in_single_precision_are_those_numbers_in_double(pictures_px):
    single = {name: ends.astype(np.float32) for name, ends in pictures_px.items()}
    double = {name: ends.astype(np.float64) for name, ends in single.items()}
    rounded = trinoc.match_segments(double, RIG)
    assert bytes_of(trinoc.match_segments(single, RIG)) == bytes_of(rounded)
    # Rounding ends to single precision moves them by 2^-24 of 512 px at most, and lines with them.
    exact = trinoc.match_segments(pictures_px, RIG)
    assert max(np.abs(double[n] - pictures_px[n]).max() for n in pictures_px) <= 512 * 2.0**-24
    np.testing.assert_array_equal(rounded.index, exact.index)
    sigma_mm = np.sqrt(np.diagonal(exact.covariance_mm2, axis1=1, axis2=2))
    moved = np.abs(rounded.lines_mm - exact.lines_mm).reshape(-1, 6)
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
