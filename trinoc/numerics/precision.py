"""Array types of all signatures, and double precision without changing the caller's JAX settings.

Arrays are JAX arrays inside `jit` and NumPy arrays outside.
"""

import contextlib
import functools
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import get_opaque_trace_state
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.numerics.forked import expect_no_fork, note_computation

# Indexing a NumPy array yields NumPy scalars, which behave like arrays. Type checkers do not get
# them here, because their type lacks operators that all arrays have.
if TYPE_CHECKING:
    ArrayLike = jax.Array | np.ndarray
else:
    ArrayLike = jax.Array | np.ndarray | np.generic

# One number: a Python float, or an array without axes.
ScalarLike = Float[ArrayLike, ""] | float

# Types of properties: NumPy and Python numbers, or traced values inside `jit`, `grad` and `vmap`.
# Type checkers see only the former, as most callers do.
if TYPE_CHECKING:
    NumpyOrTraced = np.ndarray
    FloatOrTraced = float
else:
    NumpyOrTraced = ArrayLike
    FloatOrTraced = ScalarLike


_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

# Trace state outside `jit`, `grad` and `vmap`, even if this module is imported inside one.
with jax.ensure_compile_time_eval():
    _OUTSIDE = get_opaque_trace_state()


def real_array(value: Any, name: str) -> np.ndarray:
    """Convert an argument to an array of float64.

    Parameters
    ----------
    value : array-like
        The argument.
    name : str
        Name of the argument, for the message.

    Raises
    ------
    InputError
        If the argument is not numeric.
    """
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is {value!r:.60}, but must be numbers.") from error


def is_traced(*trees: Any) -> bool:
    """True if JAX traces an array of the trees, inside `jit`, `grad` or `vmap`."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


def array_namespace(*trees: Any) -> ModuleType:
    """Module for array functions: `jax.numpy` if JAX traces an array of the trees, else NumPy."""
    return jnp if is_traced(*trees) else np


def is_outside() -> bool:
    """True if the caller is not inside `jit`, `grad` or `vmap`."""
    return get_opaque_trace_state() == _OUTSIDE


def as_numpy(tree: Any) -> Any:
    """Copy of a tree in which NumPy arrays replace all JAX arrays."""
    return jax.tree.map(_leaf_as_numpy, tree, is_leaf=lambda node: isinstance(node, dict))


def _leaf_as_numpy(leaf: Any) -> Any:
    if isinstance(leaf, dict):  # JAX would sort its keys; callers named their cameras in order
        return {key: as_numpy(value) for key, value in leaf.items()}
    if not isinstance(leaf, jax.Array):
        return leaf
    note_computation()
    return np.asarray(leaf)


def as_float(value: Any) -> Any:
    """Convert a number to a Python float. A number that JAX traces is returned unchanged."""
    return value if is_traced(value) else float(value)


def in_float64(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Decorator: the function computes with 64-bit JAX arrays and returns NumPy arrays.

    The setting is valid for the current thread, and only during the call. The results are NumPy
    arrays, because an operation outside the call would convert a float64 JAX array to float32.

    If JAX traces an argument, the function runs unchanged: the trace defines the precision. Inside
    a trace, a call with constant arguments still returns NumPy arrays.
    """

    @functools.wraps(function)
    def wrapper(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        if is_traced(args, kwargs):
            return function(*args, **kwargs)
        expect_no_fork()
        # Constants inside a trace are computed at once. Outside, the context would cost compiling.
        at_once = contextlib.nullcontext() if is_outside() else jax.ensure_compile_time_eval()
        with at_once, jax.enable_x64(True):
            return as_numpy(function(*args, **kwargs))

    return wrapper
