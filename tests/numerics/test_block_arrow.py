"""Elimination of the blocks of an arrow matrix solves the same equations as a dense solver."""

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

from trinoc.numerics.block_arrow import BlockArrow, BlockArrowSolver, eliminate

ROWS = 20
SHAPES = [(0, 1, 9, 6), (3, 40, 18, 4)]


def dense_jacobian(by_head: np.ndarray, by_block: np.ndarray) -> np.ndarray:
    """Dense Jacobian of all unknowns, the head's first, (k ROWS, q + k w)."""
    count, rows, width = by_block.shape
    size = by_head.shape[2]
    dense = np.zeros((count, rows, size + width * count))
    dense[:, :, :size] = by_head
    for k in range(count):
        dense[k, :, size + width * k : size + width * (k + 1)] = by_block[k]
    return dense.reshape(count * rows, -1)


def jacobians(seed: int, count: int, size: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of each group's residuals by the head and by its own unknowns."""
    random = np.random.default_rng(seed)
    return random.normal(size=(count, ROWS, size)), random.normal(size=(count, ROWS, width))


def arrow_of(by_head: np.ndarray, by_block: np.ndarray) -> BlockArrow:
    """Arrow of the normal matrix J^T J."""
    return BlockArrow(
        np.einsum("knq,knr->qr", by_head, by_head),
        np.einsum("knq,knw->kqw", by_head, by_block),
        np.einsum("knv,knw->kvw", by_block, by_block),
    )


def flat(unknowns: tuple) -> np.ndarray:
    return np.concatenate([np.asarray(leaf).ravel() for leaf in unknowns])


@pytest.mark.parametrize("shape", SHAPES)
def test_the_solver_solves_least_squares_of_a_function(shape: tuple[int, int, int, int]) -> None:
    seed, count, size, width = shape
    by_head, by_block = jacobians(*shape)
    right = np.random.default_rng(seed + 10).normal(size=(count, ROWS))

    def residuals(unknowns: tuple) -> jax.Array:
        head, blocks = unknowns
        return jnp.einsum("knq,q->kn", by_head, head) + jnp.einsum("knw,kw->kn", by_block, blocks)

    structure = jax.eval_shape(lambda: (jnp.zeros(size), jnp.zeros((count, width))))
    operator = lx.FunctionLinearOperator(residuals, structure)
    solution = lx.linear_solve(operator, jnp.asarray(right), lx.Normal(BlockArrowSolver()))
    dense = dense_jacobian(by_head, by_block)
    expected, *_ = np.linalg.lstsq(dense, right.ravel(), rcond=None)
    np.testing.assert_allclose(flat(solution.value), expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("shape", SHAPES)
def test_an_arrow_is_its_dense_matrix(shape: tuple[int, int, int, int]) -> None:
    by_head, by_block = jacobians(*shape)
    arrow, dense = arrow_of(by_head, by_block), dense_jacobian(by_head, by_block)
    dense = dense.T @ dense
    np.testing.assert_allclose(arrow.as_matrix(), dense, atol=1e-12)
    random = np.random.default_rng(7)
    head, blocks = (random.normal(size=leaf.shape) for leaf in arrow.in_structure())
    vector = (jnp.asarray(head), jnp.asarray(blocks))
    np.testing.assert_allclose(flat(arrow.mv(vector)), dense @ flat(vector), rtol=1e-10)
    read = BlockArrow.of_operator(lx.FunctionLinearOperator(arrow.mv, arrow.in_structure()))
    np.testing.assert_allclose(read.as_matrix(), dense, atol=1e-12)
    solution = lx.linear_solve(arrow, vector, BlockArrowSolver()).value
    np.testing.assert_allclose(flat(solution), np.linalg.solve(dense, flat(vector)), rtol=1e-8)


def test_the_reduced_matrix_is_the_inverse_of_the_head_of_the_inverse() -> None:
    arrow = arrow_of(*jacobians(4, 6, 5, 3))
    covariance = np.linalg.inv(arrow.as_matrix())[:5, :5]
    np.testing.assert_allclose(np.linalg.inv(eliminate(arrow).reduced), covariance, rtol=1e-9)


def test_the_order_of_the_blocks_does_not_matter() -> None:
    arrow = arrow_of(*jacobians(5, 8, 5, 3))
    random = np.random.default_rng(6)
    head, blocks = jnp.asarray(random.normal(size=5)), jnp.asarray(random.normal(size=(8, 3)))
    order = random.permutation(8)
    turned = BlockArrow(arrow.head, arrow.coupling[order], arrow.blocks[order])
    one = lx.linear_solve(arrow, (head, blocks), BlockArrowSolver()).value
    two = lx.linear_solve(turned, (head, blocks[order]), BlockArrowSolver()).value
    np.testing.assert_allclose(one[0], two[0], rtol=1e-10)
    np.testing.assert_allclose(one[1][order], two[1], rtol=1e-10)


def test_a_block_that_nothing_determines_stays_and_leaves_the_others_alone() -> None:
    by_head, by_block = jacobians(8, 4, 5, 3)
    arrow = arrow_of(by_head, by_block)
    silent = arrow_of(
        np.concatenate([by_head, np.zeros((1, ROWS, 5))]),
        np.concatenate([by_block, np.zeros((1, ROWS, 3))]),
    )
    head, blocks = jnp.arange(5.0), jnp.ones((4, 3))
    one = lx.linear_solve(arrow, (head, blocks), BlockArrowSolver()).value
    two = lx.linear_solve(silent, (head, jnp.ones((5, 3))), BlockArrowSolver()).value
    np.testing.assert_allclose(one[0], two[0], rtol=1e-12)
    np.testing.assert_array_equal(two[1][4], 0.0)


def test_damping_enlarges_the_diagonal_of_what_is_left_to_the_head() -> None:
    arrow, damping = arrow_of(*jacobians(9, 6, 5, 3)), 0.3
    reduced = np.asarray(eliminate(arrow).reduced)
    enlarged = BlockArrow(
        arrow.head + damping * np.diag(np.diag(reduced)), arrow.coupling, arrow.blocks
    )
    side = (jnp.arange(5.0), jnp.ones((6, 3)))
    damped = lx.linear_solve(arrow, side, BlockArrowSolver(damping)).value
    plain = lx.linear_solve(enlarged, side, BlockArrowSolver()).value
    np.testing.assert_allclose(flat(damped), flat(plain), rtol=1e-10)


def test_each_block_is_damped_on_its_own_diagonal() -> None:
    arrow, damping = arrow_of(*jacobians(9, 6, 5, 3)), np.linspace(0.0, 2.0, 6)
    enlarged = np.array(arrow.as_matrix())
    enlarged[5:, 5:] += np.diag(np.repeat(damping, 3) * np.diag(enlarged)[5:])
    side = (jnp.arange(5.0), jnp.ones((6, 3)))
    damped = lx.linear_solve(arrow, side, BlockArrowSolver(0.0, jnp.asarray(damping))).value
    np.testing.assert_allclose(flat(damped), np.linalg.solve(enlarged, flat(side)), rtol=1e-8)


def test_unknowns_that_are_no_arrow_are_refused() -> None:
    operator = lx.IdentityLinearOperator(jax.eval_shape(lambda: jnp.zeros(3)))
    with pytest.raises(ValueError, match="An arrow has the unknowns"):
        BlockArrowSolver().init(operator, {})
