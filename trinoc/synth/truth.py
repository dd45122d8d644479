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
        Index of the edge.
    extent : (k, 2)
        Start and stop along the edge: 0 at its first end, 1 at its second.
    grey_step : (k,)
        Grey level on the left of the direction from the first end to the second, as displayed,
        minus that on the right; NaN if unknown.
    """

    edge: Int[np.ndarray, "k"]
    extent: Float[np.ndarray, "k 2"]
    grey_step: Float[np.ndarray, "k"]


class SceneTruth(Value):
    """Edges in space, and their visible parts in each image.

    Attributes
    ----------
    edges_mm : (m, 2, 3)
        Ends of every edge.
    edge_kinds : tuple of str
        "edge", or "rim" for a chord of a cylinder's rim.
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
        For each view, the edge of each segment. `SPURIOUS`: none. `NOT_SCORED`: a result on this
        segment counts neither as right nor as wrong.
    extent : dict of (n, 2)
        For each view, start and stop of the segment along its edge; any value without an edge.
    """

    edges_mm: Float[np.ndarray, "m 2 3"]
    edge_of: dict[str, Int[np.ndarray, "_"]]
    extent: dict[str, Float[np.ndarray, "_ 2"]]


SPURIOUS, NOT_SCORED = -1, -2


def points_along(
    segments_mm: Float[np.ndarray, "n 2 3"], position: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, "n k 3"]:
    """Points of segments at positions from 0 (first end) to 1 (second end), (n, k, 3)."""
    first, second = segments_mm[:, :1], segments_mm[:, 1:]
    return first + position[..., None] * (second - first)


def shown_parts_mm(
    truth: SceneTruth,
    *,
    views: int = 2,
    grey_step: float = 0.0,
    kinds: Collection[str] | None = None,
) -> Float[np.ndarray, "k 2 3"]:
    """Ends of the edge parts that are visible in at least `views` images, (k, 2, 3).

    A part is visible in an image if grey levels differ by at least `grey_step` across it. Only
    edges of `kinds` count; None means all.
    """
    chosen = {}
    for name, visible in truth.seen.items():
        counts = np.ones(len(visible.edge), dtype=bool)
        if grey_step > 0:
            counts = np.abs(visible.grey_step) >= grey_step
        if kinds is not None:
            counts &= np.array(
                [truth.edge_kinds[edge] in kinds for edge in visible.edge], dtype=bool
            )
        chosen[name] = (visible.edge[counts], visible.extent[counts])
    return parts_in_views_mm(truth.edges_mm, chosen, views=views)


def shown_parts_of_segments_mm(
    truth: SegmentTruth, *, views: int = 2
) -> Float[np.ndarray, "k 2 3"]:
    """Ends of the edge parts that segments of at least `views` views cover, (k, 2, 3)."""
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
    """Ends of the edge parts that lists of at least `views` views contain, (k, 2, 3).

    `parts` has (edge, extent) of each view.
    """
    shared_parts: list[Float[np.ndarray, "2 3"]] = []
    for index, edge in enumerate(edges_mm):
        per_view = [_union(extent[owner == index]) for owner, extent in parts.values()]
        for start, end in _intersect_intervals(per_view, views):
            ends = np.array([[start], [end]])
            shared_parts.append(edge[0] + ends * (edge[1] - edge[0]))
    return np.array(shared_parts).reshape(-1, 2, 3)


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
    """Intervals that lie in the disjoint intervals of at least `views` views."""
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
