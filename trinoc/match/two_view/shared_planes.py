"""Pairs of segments of two views that share epipolar planes, and those of which an end agrees."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.observations import SegmentTable
from trinoc.match.two_view.epipolar_pencil import Pencil, PencilSegments, plane_angles
from trinoc.numerics import blocks_of_overlapping, overlapping


def pairs_sharing_planes(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    planes: Pencil,
    rows: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
    at_once: int,
    ends_px: float | None = None,
) -> Iterator[tuple[Int[np.ndarray, "_p"], Int[np.ndarray, "_p"]]]:
    """Pairs of those rows that share epipolar planes, each once, about so many at a time.

    With `ends_px`, only those of which the low ends or the high ends have the same plane, give or
    take so many pixels along either segment.
    """
    first, second = (own.astype(np.int32) for own in rows)
    of_views = [
        plane_angles(lines, int(view), segments)
        for view, segments in zip(views, (planes.first, planes.second), strict=True)
    ]
    if ends_px is None:
        joined = [(of_views[0][first], of_views[1][second])]
    else:
        about = [
            end_angles(lines, int(view), segments, angles, ends_px)
            for view, segments, angles in zip(
                views, (planes.first, planes.second), of_views, strict=True
            )
        ]
        joined = [(about[0][first, end], about[1][second, end]) for end in range(2)]
    for number, (of_first, of_second) in enumerate(joined):
        for block in blocks_of_overlapping(of_first, of_second, at_once):
            i, j = overlapping(of_first[block], of_second)
            i += block.start
            if number:
                # Those of which both ends agree have been met.
                one, other = joined[0][0][i], joined[0][1][j]
                fresh = (one[:, 1] <= other[:, 0]) | (other[:, 1] <= one[:, 0])
                i, j = i[fresh], j[fresh]
            yield first[i], second[j]


def end_angles(
    lines: SegmentTable,
    view: int,
    segments: PencilSegments,
    angles: Float[np.ndarray, "n 2"],
    reach_px: float,
    sigmas: float = 4.0,
) -> Float[np.ndarray, "n 2 2"]:
    """Ranges of plane angle about both ends, low and high, that reach so far along the segment, and
    as many standard deviations further as its direction turns the end's plane."""
    variance = np.stack([np.asarray(x) for x in segments.end_variance_px2], axis=1)
    span = (angles[:, 1] - angles[:, 0])[:, None]
    length = np.asarray(lines.length_px)[view, : len(angles), None]
    reach = (reach_px + sigmas * np.sqrt(variance)) * span / length
    return np.stack([angles - reach, angles + reach], axis=2)
