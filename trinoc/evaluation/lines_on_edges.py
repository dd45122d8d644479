"""Assignment of 3-D lines to known edges, and their offsets with covariance."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.evaluation.distances import nearest_segments
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.numerics.vectors import complete_axes
from trinoc.synth.truth import points_along

# Samples along a line for the nearest edge; odd, so that a median exists.
_SAMPLES = 9
# Lines at a larger angle to an edge cross it.
_CROSSES_DEG = 60.0


class OffsetsAcross(NamedTuple):
    """Offsets from lines to their known edges, perpendicular to the lines, at the lines' ends.

    Attributes
    ----------
    offset_mm : (n, 4)
        Offsets in two perpendicular directions at the first end of a line, then at the second end.
    fragment_covariance_mm2 : (n, 4, 4)
        Part of the covariance of the offsets that comes from the noise of the line's fragments.
    by_parameters : (n, 4, k)
        Derivative of the offsets by the camera parameters.
    """

    offset_mm: Float[np.ndarray, "n 4"]
    fragment_covariance_mm2: Float[np.ndarray, "n 4 4"]
    by_parameters: Float[np.ndarray, "n 4 k"]


def select_lines(
    lines: UncertainLines, rows: Int[np.ndarray, "n"] | Bool[np.ndarray, "t"]
) -> UncertainLines:
    """Return the lines that an index array or a mask selects."""
    return UncertainLines(
        lines.ends_mm[rows],
        lines.fragment_covariance_mm2[rows],
        lines.by_parameters[rows],
        lines.parameter_covariance,
    )


def edge_of_lines(
    lines_mm: Float[np.ndarray, "t 2 3"], edges_mm: Float[np.ndarray, "m 2 3"], reach_mm: float
) -> Int[np.ndarray, "t"]:
    """Index of the edge that each line lies on, (t,); -1 for none.

    More than half of the line must be nearer to this edge than to any other edge, and at most
    `reach_mm` away. The angle between line and edge must be below 60 degrees.
    """
    position = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    points = points_along(lines_mm, np.tile(position, (len(lines_mm), 1)))
    nearest_edges = nearest_segments(points.reshape(-1, 3), edges_mm)
    edge_index = np.where(nearest_edges.distance_mm <= reach_mm, nearest_edges.segment, -1).reshape(
        -1, _SAMPLES
    )
    # A majority value is the median of the sorted indices.
    median_index = np.sort(edge_index, axis=1)[:, _SAMPLES // 2]
    has_majority = (edge_index == median_index[:, None]).sum(axis=1) * 2 > _SAMPLES
    edge = np.where(has_majority, median_index, -1)
    matched = np.flatnonzero(edge >= 0)
    crosses = angles_deg(lines_mm[matched], edges_mm[edge[matched]]) >= _CROSSES_DEG
    edge[matched[crosses]] = -1
    return edge


def angles_deg(
    lines_mm: Float[np.ndarray, "n 2 3"], edges_mm: Float[np.ndarray, "n 2 3"]
) -> Float[np.ndarray, "n"]:
    """Angle between each line and its edge, (n,), from 0 to 90 degrees."""
    a, b = lines_mm[:, 1] - lines_mm[:, 0], edges_mm[:, 1] - edges_mm[:, 0]
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    return np.degrees(np.arctan2(sine, np.abs(np.sum(a * b, axis=1))))


def offsets_across(lines: UncertainLines, edges_mm: Float[np.ndarray, "n 2 3"]) -> OffsetsAcross:
    """Compute the offset from each line to its edge, perpendicular to the line, at both ends.

    The offset at an end is measured in the plane through the end, normal to the line, up to the
    infinite line of the edge. So an error of the end along its line has no effect.
    """
    ends = lines.ends_mm
    along = ends[:, 1] - ends[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    across = complete_axes(along)
    start, step = edges_mm[:, 0], edges_mm[:, 1] - edges_mm[:, 0]
    position = np.einsum("nei,ni->ne", ends - start[:, None], along)
    position = position / np.sum(step * along, axis=1, keepdims=True)
    offset = start[:, None] + position[..., None] * step[:, None] - ends
    projection = np.zeros((len(ends), 4, 6))
    projection[:, :2, :3] = projection[:, 2:, 3:] = across
    return OffsetsAcross(
        np.einsum("nai,nei->nea", across, offset).reshape(-1, 4),
        projection @ lines.fragment_covariance_mm2 @ projection.mT,
        projection @ lines.by_parameters,
    )
