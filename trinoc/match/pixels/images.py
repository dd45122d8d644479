"""Where matched lines lie in a picture, and what their segments say of it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.intrinsics import Intrinsics, undistort_pixels
from trinoc.geometry.projection import project_by_matrix
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches


class LineImages(NamedTuple):
    """Images of the lines that one view sees, in undistorted pixels.

    Fields
    ------
    track : (s,) of each line. segment : (s,) that shows it here.
    ends_px : (s, 2, 2) image of the line's ends. way, right : (s, 2) unit vectors along and across.
    length_px : (s,) between the ends. extent_px : (s, 2) where the segment begins and ends along.
    offset_px : (s, 2) of the segment's line across the image of the line, at the line's ends.
    covariance_px2 : (s, 2, 2) of these.
    """

    track: Int[np.ndarray, "s"]
    segment: Int[np.ndarray, "s"]
    ends_px: Float[np.ndarray, "s 2 2"]
    way: Float[np.ndarray, "s 2"]
    right: Float[np.ndarray, "s 2"]
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
    """The images of all lines that a view sees, whose segments have the errors found."""
    track = np.flatnonzero(matches.index[:, view] >= 0)
    segment = matches.index[track, view]
    ends = project_by_matrix(matrix_px, matches.lines_mm[track])
    way = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    way = way / length[:, None]
    right = np.stack([-way[:, 1], way[:, 0]], axis=1)
    shown = undistort_pixels(lens, np.asarray(segments.endpoints_px, dtype=np.float64)[segment])
    off = shown - ends[:, :1]
    along, across = (np.einsum("sei,si->se", off, axis) for axis in (way, right))
    # At the line's ends the segment's line runs on.
    apart = along[:, 1] - along[:, 0]
    apart = np.where(np.abs(apart) > 1e-6, apart, 1e-6)
    share = (np.stack([np.zeros(len(length)), length], axis=1) - along[:, :1]) / apart[:, None]
    weight = np.stack([1 - share, share], axis=2)
    own = shown[:, 1] - shown[:, 0]
    normal = np.stack([-own[:, 1], own[:, 0]], axis=1) / np.linalg.norm(own, axis=1)[:, None]
    # Against the image's own normal where the ends come in the other order.
    normal *= np.sign((normal * right).sum(axis=1))[:, None]
    blocks = np.asarray(segments.covariance_px2)[segment].reshape(-1, 2, 2, 2, 2)
    spread = np.einsum("seifj,si,sj->sef", blocks, normal, normal) * matches.noise_scale**2
    return LineImages(
        track,
        segment,
        ends,
        way,
        right,
        length,
        np.sort(along, axis=1),
        (weight @ across[..., None])[..., 0],
        weight @ spread @ weight.mT,
    )


def interpolate_offset(
    offset_px: Float[np.ndarray, "s 2"], share: Float[np.ndarray, "s k"]
) -> Float[np.ndarray, "s k"]:
    """Offsets at positions along the line, 0 and 1 at its ends."""
    return (1 - share) * offset_px[:, :1] + share * offset_px[:, 1:]
