"""How far a line is shown by at least two of its views: further than by all of them."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry import project_by_matrix
from trinoc.match.observations import MatchInput


def two_view_interval(
    seen: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Float[np.ndarray, "t v 2"]:
    """Where the ends of what two views show lie along every segment, 0 at its first end.

    On the segments that end before, this is outside [0, 1]: their lines run on.
    """
    tracks, views = index.shape
    reach = np.full((tracks, views, 2), np.nan)
    for view in range(views):
        on = np.flatnonzero(index[:, view] >= 0)
        segment = seen.ends_px[view][index[on, view]]
        reach[on, view] = np.sort(
            positions_abreast(np.asarray(seen.lines.matrix_px)[view], segment, ends_mm[on]), axis=1
        )
    # NaN, where a view does not see the line, sorts last.
    begin = np.sort(reach[..., 0], axis=1)[:, 1]
    end = -np.sort(-reach[..., 1], axis=1)[:, 1]
    step = ends_mm[:, 1] - ends_mm[:, 0]
    shown = ends_mm[:, :1] + np.stack([begin, end], axis=1)[..., None] * step[:, None]
    interval = np.zeros((tracks, views, 2))
    for view in range(views):
        on = np.flatnonzero(index[:, view] >= 0)
        matrix = np.asarray(seen.lines.matrix_px)[view]
        segment = seen.ends_px[view][index[on, view]]
        along = segment[:, 1] - segment[:, 0]
        offset = project_by_matrix(matrix, shown[on]) - segment[:, :1]
        interval[on, view] = (offset @ along[:, :, None])[..., 0] / (along**2).sum(axis=1)[:, None]
    return interval


def positions_abreast(
    matrix_px: Float[np.ndarray, "3 4"],
    segment_px: Float[np.ndarray, "t 2 2"],
    ends_mm: Float[np.ndarray, "t 2 3"],
) -> Float[np.ndarray, "t 2"]:
    """Positions on each line, 0 and 1 at its ends, whose images lie abreast of a segment's ends."""
    first = ends_mm[:, 0] @ matrix_px[:, :3].T + matrix_px[:, 3]
    step = (ends_mm[:, 1] - ends_mm[:, 0]) @ matrix_px[:, :3].T
    along = segment_px[:, 1] - segment_px[:, 0]
    place = (segment_px @ along[:, :, None])[..., 0]
    # The image at position s is (first + s step) / its depth: linear over linear.
    at_first, at_step = (first[:, :2] * along).sum(axis=1), (step[:, :2] * along).sum(axis=1)
    return (place * first[:, 2:] - at_first[:, None]) / (at_step[:, None] - place * step[:, 2:])
