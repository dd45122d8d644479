"""Polylines as straight edges: points on one straight line are one edge."""

import numpy as np
from jaxtyping import Float

# Points lie on the edge from the first to the last of a run to within this share of its length:
# more than the digits of a file round off, and less than the chords of an arc that turn by a
# twentieth of a degree.
STRAIGHT = 1e-4


def straight_runs(
    points: Float[np.ndarray, "n 3"], *, tolerance: float = STRAIGHT
) -> Float[np.ndarray, "k 2 3"]:
    """Edges along a polyline, each as long as its points lie straight on; a closed polyline
    repeats its first point. Points given twice in a row count once."""
    apart = np.append(True, np.any(points[1:] != points[:-1], axis=1))
    points = points[apart]
    edges, start = [], 0
    while start < len(points) - 1:
        stop = start + 1
        while stop + 1 < len(points) and _is_straight(points[start : stop + 2], tolerance):
            stop += 1
        edges.append(points[[start, stop]])
        start = stop
    runs = np.array(edges).reshape(-1, 2, 3)
    closed = len(runs) > 1 and np.array_equal(points[0], points[-1])
    # A closed polyline may begin in the middle of an edge.
    if closed and _is_straight(np.array([runs[-1, 0], points[0], runs[0, 1]]), tolerance):
        runs = np.concatenate([np.stack([runs[-1, 0], runs[0, 1]])[None], runs[1:-1]])
    return runs


def _is_straight(points: Float[np.ndarray, "n 3"], tolerance: float) -> bool:
    """Whether inner points lie on the way from the first to the last, one after the other."""
    chord = points[-1] - points[0]
    length = np.linalg.norm(chord)
    if length == 0:
        return False
    along = (points - points[0]) @ chord / length
    across = np.linalg.norm(points - points[0] - along[:, None] * chord / length, axis=1)
    return bool(across.max() <= tolerance * length and (np.diff(along) > 0).all())
