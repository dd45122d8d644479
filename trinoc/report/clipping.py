"""Lines of a picture cut at its edge."""

import numpy as np
from jaxtyping import Float


def clip_line(
    line: Float[np.ndarray, "3"], size_px: tuple[int, int]
) -> Float[np.ndarray, "2 2"] | None:
    """The part of a line that lies on a picture, or None where it misses or is not finite."""
    if not np.isfinite(line).all():
        return None
    a, b, c = line
    foot = -c * np.array([a, b]) / (a * a + b * b)
    direction = np.array([-b, a]) / np.hypot(a, b)
    low, high = np.full(2, -0.5), np.array(size_px) - 0.5
    # A line along an axis never crosses two of the sides: it is inside them or outside.
    along = np.abs(direction) < 1e-12
    step = np.where(along, 1.0, direction)
    crossings = np.stack([(low - foot) / step, (high - foot) / step])
    inside = (foot >= low) & (foot <= high)
    entry = np.where(along, np.where(inside, -np.inf, np.inf), crossings.min(axis=0)).max()
    leave = np.where(along, np.where(inside, np.inf, -np.inf), crossings.max(axis=0)).min()
    if not entry < leave:
        return None
    return np.stack([foot + entry * direction, foot + leave * direction])
