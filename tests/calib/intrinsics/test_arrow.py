"""Eliminating the poses solves the same equations as no elimination."""

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

from trinoc.calib.intrinsics.arrow import ArrowCholesky

ROWS = 20


@pytest.mark.parametrize(("seed", "count"), [(0, 1), (1, 2), (2, 5)])
def test_arrow_cholesky_solves_normal_equations(seed, count):
    generator = np.random.default_rng(seed)
    by_lens = generator.normal(size=(count, ROWS, 9))
    by_motion = generator.normal(size=(count, ROWS, 6))
    right = generator.normal(size=(count, ROWS))

    def residuals(unknowns):
        lens, motions = unknowns
        return jnp.einsum("knq,q->kn", by_lens, lens) + jnp.einsum("kni,ki->kn", by_motion, motions)

    structure = jax.eval_shape(lambda: (jnp.zeros(9), jnp.zeros((count, 6))))
    operator = lx.FunctionLinearOperator(residuals, structure)
    solution = lx.linear_solve(operator, jnp.asarray(right), lx.Normal(ArrowCholesky()))
    dense = np.zeros((count, ROWS, 9 + 6 * count))
    dense[:, :, :9] = by_lens
    for k in range(count):
        dense[k, :, 9 + 6 * k : 15 + 6 * k] = by_motion[k]
    expected, *_ = np.linalg.lstsq(dense.reshape(ROWS * count, -1), right.ravel(), rcond=None)
    found = np.concatenate([solution.value[0], np.asarray(solution.value[1]).ravel()])
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)
