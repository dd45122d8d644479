"""Arrays padded to a few lengths (buckets), so that a new image size compiles no new program.

All padding of the package uses `bucket` and `pad_rows`. Kernels over many rows run `in_blocks` of
one length.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.numerics.precision import ArrayLike, array_namespace

SMALLEST_BUCKET = 64
# numerical: up to this number of rows NumPy is as fast as a compiled program, without compiling.
FEW_ROWS = 4096

_Tree = TypeVar("_Tree")
_Possible = tuple[Bool[ArrayLike, "h"], Float[ArrayLike, "c h"]]


def bucket(count: int, *, smallest: int = SMALLEST_BUCKET, finer_above: int | None = None) -> int:
    """Padded length for a number of rows: `smallest`, doubled until it is at least `count`.

    Parameters
    ----------
    count : int
        Number of rows.
    smallest : int
        Smallest length, a power of two.
    finer_above : int, optional
        Above this number the length grows in quarters of the power of two. Use it where work on
        padding costs more than one more compiled program. Every program stays in memory.
    """
    power = max(smallest, 1 << max(int(count) - 1, 0).bit_length())
    if finer_above is None or count <= finer_above:
        return power
    step = power // 4
    return -(-count // step) * step


def pad_rows(array: np.ndarray, size: int, filler: float | np.ndarray = 0) -> np.ndarray:
    """Append rows of `filler` to `array` up to `size` rows."""
    result = np.empty((size, *array.shape[1:]), dtype=array.dtype)
    result[: len(array)] = array
    result[len(array) :] = filler
    return result


def in_bucket(function: Callable[[np.ndarray], ArrayLike], rows: np.ndarray) -> np.ndarray:
    """Apply `function` to rows padded with zeros to a bucket size.

    Results of the padding are dropped.
    """
    return np.asarray(function(pad_rows(rows, bucket(len(rows)))))[: len(rows)]


def blocks(count: int, size: int) -> Iterator[slice]:
    """Slices that cover range(count), each of at most `size`; one empty slice for a count of 0."""
    return (slice(start, min(start + size, count)) for start in range(0, max(count, 1), size))


def in_blocks(function: Callable[..., _Tree], size: int, *columns: np.ndarray) -> _Tree:
    """Apply `function` to the rows of `columns`, `size` rows at a time; results are NumPy arrays.

    Every call has `size` rows, so memory is bounded and only one program compiles. `function` takes
    and returns arrays with rows first. It must accept rows of zeros, whose results are dropped.
    """
    count = len(columns[0])
    slices = list(blocks(count, size))
    # All blocks are dispatched before the first result is waited for.
    results = [function(*(pad_rows(c[part], size) for c in columns)) for part in slices]
    rows = [part.stop - part.start for part in slices]

    def join(*leaves: jax.Array) -> np.ndarray:
        return np.concatenate([np.asarray(leaf)[:n] for leaf, n in zip(leaves, rows, strict=True)])

    return jax.tree.map(join, *results)


def as_columns(tree: Any) -> Float[ArrayLike, "c h"]:
    """Stack the leaves of a tree as rows of one array (c, h), in their order.

    A leaf is an array (h,) or an array of such rows.
    """
    xp = array_namespace(tree)
    leaves = [xp.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    return xp.concatenate(
        [leaf.reshape(math.prod(leaf.shape[:-1]), leaf.shape[-1]) for leaf in leaves]
    )


def select_in_blocks(
    function: Callable[[np.ndarray], _Possible], size: int, rows: Int[np.ndarray, "m k"]
) -> tuple[Int[np.ndarray, "_"], Float[np.ndarray, "c _"]]:
    """(indices of the selected rows, their columns) by a test of `size` rows at a time.

    `function` returns a mask and columns for its rows. It must accept rows of zeros. Up to FEW_ROWS
    rows are tested in one call without padding.
    """
    parts = list(blocks(len(rows), size))
    is_small = len(rows) <= FEW_ROWS
    # All blocks are dispatched before the first result is waited for.
    results = [function(rows[part] if is_small else pad_rows(rows[part], size)) for part in parts]
    possible, columns = [], []
    for part, (is_possible, values) in zip(parts, results, strict=True):
        selected = np.flatnonzero(np.asarray(is_possible)[: part.stop - part.start])
        possible.append(selected + part.start)
        columns.append(np.asarray(values)[:, selected])
    return np.concatenate(possible), np.concatenate(columns, axis=1)


def split_columns(
    columns: Float[np.ndarray, "c m"], shapes: Sequence[tuple[int, ...]]
) -> Iterable[Float[np.ndarray, "..."]]:
    """Inverse of `as_columns`: one array per shape, with items first."""
    sizes = [int(np.prod(shape)) for shape in shapes]
    parts = np.split(columns, np.cumsum(sizes)[:-1])
    return (
        np.ascontiguousarray(part.T).reshape(-1, *shape)
        for part, shape in zip(parts, shapes, strict=True)
    )
