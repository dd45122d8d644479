"""Tables: trees of arrays whose rows belong together, as named tuples of columns."""

from collections.abc import Sequence
from typing import TypeVar

import jax
import numpy as np

_Table = TypeVar("_Table")


def take_rows(table: _Table, rows: np.ndarray) -> _Table:
    """The rows at the given indices, in that order, or where the mask is true."""
    return jax.tree.map(lambda column: column[rows], table)


def concatenate_rows(tables: Sequence[_Table]) -> _Table:
    """The rows of one or more tables, one table after the other."""
    return jax.tree.map(lambda *columns: np.concatenate(columns), *tables)
