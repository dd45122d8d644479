"""Images of the matched lines in one view, and the position of their segments relative to them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.intrinsics import Intrinsics, undistort_pixels
from trinoc.geometry.projection import project_by_matrix
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches


class LineImages(NamedTuple):
    """Images of the lines that one view shows, in undistorted pixels.

    Fields
    ------
    track : (s,) track of each line.
    segment : (s,) its segment in this view.
    ends_px : (s, 2, 2) image of the line's ends.
    direction, normal : (s, 2) unit vectors along and across the image.
    length_px : (s,) distance between the ends.
    extent_px : (s, 2) interval of the segment along the image.
    offset_px : (s, 2) offset of the segment's line across the image, at the line's ends.
    covariance_px2 : (s, 2, 2) covariance of these offsets.
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
    """Images of all lines that a view shows. Errors of the segments include the noise scale."""
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
    """Offsets at positions along the line; 0 and 1 are its ends."""
    return (1 - share) * offset_px[:, :1] + share * offset_px[:, 1:]
