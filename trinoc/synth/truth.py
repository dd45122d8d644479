"""What is true of a scene and its pictures: edges, who shows which part, whose segment is whose."""

from collections.abc import Collection, Mapping

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.values import Value


class SeenParts(Value):
    """The parts of a scene's edges that one picture shows.

    Fields
    ------
    edge : (k,) index of the edge.
    extent : (k, 2) from where to where along it, 0 at its first end and 1 at its second.
    grey_step : (k,) grey level on the left of the way from the first end to the second, as
        seen on the picture, minus that on the right; NaN where not known.
    """

    edge: Int[np.ndarray, "k"]
    extent: Float[np.ndarray, "k 2"]
    grey_step: Float[np.ndarray, "k"]


class SceneTruth(Value):
    """Edges in space, and what each picture shows of them.

    Fields
    ------
    edges_mm : (m, 2, 3) ends of every edge.
    edge_kinds : "edge", or "rim" for a chord of a cylinder's rim.
    seen : for each view, the parts of the edges that its picture shows.
    """

    edges_mm: Float[np.ndarray, "m 2 3"]
    edge_kinds: tuple[str, ...] = eqx.field(static=True)
    seen: dict[str, SeenParts]


class SegmentTruth(Value):
    """Which edge each 2-D segment of each view comes from.

    Fields
    ------
    edges_mm : (m, 2, 3) ends of every edge.
    edge_of : for each view, (n,) index of each segment's edge; `SPURIOUS` where it has none,
        `NOT_SCORED` where an answer about it counts neither as right nor as wrong.
    extent : for each view, (n, 2) from where to where along the edge the segment reaches;
        anything where it has no edge.
    """

    edges_mm: Float[np.ndarray, "m 2 3"]
    edge_of: dict[str, Int[np.ndarray, "_"]]
    extent: dict[str, Float[np.ndarray, "_ 2"]]


SPURIOUS, NOT_SCORED = -1, -2


def points_along(
    segments_mm: Float[np.ndarray, "n 2 3"], position: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, "n k 3"]:
    """Points of segments at positions from 0, the first end, to 1, the second."""
    first, second = segments_mm[:, :1], segments_mm[:, 1:]
    return first + position[..., None] * (second - first)


def shown_parts_mm(
    truth: SceneTruth,
    *,
    views: int = 2,
    grey_step: float = 0.0,
    kinds: Collection[str] | None = None,
) -> Float[np.ndarray, "k 2 3"]:
    """Ends in space of the parts that at least `views` pictures show.

    A picture shows a part where its grey levels differ by at least `grey_step` across it.
    Only edges of `kinds` count; None is all of them.
    """
    chosen = {}
    for name, seen in truth.seen.items():
        enough = np.ones(len(seen.edge), dtype=bool)
        if grey_step > 0:
            enough = np.abs(seen.grey_step) >= grey_step
        if kinds is not None:
            enough &= np.array([truth.edge_kinds[edge] in kinds for edge in seen.edge], dtype=bool)
        chosen[name] = (seen.edge[enough], seen.extent[enough])
    return parts_in_views_mm(truth.edges_mm, chosen, views=views)


def shown_parts_of_segments_mm(
    truth: SegmentTruth, *, views: int = 2
) -> Float[np.ndarray, "k 2 3"]:
    """Ends in space of the parts of edges that segments of at least `views` views cover."""
    chosen = {}
    for name, edge in truth.edge_of.items():
        real = edge >= 0
        chosen[name] = (edge[real], truth.extent[name][real])
    return parts_in_views_mm(truth.edges_mm, chosen, views=views)


def parts_in_views_mm(
    edges_mm: Float[np.ndarray, "m 2 3"],
    parts: Mapping[str, tuple[Int[np.ndarray, "_"], Float[np.ndarray, "_ 2"]]],
    *,
    views: int,
) -> Float[np.ndarray, "k 2 3"]:
    """Ends in space of the parts of edges that (edge, extent) lists of several views share."""
    found: list[Float[np.ndarray, "2 3"]] = []
    for index, edge in enumerate(edges_mm):
        per_view = [_union(extent[owner == index]) for owner, extent in parts.values()]
        for start, end in _intersect_intervals(per_view, views):
            ends = np.array([[start], [end]])
            found.append(edge[0] + ends * (edge[1] - edge[0]))
    return np.array(found).reshape(-1, 2, 3)


def _union(intervals: Float[np.ndarray, "k 2"]) -> list[tuple[float, float]]:
    """Disjoint intervals that cover the same points, in order."""
    merged: list[tuple[float, float]] = []
    for start, end in sorted((float(a), float(b)) for a, b in np.sort(intervals, axis=1)):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], end))
        else:
            merged.append((start, end))
    return merged


def _intersect_intervals(
    per_view: list[list[tuple[float, float]]], views: int
) -> list[tuple[float, float]]:
    """Where the disjoint intervals of at least `views` views lie over each other."""
    events = sorted(
        [(start, 1) for intervals in per_view for start, _ in intervals]
        + [(end, -1) for intervals in per_view for _, end in intervals],
        key=lambda event: (event[0], -event[1]),
    )
    covered, depth, opened = [], 0, 0.0
    for position, change in events:
        if depth < views <= depth + change:
            opened = position
        if depth + change < views <= depth and position > opened:
            covered.append((opened, position))
        depth += change
    return covered
