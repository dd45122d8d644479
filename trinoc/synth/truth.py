"""Truth of a synthetic scene: its edges, their visible parts, and the edge of each segment."""

from collections.abc import Collection, Mapping

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.values import Value


class SeenParts(Value):
    """Parts of a scene's edges that are visible in one image.

    Attributes
    ----------
    edge : (k,)
        Index of the edge to which each part belongs.
    extent : (k, 2)
        Start and stop of each part along its edge: 0 at the first end, 1 at the second end.
    grey_step : (k,)
        Grey level on the left of the direction from the first end to the second end, as displayed,
        minus the level on the right; NaN if unknown.
    """

    edge: Int[np.ndarray, "k"]
    extent: Float[np.ndarray, "k 2"]
    grey_step: Float[np.ndarray, "k"]


class SceneTruth(Value):
    """True edges of a synthetic scene, and their visible parts in each image.

    Attributes
    ----------
    edges_mm : (m, 2, 3)
        Ends of every edge.
    edge_kinds : tuple of str
        Kind of every edge: "edge", or "rim" for a chord of a cylinder's rim.
    seen : dict of SeenParts
        For each view, the visible parts of the edges.
    """

    edges_mm: Float[np.ndarray, "m 2 3"]
    edge_kinds: tuple[str, ...] = eqx.field(static=True)
    seen: dict[str, SeenParts]


class SegmentTruth(Value):
    """True edge of each 2-D segment of each view.

    Attributes
    ----------
    edges_mm : (m, 2, 3)
        Ends of every edge.
    edge_of : dict of (n,)
        For each view, the index of the edge of each segment. `SPURIOUS`: the segment shows no edge.
        `NOT_SCORED`: a result on this segment is neither right nor wrong.
    extent : dict of (n, 2)
        For each view, start and stop of each segment along its edge; undefined for a segment
        without an edge.
    """

    edges_mm: Float[np.ndarray, "m 2 3"]
    edge_of: dict[str, Int[np.ndarray, "_"]]
    extent: dict[str, Float[np.ndarray, "_ 2"]]


SPURIOUS, NOT_SCORED = -1, -2


def points_along(
    segments_mm: Float[np.ndarray, "n 2 3"], position: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, "n k 3"]:
    """Points on segments, (n, k, 3), at k positions from 0 (first end) to 1 (second end).

    Parameters
    ----------
    segments_mm : (n, 2, 3)
        Ends of the segments.
    position : (n, k)
        Positions along each segment.
    """
    first, second = segments_mm[:, :1], segments_mm[:, 1:]
    return first + position[..., None] * (second - first)


def shown_parts_mm(
    truth: SceneTruth,
    *,
    views: int = 2,
    grey_step: float = 0.0,
    kinds: Collection[str] | None = None,
) -> Float[np.ndarray, "k 2 3"]:
    """Parts of the edges that are visible in at least `views` images, (k, 2, 3).

    Parameters
    ----------
    truth : SceneTruth
        The edges and their visible parts.
    views : int
        Smallest number of images.
    grey_step : float
        Smallest difference of the grey levels on both sides of a visible part.
    kinds : collection of str, optional
        Only edges of these kinds are used. Default: all edges.

    Returns
    -------
    (k, 2, 3)
        Ends of the parts, mm.
    """
    parts_by_view = {}
    for name, visible in truth.seen.items():
        is_visible = np.ones(len(visible.edge), dtype=bool)
        if grey_step > 0:
            is_visible = np.abs(visible.grey_step) >= grey_step
        if kinds is not None:
            is_visible &= np.array(
                [truth.edge_kinds[edge] in kinds for edge in visible.edge], dtype=bool
            )
        parts_by_view[name] = (visible.edge[is_visible], visible.extent[is_visible])
    return parts_in_views_mm(truth.edges_mm, parts_by_view, views=views)


def shown_parts_of_segments_mm(
    truth: SegmentTruth, *, views: int = 2
) -> Float[np.ndarray, "k 2 3"]:
    """Parts of the edges that are covered by segments of at least `views` views, (k, 2, 3).

    Parameters
    ----------
    truth : SegmentTruth
        The edges and the edge of each segment.
    views : int
        Smallest number of views.
    """
    parts_by_view = {}
    for name, edge in truth.edge_of.items():
        has_edge = edge >= 0
        parts_by_view[name] = (edge[has_edge], truth.extent[name][has_edge])
    return parts_in_views_mm(truth.edges_mm, parts_by_view, views=views)


def parts_in_views_mm(
    edges_mm: Float[np.ndarray, "m 2 3"],
    parts: Mapping[str, tuple[Int[np.ndarray, "_"], Float[np.ndarray, "_ 2"]]],
    *,
    views: int,
) -> Float[np.ndarray, "k 2 3"]:
    """Parts of edges that occur in at least `views` views, (k, 2, 3).

    Parameters
    ----------
    edges_mm : (m, 2, 3)
        Ends of every edge.
    parts : mapping of str to ((k,), (k, 2))
        For each view, parts of edges: index of the edge, and start and stop along it from 0 to 1.
    views : int
        Smallest number of views.

    Returns
    -------
    (k, 2, 3)
        Ends of the parts, mm.
    """
    shared_parts: list[Float[np.ndarray, "2 3"]] = []
    for index, edge in enumerate(edges_mm):
        per_view = [_union(extent[owner == index]) for owner, extent in parts.values()]
        for start, end in _intersect_intervals(per_view, views):
            ends = np.array([[start], [end]])
            shared_parts.append(edge[0] + ends * (edge[1] - edge[0]))
    return np.array(shared_parts).reshape(-1, 2, 3)


def _union(intervals: Float[np.ndarray, "k 2"]) -> list[tuple[float, float]]:
    """Disjoint intervals that cover the same points as the given intervals, in ascending order."""
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
    """Intervals that at least `views` views cover. The intervals of one view are disjoint."""
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
