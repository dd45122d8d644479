"""The median without NumPy's checks, which cost more than the sorting of a few numbers."""

import numpy as np
from jaxtyping import Float


def quick_median(values: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "..."]:
    """Upper median along the last axis."""
    return np.sort(values, axis=-1)[..., values.shape[-1] // 2]
