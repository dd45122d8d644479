"""The array type of all signatures: a JAX array inside `jit`, a NumPy array outside."""

from typing import TYPE_CHECKING

import jax
import numpy as np
from jaxtyping import Float

# Indexing a NumPy array yields NumPy's own scalars, which are no arrays but behave as such.
# Type checkers are not told: their scalar type lacks operators that all arrays have.
if TYPE_CHECKING:
    ArrayLike = jax.Array | np.ndarray
else:
    ArrayLike = jax.Array | np.ndarray | np.generic

# One number: a Python float, or an array without axes.
ScalarLike = Float[ArrayLike, ""] | float
