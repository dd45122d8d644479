"""Array lengths rounded up to buckets, so that a new picture does not compile anew."""

from collections.abc import Iterator

import numpy as np

SMALLEST_BUCKET = 64


def bucket(count: int) -> int:
    """The smallest of 64, 128, 256, ... that is not below `count`."""
    return max(SMALLEST_BUCKET, 1 << max(int(count) - 1, 0).bit_length())


def padded(array: np.ndarray, size: int, filler: float | np.ndarray = 0) -> np.ndarray:
    """`array` with rows of `filler` appended up to `size` rows."""
    result = np.empty((size, *array.shape[1:]), dtype=array.dtype)
    result[: len(array)] = array
    result[len(array) :] = filler
    return result


def blocks(count: int, size: int) -> Iterator[slice]:
    """Slices that cover range(count), each of at most `size`."""
    return (slice(start, min(start + size, count)) for start in range(0, count, size))
