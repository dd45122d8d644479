"""How long an edge is by the lines that lie on it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.uncertain_lines import UncertainLines

# An edge counts as measured where lines cover half of it or more.
LEAST_COVERED = 0.5


class EdgeLengths(NamedTuple):
    """Of the edges that ought to be found from end to end.

    Fields
    ------
    edge : (w,) which edge of the shape.
    true_mm : (w,) its length.
    covered : (w,) share of it that lines lie on.
    measured_mm : (w,) from the first to the last end of the lines on it; NaN where they cover less
        than half.
    sigma_mm : (w,) of the measured length, by the covariance of these two ends; NaN where none.
    """

    edge: Int[np.ndarray, "w"]
    true_mm: Float[np.ndarray, "w"]
    covered: Float[np.ndarray, "w"]
    measured_mm: Float[np.ndarray, "w"]
    sigma_mm: Float[np.ndarray, "w"]

    @property
    def error_mm(self) -> Float[np.ndarray, "w"]:
        """Measured less true; NaN where not measured."""
        return self.measured_mm - self.true_mm


def edge_lengths(
    lines: UncertainLines,
    edge_of: Int[np.ndarray, "t"],
    edges_mm: Float[np.ndarray, "m 2 3"],
    wanted: Int[np.ndarray, "w"],
) -> EdgeLengths:
    """Lengths of the `wanted` edges from lines of which each lies on the edge `edge_of`, or -1.

    Collinear lines on one edge are joined across gaps; their ends count where they fall along it.
    """
    count = len(wanted)
    true, covered = np.zeros(count), np.zeros(count)
    measured, sigma = np.full(count, np.nan), np.full(count, np.nan)
    for row, edge in enumerate(wanted):
        first, second = edges_mm[edge]
        true[row] = np.linalg.norm(second - first)
        direction = (second - first) / true[row]
        on = np.flatnonzero(edge_of == edge)
        if len(on) == 0:
            continue
        position = (lines.ends_mm[on] - first) @ direction
        covered[row] = _union_length(np.clip(position, 0.0, true[row])) / true[row]
        if covered[row] < LEAST_COVERED:
            continue
        measured[row] = np.ptp(position)
        by_ends = np.zeros((2 * len(on), 3))
        by_ends[position.argmax()] += direction
        by_ends[position.argmin()] -= direction
        spread = lines.joint_covariance_mm2(on.tolist())
        variance = float(by_ends.reshape(-1) @ spread @ by_ends.reshape(-1))
        sigma[row] = np.sqrt(variance) if variance > 0 else np.nan
    return EdgeLengths(wanted, true, covered, measured, sigma)


def _union_length(intervals: Float[np.ndarray, "n 2"]) -> float:
    """Length of the line that intervals cover together."""
    start, end = np.array(sorted(np.sort(intervals, axis=1).tolist())).T
    reached = np.maximum.accumulate(end)
    before = np.append(-np.inf, reached[:-1])
    return float(np.maximum(end - np.maximum(start, before), 0.0).sum())
