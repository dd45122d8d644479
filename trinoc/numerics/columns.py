"""Results of a kernel as columns of one array: one hand-over per block, whatever their number."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.numerics.arrays import ArrayLike
from trinoc.numerics.buckets import blocks, padded

Judged = tuple[Bool[ArrayLike, "h"], Float[ArrayLike, "c h"]]


def as_columns(tree: Any) -> Float[ArrayLike, "c h"]:
    """All leaves of a tree, arrays of items or of rows of items, as rows of one array, in their
    order."""
    leaves = [jnp.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    return jnp.concatenate([leaf.reshape(-1, leaf.shape[-1]) for leaf in leaves])


def judged_in_blocks(
    function: Callable[[np.ndarray], Judged], size: int, rows: Int[np.ndarray, "m k"]
) -> tuple[Int[np.ndarray, "_"], Float[np.ndarray, "c _"]]:
    """(which rows are possible, their columns) by a function of `size` rows at a time, which says
    of each whether it is possible; it must bear rows of zeros."""
    parts = list(blocks(len(rows), size))
    # All blocks are handed over before the first result is waited for.
    results = [function(padded(rows[part], size)) for part in parts]
    possible, columns = [], []
    for part, (judged, values) in zip(parts, results, strict=True):
        keep = np.flatnonzero(np.asarray(judged)[: part.stop - part.start])
        possible.append(keep + part.start)
        columns.append(np.asarray(values)[:, keep])
    return np.concatenate(possible), np.concatenate(columns, axis=1)


def split_columns(
    columns: Float[np.ndarray, "c m"], shapes: Sequence[tuple[int, ...]]
) -> Iterable[Float[np.ndarray, "..."]]:
    """Arrays of these shapes for each item, from as many columns as they have entries."""
    sizes = [int(np.prod(shape)) for shape in shapes]
    parts = np.split(columns, np.cumsum(sizes)[:-1])
    return (
        np.ascontiguousarray(part.T).reshape(-1, *shape)
        for part, shape in zip(parts, shapes, strict=True)
    )
