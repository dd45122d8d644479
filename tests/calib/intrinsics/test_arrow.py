"""Eliminating the poses solves the same equations as no elimination."""

import jax.numpy as jnp
import lineax as lx
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from trinoc.calib.intrinsics.arrow import ArrowCholesky


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.integers(1, 5))
def test_arrow_cholesky_solves_normal_equations(seed, count):
    generator = np.random.default_rng(seed)
    by_lens = generator.normal(size=(count, 20, 9))
    by_motion = generator.normal(size=(count, 20, 6))
    right = generator.normal(size=(count, 20))

    def residuals(unknowns):
        lens, motions = unknowns
        return jnp.einsum("knq,q->kn", by_lens, lens) + jnp.einsum("kni,ki->kn", by_motion, motions)

    shape = (jnp.zeros(9), jnp.zeros((count, 6)))
    operator = lx.FunctionLinearOperator(residuals, jnp_structure(shape))
    solution = lx.linear_solve(operator, jnp.asarray(right), lx.Normal(ArrowCholesky()))
    dense = np.zeros((count, 20, 9 + 6 * count))
    dense[:, :, :9] = by_lens
    for k in range(count):
        dense[k, :, 9 + 6 * k : 15 + 6 * k] = by_motion[k]
    expected, *_ = np.linalg.lstsq(dense.reshape(20 * count, -1), right.ravel(), rcond=None)
    if 20 * count < 9 + 6 * count:
        return
    got = np.concatenate([solution.value[0], np.asarray(solution.value[1]).ravel()])
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-8)


def jnp_structure(tree):
    import jax

    return jax.eval_shape(lambda: tree)
