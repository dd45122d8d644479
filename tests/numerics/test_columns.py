"""Columns return the selected rows unchanged and in order, block by block."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trinoc.numerics.buckets import as_columns, select_in_blocks, split_columns


@jax.jit
def select_rows(rows):
    value = rows.astype(np.float32)
    tree = {"sum": value.sum(axis=1), "each": (value[:, 0], 2.0 * value[:, 1])}
    return rows[:, 0] % 3 != 0, as_columns((tree["each"], tree["sum"]))


@pytest.mark.parametrize("count", [0, 1, 4, 5, 11])
def test_only_the_possible_come_back_in_their_order(count: int) -> None:
    rows = np.arange(2 * count, dtype=np.int32).reshape(count, 2)
    keep, columns = select_in_blocks(select_rows, 4, rows)
    expected = rows[rows[:, 0] % 3 != 0]
    np.testing.assert_array_equal(rows[keep], expected)
    scaled, total = split_columns(columns, ((2,), ()))
    np.testing.assert_array_equal(scaled, expected * np.array([1.0, 2.0]))
    np.testing.assert_array_equal(total, expected.sum(axis=1))


def test_each_entry_of_a_shape_is_the_leaf_at_its_place() -> None:
    leaves = jnp.arange(21.0).reshape(7, 3)
    (first, second) = split_columns(np.asarray(as_columns(list(leaves))), ((2, 3), ()))
    np.testing.assert_array_equal(first, np.asarray(leaves[:6]).T.reshape(3, 2, 3))
    np.testing.assert_array_equal(second, leaves[6])
