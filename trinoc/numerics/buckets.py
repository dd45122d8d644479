"""Array lengths rounded up to buckets, so that a new picture does not compile anew."""

from collections.abc import Callable, Iterator
from typing import TypeVar

import jax
import numpy as np

from trinoc.numerics.arrays import ArrayLike

SMALLEST_BUCKET = 64

_Tree = TypeVar("_Tree")


def bucket(count: int) -> int:
    """The smallest of 64, 128, 256, ... that is not below `count`."""
    return max(SMALLEST_BUCKET, 1 << max(int(count) - 1, 0).bit_length())


def finer_bucket(count: int) -> int:
    """As `bucket`, but above 2^16 in steps of a quarter of the power of two below `count`.

    For where the work on padding costs more than one small program more.
    """
    step = bucket(count) // 8
    return bucket(count) if count <= 1 << 16 else -(-count // step) * step


def padded(array: np.ndarray, size: int, filler: float | np.ndarray = 0) -> np.ndarray:
    """`array` with rows of `filler` appended up to `size` rows."""
    result = np.empty((size, *array.shape[1:]), dtype=array.dtype)
    result[: len(array)] = array
    result[len(array) :] = filler
    return result


def in_bucket(function: Callable[[np.ndarray], ArrayLike], rows: np.ndarray) -> np.ndarray:
    """`function` over rows, padded to a bucket with rows of zeros whose results are dropped."""
    return np.asarray(function(padded(rows, bucket(len(rows)))))[: len(rows)]


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
    results = [function(*(padded(c[part], size) for c in columns)) for part in slices]
    rows = [part.stop - part.start for part in slices]

    def joined(*leaves: jax.Array) -> np.ndarray:
        return np.concatenate([np.asarray(leaf)[:n] for leaf, n in zip(leaves, rows, strict=True)])

    return jax.tree.map(joined, *results)
