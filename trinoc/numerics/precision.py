"""The array type of all signatures (a JAX array inside `jit`, a NumPy array outside), and double
precision at the outer edge, without touching the caller's JAX settings.
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

# Indexing a NumPy array yields NumPy's own scalars, which are no arrays but behave as such.
# Type checkers do not see them: their scalar type lacks operators that all arrays have.
if TYPE_CHECKING:
    ArrayLike = jax.Array | np.ndarray
else:
    ArrayLike = jax.Array | np.ndarray | np.generic

# One number: a Python float, or an array without axes.
ScalarLike = Float[ArrayLike, ""] | float

# What properties give: NumPy and Python numbers; inside `jit`, `grad` and `vmap` what is traced.
# Type checkers see the former alone, as most callers see it.
if TYPE_CHECKING:
    NumpyOrTraced = np.ndarray
    FloatOrTraced = float
else:
    NumpyOrTraced = ArrayLike
    FloatOrTraced = ScalarLike


_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

# The state of a call that no `jit`, `grad` or `vmap` encloses, also where one imports this.
with jax.ensure_compile_time_eval():
    _OUTSIDE = get_opaque_trace_state()


def real_array(value: Any, name: str) -> np.ndarray:
    """An array of float64 of what a caller gave. Raises InputError for what are no numbers."""
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is {value!r:.60}, but must be numbers.") from error


def is_traced(*trees: Any) -> bool:
    """Whether `jit`, `grad` or `vmap` follows some array of the trees."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


def array_namespace(*trees: Any) -> ModuleType:
    """`jax.numpy` where something is traced, NumPy otherwise."""
    return jnp if is_traced(*trees) else np


def is_outside() -> bool:
    """Whether no `jit`, `grad` or `vmap` encloses the call."""
    return get_opaque_trace_state() == _OUTSIDE


def as_numpy(tree: Any) -> Any:
    """`tree` with every JAX array replaced by a NumPy array of the same dtype."""
    return jax.tree.map(_leaf_as_numpy, tree, is_leaf=lambda node: isinstance(node, dict))


def _leaf_as_numpy(leaf: Any) -> Any:
    if isinstance(leaf, dict):  # JAX would sort its keys; callers named their cameras in order
        return {key: as_numpy(value) for key, value in leaf.items()}
    if not isinstance(leaf, jax.Array):
        return leaf
    note_computation()
    return np.asarray(leaf)


def as_float(value: Any) -> Any:
    """One number as a Python float; a traced one as it is."""
    return value if is_traced(value) else float(value)


def in_float64(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Run `function` with 64-bit JAX arrays and hand its result back as NumPy.

    The setting is thread-local and ends with the call. A float64 JAX array that left the
    call would fall to float32 at its next operation, so none leaves: NumPy arrays do.

    With a traced argument `function` runs as it is: its result belongs to the trace, and so does
    the precision. Inside a trace, constant arguments still give NumPy.
    """

    @functools.wraps(function)
    def wrapper(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        if is_traced(args, kwargs):
            return function(*args, **kwargs)
        expect_no_fork()
        # Constants inside a trace are computed at once; elsewhere to say so costs compilations.
        at_once = contextlib.nullcontext() if is_outside() else jax.ensure_compile_time_eval()
        with at_once, jax.enable_x64(True):
            return as_numpy(function(*args, **kwargs))

    return wrapper
