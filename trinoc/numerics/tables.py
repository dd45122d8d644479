"""Tables, as trees of columns whose rows belong together, and options in groups."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import jax
import numpy as np

_Table = TypeVar("_Table")
_Options = TypeVar("_Options")


def take_rows(table: _Table, rows: np.ndarray) -> _Table:
    """The rows at the given indices, in that order, or where the mask is true."""
    return jax.tree.map(lambda column: column[rows], table)


def concatenate_rows(tables: Sequence[_Table]) -> _Table:
    """The rows of one or more tables, one table after the other."""
    return jax.tree.map(lambda *columns: np.concatenate(columns), *tables)


def with_field(options: _Options, name: str, value: Any) -> _Options:
    """The same options with another value of one field, named by "group.field" or "field".

    Raises ValueError for a name that the options do not have.
    """
    group: Any = options
    first, _, rest = name.partition(".")
    own = [field.name for field in fields(group)]
    if first not in own:
        raise ValueError(f'There is no option "{first}": choose one of {", ".join(own)}.')
    changed = with_field(getattr(group, first), rest, value) if rest else value
    return replace(group, **{first: changed})
