"""Double precision at the outer edge, without touching the caller's JAX settings."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def as_numpy(tree: Any) -> Any:
    """`tree` with every JAX array replaced by a NumPy array of the same dtype."""

    def convert(leaf: Any) -> Any:
        if isinstance(leaf, dict):  # JAX would sort its keys; callers named their cameras in order
            return {key: as_numpy(value) for key, value in leaf.items()}
        return np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf

    return jax.tree.map(convert, tree, is_leaf=lambda node: isinstance(node, dict))


def in_float64(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Run `function` with 64-bit JAX arrays and hand its result back as NumPy.

    The setting is thread-local and ends with the call. A float64 JAX array that left the
    call would fall to float32 at its next operation, so none leaves: NumPy arrays do.
    """

    @functools.wraps(function)
    def wrapper(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        with jax.enable_x64(True):
            return as_numpy(function(*args, **kwargs))

    return wrapper
