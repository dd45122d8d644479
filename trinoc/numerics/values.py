"""Base class of the values that users hold: read-only arrays, equality by content."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np

from trinoc.numerics.precision import is_traced

_NUMBERS = (np.ndarray, np.generic, jax.Array, bool, int, float)


class Value(eqx.Module):
    """Base class of immutable values whose NumPy arrays are read-only.

    The arrays are read-only views; the caller can still write to the arrays that it passed. Two
    values of one class are equal if all their fields are equal; NaN equals NaN.
    """

    def __check_init__(self) -> None:
        for field in dataclasses.fields(self):
            content = getattr(self, field.name)
            guarded = _read_only(content)
            if guarded is not content:
                object.__setattr__(self, field.name, guarded)

    def __eq__(self, other: object) -> Any:
        if is_traced(self, other):
            return eqx.tree_equal(self, other)
        return equal_values(self, other)

    def __hash__(self) -> int:
        return hash(_outline(self))


def _read_only(content: Any) -> Any:
    """Copy of a content in which read-only views replace writable arrays."""
    if isinstance(content, np.ndarray):
        if not content.flags.writeable:
            return content
        view = content.view()
        view.flags.writeable = False
        return view
    if type(content) is dict:
        guarded = {key: _read_only(item) for key, item in content.items()}
        is_same = all(guarded[key] is item for key, item in content.items())
        return content if is_same else guarded
    if isinstance(content, tuple | list):
        parts = [_read_only(item) for item in content]
        if all(part is item for part, item in zip(parts, content, strict=True)):
            return content
        make: Any = getattr(type(content), "_make", type(content))
        return make(parts)
    return content


def equal_values(first: Any, second: Any) -> bool:
    """True if two values, or containers of values, have the same content; NaN equals NaN."""
    if isinstance(first, eqx.Module):
        names = [field.name for field in dataclasses.fields(first)]  # pyright: ignore
        return type(first) is type(second) and all(
            equal_values(getattr(first, name), getattr(second, name)) for name in names
        )
    if isinstance(first, dict):
        return (
            isinstance(second, dict)
            and first.keys() == second.keys()
            and all(equal_values(item, second[key]) for key, item in first.items())
        )
    if isinstance(first, tuple | list):
        return (
            isinstance(second, type(first))
            and len(first) == len(second)
            and all(map(equal_values, first, second))
        )
    if isinstance(first, _NUMBERS) and isinstance(second, _NUMBERS):
        arrays = np.asarray(first), np.asarray(second)
        with_nan = all(array.dtype.kind in "fc" for array in arrays)
        return np.array_equal(*arrays, equal_nan=with_nan)
    return bool(first == second)


def _outline(content: Any) -> Any:
    """Hashable description of a value without its numbers; it is the same for equal values."""
    if isinstance(content, eqx.Module):
        fields = dataclasses.fields(content)  # pyright: ignore
        return type(content), tuple(_outline(getattr(content, field.name)) for field in fields)
    if isinstance(content, dict):
        return frozenset((key, _outline(field)) for key, field in content.items())
    if isinstance(content, tuple | list):
        return tuple(map(_outline, content))
    return np.shape(content) if isinstance(content, _NUMBERS) else content
