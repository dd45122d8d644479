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
    """Length to which an array of `count` rows is padded.

    The length is `smallest`, doubled until it is at least `count`. Few different lengths mean few
    compiled programs.

    Parameters
    ----------
    count : int
        Number of rows.
    smallest : int
        Smallest length, a power of two.
    finer_above : int, optional
        Above this number of rows, the length increases in quarters of the power of two. Use it if
        the work on padding costs more than the compilation of one more program. Every program stays
        in memory.
    """
    power = max(smallest, 1 << max(int(count) - 1, 0).bit_length())
    if finer_above is None or count <= finer_above:
        return power
    step = power // 4
    return -(-count // step) * step


def pad_rows(array: np.ndarray, size: int, filler: float | np.ndarray = 0) -> np.ndarray:
    """Append rows with the value `filler` to an array, up to `size` rows.

    Parameters
    ----------
    array : (n, ...)
        The array.
    size : int
        Number of rows of the result.
    filler : scalar or (...)
        Value of each appended row.
    """
    result = np.empty((size, *array.shape[1:]), dtype=array.dtype)
    result[: len(array)] = array
    result[len(array) :] = filler
    return result


def in_bucket(function: Callable[[np.ndarray], ArrayLike], rows: np.ndarray) -> np.ndarray:
    """Apply a function to rows that are padded with zeros to the length `bucket(len(rows))`.

    Parameters
    ----------
    function : callable
        Function of an array of rows; it returns one result per row.
    rows : (n, ...)
        The rows.

    Returns
    -------
    (n, ...)
        Results without those of the padding.
    """
    return np.asarray(function(pad_rows(rows, bucket(len(rows)))))[: len(rows)]


def blocks(count: int, size: int) -> Iterator[slice]:
    """Yield consecutive slices of at most `size` items that together cover range(count).

    The result is one empty slice if `count` is 0.

    Parameters
    ----------
    count, size : int
        Number of items, and largest number of items in a slice.
    """
    return (slice(start, min(start + size, count)) for start in range(0, max(count, 1), size))


def in_blocks(function: Callable[..., _Tree], size: int, *columns: np.ndarray) -> _Tree:
    """Apply a function to the rows of arrays, `size` rows at a time.

    Every call has `size` rows. The memory is therefore bounded, and only one program compiles.

    Parameters
    ----------
    function : callable
        Function of arrays with `size` rows. It returns arrays with one result per row. It must
        accept rows of zeros, whose results are dropped.
    size : int
        Number of rows in a call.
    *columns : (n, ...)
        The arrays.

    Returns
    -------
    NumPy arrays with n rows, in the structure that `function` returns.
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
    """Stack the arrays of a tree as rows of one array, (c, h): c numbers for each of h items.

    Parameters
    ----------
    tree : tree of (..., h)
        Arrays whose last axis counts the h items. Each array gives as many rows as it has numbers
        per item.
    """
    xp = array_namespace(tree)
    leaves = [xp.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    return xp.concatenate(
        [leaf.reshape(math.prod(leaf.shape[:-1]), leaf.shape[-1]) for leaf in leaves]
    )


def select_in_blocks(
    function: Callable[[np.ndarray], _Possible], size: int, rows: Int[np.ndarray, "m k"]
) -> tuple[Int[np.ndarray, "_"], Float[np.ndarray, "c _"]]:
    """Select rows by a test, `size` rows at a time.

    Up to FEW_ROWS rows are tested in one call without padding.

    Parameters
    ----------
    function : callable
        Function of rows. It returns a mask of the selected rows and an array (c, rows) of values.
        It must accept rows of zeros.
    size : int
        Number of rows in a call.
    rows : (m, k)
        The rows.

    Returns
    -------
    Indices of the selected rows, and their values (c, number of selected rows).
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
    """Inverse of `as_columns`: one array per shape, whose first axis counts the items.

    Parameters
    ----------
    columns : (c, m)
        Result of `as_columns` for m items.
    shapes : sequence of tuple of int
        Shape of the value of one item, for each array.
    """
    sizes = [int(np.prod(shape)) for shape in shapes]
    parts = np.split(columns, np.cumsum(sizes)[:-1])
    return (
        np.ascontiguousarray(part.T).reshape(-1, *shape)
        for part, shape in zip(parts, shapes, strict=True)
    )
