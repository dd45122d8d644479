"""The parts of segments that a track shows, and what their ends are worth.

A part ends where one view's segment ends, and there the other views' segments are cut by the
epipolar plane of that end. A cut is no observation of its own: it moves along its segment by
(error across) / sin(angle to the epipolar line), all of which the errors across say already. So
only the view whose segment ends there knows the place along the line, and in the others it is
free: views whose blocks are then taken for independent give the line's true covariance.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.observations import MatchInput
from trinoc.match.tracks.extent import reach_of

# Standard deviation along its segment of an end that a plane cuts, px: nothing is known of it.
FREE_PX = 1e4


def ending_view(
    seen: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Bool[np.ndarray, "t v 2"]:
    """Whether it is this view's segment that ends at each of the ends of a track's line."""
    return ending_at(reach_of(seen, index, ends_mm), np.array([0.0, 1.0]))


def ending_at(
    reach: Float[np.ndarray, "t v 2"], span: Float[np.ndarray, "*t 2"]
) -> Bool[np.ndarray, "t v 2"]:
    """The same of lines of which the part `span` is meant, where segments `reach` along them."""
    off = np.abs(reach - np.expand_dims(span, -2))
    nearest = np.nanargmin(off, axis=1) if len(reach) else np.zeros((0, 2), dtype=np.int64)
    return np.arange(reach.shape[1])[None, :, None] == nearest[:, None, :]


def fragments_of(
    seen: MatchInput,
    index: Int[np.ndarray, "t v"],
    interval: Float[np.ndarray, "t v 2"],
    ends_here: Bool[np.ndarray, "t v 2"],
) -> tuple[Float[np.ndarray, "t v 2 2"], Float[np.ndarray, "t v 4 4"]]:
    """(parts of the segments, undistorted; their covariances), NaN where not seen."""
    tracks, views = index.shape
    fragments = np.full((tracks, views, 2, 2), np.nan)
    covariance = np.full((tracks, views, 4, 4), np.nan)
    for view in range(views):
        on = np.flatnonzero(index[:, view] >= 0)
        segment = index[on, view]
        ends, share = seen.ends_px[view][segment], interval[on, view][:, :, None]
        fragments[on, view] = (1 - share) * ends[:, :1] + share * ends[:, 1:]
        own = _of_parts(seen.covariance_px2[view][segment], interval[on, view])
        covariance[on, view] = _free_where_cut(own, ends, ends_here[on, view])
    return fragments, covariance


def _of_parts(
    covariance_px2: Float[np.ndarray, "n 4 4"], interval: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "e i f j n"]:
    """Each end of a fragment is a mean of its segment's ends; so is its error."""
    # Rows last: many sums of long columns, and not as many small products of matrices.
    weight = np.stack([1 - interval.T, interval.T])
    given = np.ascontiguousarray(covariance_px2.reshape(-1, 16).T).reshape(2, 2, 2, 2, -1)
    half = _weighted(given, weight)
    return _weighted(half.transpose(2, 3, 0, 1, 4), weight).transpose(2, 3, 0, 1, 4)


def _weighted(
    values: Float[np.ndarray, "a i b j n"], weight: Float[np.ndarray, "a e n"]
) -> Float[np.ndarray, "e i b j n"]:
    first, second = weight[:, :, None, None, None]
    return first * values[0] + second * values[1]


def _free_where_cut(
    covariance_px2: Float[np.ndarray, "e i f j n"],
    segment_px: Float[np.ndarray, "n 2 2"],
    ends_here: Bool[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n 4 4"]:
    """Covariance of ends of which those that are cut may lie anywhere along the segment."""
    along = (segment_px[:, 1] - segment_px[:, 0]).T
    along = along / np.sqrt((along**2).sum(axis=0))
    push = FREE_PX**2 * along[:, None] * along
    for e in range(2):
        covariance_px2[e, :, e] += np.where(ends_here[:, e], 0.0, push)
    return covariance_px2.reshape(4, 4, -1).transpose(2, 0, 1)
