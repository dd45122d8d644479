"""Arrays padded to few lengths, so that a new picture does not compile anew.

All that is padded in the package is padded by `bucket` and `padded`; kernels over many rows run
`in_blocks` of one length."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.numerics.precision import ArrayLike, array_namespace

SMALLEST_BUCKET = 64
# numerical: NumPy works through so few as quickly as a program of blocks does, and compiles
# nothing.
FEW_ROWS = 4096

_Tree = TypeVar("_Tree")
_Possible = tuple[Bool[ArrayLike, "h"], Float[ArrayLike, "c h"]]


def bucket(count: int, *, smallest: int = SMALLEST_BUCKET, finer_above: int | None = None) -> int:
    """The length for so many rows: `smallest`, a power of two, doubled until it holds them.

    finer_above : from here on in steps of half the power of two below `count`, for where the work
        on padding costs more than one small program more. Finer steps would save less work, and
        every program stays in memory.
    """
    power = max(smallest, 1 << max(int(count) - 1, 0).bit_length())
    if finer_above is None or count <= finer_above:
        return power
    step = power // 4
    return -(-count // step) * step


def pad_rows(array: np.ndarray, size: int, filler: float | np.ndarray = 0) -> np.ndarray:
    """`array` with rows of `filler` appended up to `size` rows."""
    result = np.empty((size, *array.shape[1:]), dtype=array.dtype)
    result[: len(array)] = array
    result[len(array) :] = filler
    return result


def in_bucket(function: Callable[[np.ndarray], ArrayLike], rows: np.ndarray) -> np.ndarray:
    """`function` over rows, padded to a bucket with rows of zeros whose results are dropped."""
    return np.asarray(function(pad_rows(rows, bucket(len(rows)))))[: len(rows)]


def blocks(count: int, size: int) -> Iterator[slice]:
    """Slices that cover range(count), each of at most `size`; one empty slice for none."""
    return (slice(start, min(start + size, count)) for start in range(0, max(count, 1), size))


def in_blocks(function: Callable[..., _Tree], size: int, *columns: np.ndarray) -> _Tree:
    """`function` over the rows of `columns`, `size` at a time, as NumPy arrays.

    The length that `function` sees is always `size`, whatever the number of rows: memory stays
    bounded and nothing compiles anew. It takes and returns arrays with the rows in front, and
    must bear rows of zeros, whose results are dropped.
    """
    count = len(columns[0])
    slices = list(blocks(count, size))
    # All blocks are handed over before the first result is waited for.
    results = [function(*(pad_rows(c[part], size) for c in columns)) for part in slices]
    rows = [part.stop - part.start for part in slices]

    def join(*leaves: jax.Array) -> np.ndarray:
        return np.concatenate([np.asarray(leaf)[:n] for leaf, n in zip(leaves, rows, strict=True)])

    return jax.tree.map(join, *results)


def as_columns(tree: Any) -> Float[ArrayLike, "c h"]:
    """All leaves of a tree, arrays of items or of rows of items, as rows of one array, in their
    order."""
    xp = array_namespace(tree)
    leaves = [xp.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    return xp.concatenate(
        [leaf.reshape(math.prod(leaf.shape[:-1]), leaf.shape[-1]) for leaf in leaves]
    )


def select_in_blocks(
    function: Callable[[np.ndarray], _Possible], size: int, rows: Int[np.ndarray, "m k"]
) -> tuple[Int[np.ndarray, "_"], Float[np.ndarray, "c _"]]:
    """(which rows are possible, their columns) by a function of `size` rows at a time, or of
    FEW_ROWS at most, which says of each whether it is possible; it must bear rows of zeros."""
    parts = list(blocks(len(rows), size))
    few = len(rows) <= FEW_ROWS
    # All blocks are handed over before the first result is waited for.
    results = [function(rows[part] if few else pad_rows(rows[part], size)) for part in parts]
    possible, columns = [], []
    for part, (is_possible, values) in zip(parts, results, strict=True):
        keep = np.flatnonzero(np.asarray(is_possible)[: part.stop - part.start])
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
