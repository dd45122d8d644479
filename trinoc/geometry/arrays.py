"""The array type of all signatures: a JAX array inside `jit`, a NumPy array outside."""

import jax
import numpy as np

ArrayLike = jax.Array | np.ndarray
