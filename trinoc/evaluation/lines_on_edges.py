"""Which line in space lies on which edge, how far off, and how far off its covariance lets it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.evaluation.distances import nearest_segments
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.numerics.vectors import complete_axes
from trinoc.synth.truth import points_along

# Places along a line at which its nearest edge is asked for; odd, so that one is the middle.
_PLACES = 9
# Lines at a larger angle to an edge cross it rather than lie on it.
_CROSSES_DEG = 60.0


class OffsetsAcross(NamedTuple):
    """Of lines that lie on an edge: offsets of the edge across the line at the line's two ends.

    Fields
    ------
    offset_mm : (n, 4) across in two directions at the first end, then at the second.
    own_mm2 : (n, 4, 4) covariance of the line's ends in these directions, the line's own part.
    by_parameters : (n, 4, k) how these numbers follow the cameras' parameters.
    """

    offset_mm: Float[np.ndarray, "n 4"]
    own_mm2: Float[np.ndarray, "n 4 4"]
    by_parameters: Float[np.ndarray, "n 4 k"]


def select_lines(
    lines: UncertainLines, rows: Int[np.ndarray, "n"] | Bool[np.ndarray, "t"]
) -> UncertainLines:
    """Some of the lines, by index or mask."""
    return UncertainLines(
        lines.ends_mm[rows],
        lines.fragment_covariance_mm2[rows],
        lines.by_parameters[rows],
        lines.parameter_covariance,
    )


def edge_of_lines(
    lines_mm: Float[np.ndarray, "t 2 3"], edges_mm: Float[np.ndarray, "m 2 3"], reach_mm: float
) -> Int[np.ndarray, "t"]:
    """The edge on which each line lies; -1 where on none.

    A line lies on the edge that is the nearest to most of its length within `reach_mm`, if that
    is half of its length or more, and it does not cross it.
    """
    place = (np.arange(_PLACES) + 0.5) / _PLACES
    points = points_along(lines_mm, np.tile(place, (len(lines_mm), 1)))
    near = nearest_segments(points.reshape(-1, 3), edges_mm)
    nearest = np.where(near.distance_mm <= reach_mm, near.segment, -1).reshape(-1, _PLACES)
    # What more than half of them name is in the middle of the names in order.
    middle = np.sort(nearest, axis=1)[:, _PLACES // 2]
    most = (nearest == middle[:, None]).sum(axis=1) * 2 > _PLACES
    edge = np.where(most, middle, -1)
    on = np.flatnonzero(edge >= 0)
    crosses = angles_deg(lines_mm[on], edges_mm[edge[on]]) >= _CROSSES_DEG
    edge[on[crosses]] = -1
    return edge


def angles_deg(
    lines_mm: Float[np.ndarray, "n 2 3"], edges_mm: Float[np.ndarray, "n 2 3"]
) -> Float[np.ndarray, "n"]:
    """Angle of each line with its edge, from 0 to 90 degrees."""
    a, b = lines_mm[:, 1] - lines_mm[:, 0], edges_mm[:, 1] - edges_mm[:, 0]
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    return np.degrees(np.arctan2(sine, np.abs(np.sum(a * b, axis=1))))


def offsets_across(lines: UncertainLines, edges_mm: Float[np.ndarray, "n 2 3"]) -> OffsetsAcross:
    """Offsets of the (infinite) line of each edge in the planes normal to a line at its ends.

    The planes are those of the line, not of the edge, so that what is not known of an end's
    place along the line does not enter.
    """
    ends = lines.ends_mm
    along = ends[:, 1] - ends[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    across = complete_axes(along)
    start, step = edges_mm[:, 0], edges_mm[:, 1] - edges_mm[:, 0]
    position = np.einsum("nei,ni->ne", ends - start[:, None], along)
    position = position / np.sum(step * along, axis=1, keepdims=True)
    offset = start[:, None] + position[..., None] * step[:, None] - ends
    both = np.zeros((len(ends), 4, 6))
    both[:, :2, :3] = both[:, 2:, 3:] = across
    return OffsetsAcross(
        np.einsum("nai,nei->nea", across, offset).reshape(-1, 4),
        both @ lines.fragment_covariance_mm2 @ both.mT,
        both @ lines.by_parameters,
    )
