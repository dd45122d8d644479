"""Sums and medians by group, for rows of several problems in one table.

Without groups (None) all rows are of one problem, and results have no axis of groups.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

Group = Int[np.ndarray, "m"] | None


def of_group(values: Any, group: Group) -> Any:
    """What belongs to each row: the values of its group, or those of all."""
    return values if group is None else np.asarray(values)[group]


def taken(group: Group, rows: Shaped[np.ndarray, "_"]) -> Int[np.ndarray, "k"] | None:
    """The groups of some rows, by a mask or by numbers."""
    return None if group is None else group[rows]


def group_sums(
    values: Float[np.ndarray, "m *k"], group: Group, groups: int
) -> Float[np.ndarray, "*g"]:
    """Sum of the rows of each group: (groups, *k), or (*k) without groups."""
    if group is None:
        return np.asarray(values.sum(axis=0))
    columns = values.reshape(len(values), int(np.prod(values.shape[1:]))).T
    total = np.array([np.bincount(group, column, groups) for column in columns], dtype=np.float64)
    return total.T.reshape(groups, *values.shape[1:])


def group_medians(
    values: Float[np.ndarray, "m"], group: Group, groups: int
) -> Float[np.ndarray, "*g"]:
    """Median of each group; NaN for groups without rows."""
    label = np.zeros(len(values), dtype=np.int64) if group is None else group
    count = np.bincount(label, minlength=1 if group is None else groups)
    ordered = np.append(values[np.lexsort((values, label))], np.nan)
    first = np.cumsum(count) - count
    low, high = first + np.maximum(count - 1, 0) // 2, first + count // 2
    median = np.where(
        count > 0, (ordered[low] + ordered[np.minimum(high, len(values))]) / 2, np.nan
    )
    return np.asarray(median[0]) if group is None else median
