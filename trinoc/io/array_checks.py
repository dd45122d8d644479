"""What an array of a file must be before it is believed: its kind, its shape, its values."""

import os
from collections.abc import Mapping

import numpy as np

from trinoc.errors import InputError

REMEDY = "write the file again"
# Larger numbers are no places: no picture has so many pixels, no scene so many mm.
LARGEST_PX, LARGEST_MM = 1e6, 1e9
_IN_WORDS = {"f": "real numbers", "i": "whole numbers", "b": "truth values", "U": "texts"}
_DTYPES = {"f": np.float64, "i": np.int64, "b": np.bool_}
# Of correlations: what rounding leaves of a covariance without spread in some direction.
_LEAST_EIGENVALUE = -1e-6


class ArrayFields:
    """The arrays of one file, taken one by one and checked; the file is named in every error."""

    def __init__(self, arrays: Mapping[str, np.ndarray], file: str | os.PathLike[str]) -> None:
        self.arrays, self.file = arrays, file

    def __contains__(self, name: str) -> bool:
        return name in self.arrays

    def take(self, name: str, kind: str, shape: tuple[int | None, ...], what: str) -> np.ndarray:
        """An array of a kind ("f", "i", "b" or "U"), as float64, int64, bool or text.

        None in `shape` is any length; `what` says in words what needs this shape. Raises
        InputError where the file lacks it or holds another.
        """
        if name not in self.arrays:
            raise InputError(f'{self.file} lacks the array "{name}": {REMEDY}.')
        array = self.arrays[name]
        if len(shape) != array.ndim or any(
            want not in (None, got) for want, got in zip(shape, array.shape, strict=True)
        ):
            raise self.error(name, f"has shape {array.shape}, but {what} need {_shown(shape)}")
        if array.dtype.kind not in {"f": "fiu", "i": "iu", "b": "b", "U": "U"}[kind]:
            if not (array.size == 0 and array.dtype.kind in "fiubU"):
                raise self.error(name, f"must be {_IN_WORDS[kind]}, but is {array.dtype}")
            return np.zeros(array.shape, "<U1" if kind == "U" else _DTYPES[kind])
        if kind == "U":
            return array
        if array.dtype == np.uint64 and (array > np.iinfo(np.int64).max).any():
            raise self.error(name, "holds numbers that are too large")
        return array.astype(_DTYPES[kind])

    def expect(self, name: str, good: np.ndarray, problem: str) -> None:
        """Raise InputError where not all rows are good, and name the first that is not."""
        rows = good.all(axis=tuple(range(1, good.ndim)))
        if not rows.all():
            raise self.error(name, f"of row {int(np.flatnonzero(~rows)[0])} {problem}")

    def error(self, name: str, problem: str) -> InputError:
        """An error that names the file and the array."""
        return InputError(f'{self.file}: "{name}" {problem}: {REMEDY}.')


def is_covariance(matrices: np.ndarray) -> np.ndarray:
    """(n,) whether each of (n, k, k) is finite, symmetric and without negative variance."""
    good = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    trusted = np.where(good[:, None, None], matrices, 0.0)
    variance = np.diagonal(trusted, axis1=1, axis2=2)
    sigma = np.sqrt(np.where(variance > 0, variance, 1.0))
    # As correlations, so that degrees and millimetres count alike.
    unit = trusted / sigma[:, :, None] / sigma[:, None, :]
    good &= (variance >= 0).all(axis=1) & (np.abs(unit) < 2).all(axis=(1, 2))
    unit = np.where(good[:, None, None], unit, 0.0)
    good &= (np.abs(unit - unit.transpose(0, 2, 1)) < 1e-6).all(axis=(1, 2))
    if unit.size:
        good &= np.linalg.eigvalsh(unit).min(axis=1) >= _LEAST_EIGENVALUE
    return good


def _shown(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('n' if side is None else str(side) for side in shape)})"
