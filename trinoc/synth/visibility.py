"""Hidden line removal: exact visible parts of 3-D segments.

The region that a triangle hides from a viewpoint is convex: behind its plane and inside the three
planes through the viewpoint and its sides. So a segment meets it in one interval, given by four
linear inequalities. The visible parts remain after all triangles and the image frame are
subtracted.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.camera import Camera

# Smallest depth behind a face that counts as hidden, so that a face does not hide its own edges.
_BEHIND_MM = 1e-6
# Shorter intervals, as a share of the segment, are rounding errors.
_SLIVER = 1e-7


class VisibleParts(NamedTuple):
    """Visible parts of segments.

    Attributes
    ----------
    segment : (k,)
        Index of the segment to which each part belongs.
    extent : (k, 2)
        Start and stop of each part along its segment: 0 at the first end, 1 at the second end.
    """

    segment: Int[np.ndarray, "k"]
    extent: Float[np.ndarray, "k 2"]


def visible_parts(
    camera: Camera,
    segments_mm: Float[np.ndarray, "n 2 3"],
    triangles_mm: Float[np.ndarray, "t 3 3"],
) -> VisibleParts:
    """Parts of segments that are inside the image and that no triangle hides.

    The lens is assumed to have no distortion.

    Parameters
    ----------
    camera : Camera
        The camera.
    segments_mm : (n, 2, 3)
        Ends of the segments.
    triangles_mm : (t, 3, 3)
        Corners of the triangles.
    """
    hidden = hidden_intervals(camera.centre_world_mm, segments_mm, triangles_mm)
    framed = _interval(*_frame_values(camera, segments_mm))
    segment, extent = [], []
    for index, (intervals, (low, high)) in enumerate(zip(hidden, framed, strict=True)):
        for start, end in _remainder(low, high, intervals):
            segment.append(index)
            extent.append((start, end))
    return VisibleParts(np.array(segment, dtype=np.int64), np.array(extent).reshape(-1, 2))


def hidden_intervals(
    centre_world_mm: Float[np.ndarray, "3"],
    segments_mm: Float[np.ndarray, "n 2 3"],
    triangles_mm: Float[np.ndarray, "t 3 3"],
) -> Float[np.ndarray, "n t 2"]:
    """Part of each segment that each triangle hides, (n, t, 2).

    Parameters
    ----------
    centre_world_mm : (3,)
        Centre of the camera.
    segments_mm : (n, 2, 3)
        Ends of the segments.
    triangles_mm : (t, 3, 3)
        Corners of the triangles.

    Returns
    -------
    (n, t, 2)
        Start and stop along the segment, from 0 to 1; start > stop if nothing is hidden.
    """
    corners = triangles_mm - centre_world_mm
    ends = segments_mm - centre_world_mm
    following = np.roll(corners, -1, axis=1)
    sides = _unit(np.cross(corners, following))
    inward = np.sign(np.einsum("tsi,tsi->ts", sides, np.roll(corners, -2, axis=1)))
    sides = sides * inward[..., None]
    normal = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    level = np.einsum("ti,ti->t", normal, corners[:, 0])
    away = np.sign(level)
    # A triangle viewed edge-on hides nothing. A face's own edges lie in its plane, not behind it.
    edge_on = np.abs(level) < _BEHIND_MM
    inside = np.einsum("tsi,nei->ntes", sides, ends)
    behind = np.einsum("ti,nei->nte", normal * away[:, None], ends) - np.abs(level)[:, None]
    values = np.concatenate([inside, behind[..., None] - _BEHIND_MM], axis=-1)
    intervals = _interval(values[:, :, 0], values[:, :, 1])
    return np.where(edge_on[:, None], np.array([1.0, 0.0]), intervals)


def _frame_values(
    camera: Camera, segments_mm: Float[np.ndarray, "n 2 3"]
) -> tuple[Float[np.ndarray, "n 5"], Float[np.ndarray, "n 5"]]:
    """Five values at both ends of each segment, (n, 5); they are positive inside the image.

    They are linear along the segment. The first is the depth, the others are distances from the
    sides of the image.
    """
    first, second, third = camera.matrix_px
    width, height = camera.image_size_px
    planes = np.stack(
        [
            third,
            first + 0.5 * third,
            (width - 0.5) * third - first,
            second + 0.5 * third,
            (height - 0.5) * third - second,
        ]
    )
    values = segments_mm @ planes[:, :3].T + planes[:, 3]
    return values[:, 0], values[:, 1]


def _interval(
    first: Float[np.ndarray, "*n k"], second: Float[np.ndarray, "*n k"]
) -> Float[np.ndarray, "*n 2"]:
    """Interval (start, stop) of a segment in which k values are all >= 0.

    first, second : values at the first and second end; they are linear in between.
    """
    change = second - first
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -first / change
    never = (change == 0) & (first < 0)
    low = np.where(change > 0, crossing, np.where(never, np.inf, 0.0))
    high = np.where(change < 0, crossing, np.where(never, -np.inf, 1.0))
    return np.stack(
        [np.maximum(low.max(axis=-1), 0.0), np.minimum(high.min(axis=-1), 1.0)], axis=-1
    )


def _remainder(
    low: float, high: float, hidden: Float[np.ndarray, "t 2"]
) -> list[tuple[float, float]]:
    """Parts of the interval [low, high] that are outside all hidden intervals."""
    if low > high:
        return []
    is_hidden: Bool[np.ndarray, "t"] = hidden[:, 1] >= hidden[:, 0]
    parts, position = [], float(low)
    for start, end in sorted(map(tuple, hidden[is_hidden])):
        if start > position + _SLIVER:
            parts.append((position, min(float(start), float(high))))
        position = max(position, float(end))
        if position >= high:
            break
    if position < high - _SLIVER:
        parts.append((position, float(high)))
    return [(start, end) for start, end in parts if end - start > _SLIVER]


def _unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)
