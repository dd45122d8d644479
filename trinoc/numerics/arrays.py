"""The array type of all signatures: a JAX array inside `jit`, a NumPy array outside."""

from typing import TYPE_CHECKING

import jax
import numpy as np
from jaxtyping import Float

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
