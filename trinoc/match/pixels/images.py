"""Images of the matched lines in one view, and the position of their segments relative to them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.intrinsics import Intrinsics, undistort_pixels
from trinoc.geometry.projection import project_by_matrix
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches


class LineImages(NamedTuple):
    """Images of s lines in space in one view, in undistorted pixels.

    Positions along an image are measured from the image of the line's first end.

    Attributes
    ----------
    track : (s,)
        Track of each line.
    segment : (s,)
        Segment of the track in this view.
    ends_px : (s, 2, 2)
        Image of the line's two ends.
    direction, normal : (s, 2)
        Unit vectors along the image and perpendicular to it.
    length_px : (s,)
        Distance between the two ends.
    extent_px : (s, 2)
        Interval of the segment along the image.
    offset_px : (s, 2)
        Distance from the image to the extrapolated segment, along `normal`, at both ends of the
        image.
    covariance_px2 : (s, 2, 2)
        Covariance of these two distances.
    """

    track: Int[np.ndarray, "s"]
    segment: Int[np.ndarray, "s"]
    ends_px: Float[np.ndarray, "s 2 2"]
    direction: Float[np.ndarray, "s 2"]
    normal: Float[np.ndarray, "s 2"]
    length_px: Float[np.ndarray, "s"]
    extent_px: Float[np.ndarray, "s 2"]
    offset_px: Float[np.ndarray, "s 2"]
    covariance_px2: Float[np.ndarray, "s 2 2"]


def line_images(
    matches: Matches,
    view: int,
    segments: Segments,
    matrix_px: Float[np.ndarray, "3 4"],
    lens: Intrinsics,
) -> LineImages:
    """Project all lines that a view shows, and compute the offsets of their segments.

    The covariances of the segments are multiplied by the square of the noise scale.
    """
    track = np.flatnonzero(matches.index[:, view] >= 0)
    segment = matches.index[track, view]
    ends = project_by_matrix(matrix_px, matches.lines_mm[track])
    direction = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.linalg.norm(direction, axis=1), 1e-9)
    direction = direction / length[:, None]
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    segment_ends = undistort_pixels(
        lens, np.asarray(segments.endpoints_px, dtype=np.float64)[segment]
    )
    offset = segment_ends - ends[:, :1]
    along, across = (np.einsum("sei,si->se", offset, axis) for axis in (direction, normal))
    # The line through the segment, extrapolated to the line's ends.
    extent = along[:, 1] - along[:, 0]
    extent = np.where(np.abs(extent) > 1e-6, extent, 1e-6)
    share = (np.stack([np.zeros(len(length)), length], axis=1) - along[:, :1]) / extent[:, None]
    weight = np.stack([1 - share, share], axis=2)
    segment_step = segment_ends[:, 1] - segment_ends[:, 0]
    segment_normal = np.stack([-segment_step[:, 1], segment_step[:, 0]], axis=1)
    segment_normal /= np.linalg.norm(segment_step, axis=1)[:, None]
    # The ends of the segment may have the opposite order.
    segment_normal *= np.sign((segment_normal * normal).sum(axis=1))[:, None]
    blocks = np.asarray(segments.covariance_px2)[segment].reshape(-1, 2, 2, 2, 2)
    covariance = np.einsum("seifj,si,sj->sef", blocks, segment_normal, segment_normal)
    covariance = covariance * matches.noise_scale**2
    return LineImages(
        track,
        segment,
        ends,
        direction,
        normal,
        length,
        np.sort(along, axis=1),
        (weight @ across[..., None])[..., 0],
        weight @ covariance @ weight.mT,
    )


def interpolate_offset(
    offset_px: Float[np.ndarray, "s 2"], share: Float[np.ndarray, "s k"]
) -> Float[np.ndarray, "s k"]:
    """Interpolate the offsets at both ends of a line to other positions, (s, k).

    `share` are the positions along the line: 0 at its first end, 1 at its second.
    """
    return (1 - share) * offset_px[:, :1] + share * offset_px[:, 1:]
