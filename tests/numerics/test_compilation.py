"""Threads that need the same program compile it once."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trinoc.numerics.programs import compile_once


def test_a_program_is_traced_once_however_many_threads_want_it() -> None:
    traced = []

    @jax.jit
    def double(values):
        traced.append(1)
        return 2 * values

    together = Barrier(4)

    def ask(k: int) -> float:
        together.wait(timeout=30)
        with compile_once("double of this test"):
            return float(double(jnp.asarray(float(k))))

    with ThreadPoolExecutor(4) as threads:
        answers = list(threads.map(ask, range(4)))
    np.testing.assert_array_equal(answers, [0, 2, 4, 6])
    assert len(traced) == 1


def test_a_block_that_fails_leaves_the_next_one_free() -> None:
    with pytest.raises(ValueError, match="no program"), compile_once("fails"):
        raise ValueError("no program")
    done = []
    with compile_once("fails"):
        done.append(1)
    assert done
