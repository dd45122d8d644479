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

    Raises InputError, with `name`, if it is not numeric.
    """
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is {value!r:.60}, but must be numbers.") from error


def is_traced(*trees: Any) -> bool:
    """True if an array of the trees is traced by `jit`, `grad` or `vmap`."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


def array_namespace(*trees: Any) -> ModuleType:
    """`jax.numpy` if an argument is traced, else NumPy."""
    return jnp if is_traced(*trees) else np


def is_outside() -> bool:
    """True if no `jit`, `grad` or `vmap` encloses the call."""
    return get_opaque_trace_state() == _OUTSIDE


def as_numpy(tree: Any) -> Any:
    """Replace every JAX array of a tree by a NumPy array of the same dtype."""
    return jax.tree.map(_leaf_as_numpy, tree, is_leaf=lambda node: isinstance(node, dict))


def _leaf_as_numpy(leaf: Any) -> Any:
    if isinstance(leaf, dict):  # JAX would sort its keys; callers named their cameras in order
        return {key: as_numpy(value) for key, value in leaf.items()}
    if not isinstance(leaf, jax.Array):
        return leaf
    note_computation()
    return np.asarray(leaf)


def as_float(value: Any) -> Any:
    """Convert one number to a Python float; a traced number is returned unchanged."""
    return value if is_traced(value) else float(value)


def in_float64(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Decorator: run `function` with 64-bit JAX arrays and return its result as NumPy.

    The setting is thread-local and ends with the call. A float64 JAX array would become float32 at
    its next operation outside the call, so results are NumPy arrays.

    With a traced argument `function` runs unchanged: the trace defines the precision, and the
    result belongs to it. Inside a trace, constant arguments still give NumPy.
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
