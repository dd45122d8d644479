import jax
import numpy as np
from hypothesis import given, strategies as st

from trinoc.numerics import small_matrices

inverse_positive_definite = jax.jit(small_matrices.inverse_positive_definite)
solve_positive_definite = jax.jit(small_matrices.solve_positive_definite)


@given(st.sampled_from([1, 3, 6]), st.integers(0, 2**32 - 1))
def test_agrees_with_lapack(size, seed):
    random = np.random.default_rng(seed)
    root = random.standard_normal((size, size + 2))
    matrix, right = root @ root.T + np.eye(size), random.standard_normal((size, 3))
    np.testing.assert_allclose(
        solve_positive_definite(matrix, right), np.linalg.solve(matrix, right), atol=1e-9
    )
    np.testing.assert_allclose(
        solve_positive_definite(matrix, right[:, 0]),
        np.linalg.solve(matrix, right[:, 0]),
        atol=1e-9,
    )
    np.testing.assert_allclose(inverse_positive_definite(matrix) @ matrix, np.eye(size), atol=1e-8)


def test_an_indefinite_matrix_gives_nan_and_no_answer():
    indefinite = np.array([[1.0, 2.0], [2.0, 1.0]])
    assert np.isnan(solve_positive_definite(indefinite, np.ones(2))).any()
    assert np.isnan(inverse_positive_definite(indefinite)).all()
