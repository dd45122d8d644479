"""Tracks that are no line in space: what they show depends on the viewpoint.

Each camera sees another outline of a round body, and another line of light on a shiny one. Where
three views are joined to a track all the same, they disagree about its place. Where the third
view was rejected, its own outline is left over beside the place where the track would be.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry import project_by_matrix
from trinoc.match.observations import MatchInput, frames_of, matrices_of
from trinoc.match.tuning import DEFAULT, TrackTuning
from trinoc.numerics import (
    blocks,
    broadcast_groups,
    chi_square_limit,
    chi_square_quantile,
    expand_ranges,
    group_medians,
    group_sums,
    take_groups,
)

# Lines of two views compared at once with all segments of a view.
ROWS = 256


def flag_viewpoint_dependent(
    seen: MatchInput,
    index: Int[np.ndarray, "t v"],
    ends_mm: Float[np.ndarray, "t 2 3"],
    misfit: Float[np.ndarray, "t"],
    tuning: TrackTuning = DEFAULT.tracks,
) -> Bool[np.ndarray, "t"]:
    """Tracks about whose place the views disagree by more than noise allows.

    `misfit` is the chi-square of each track's views, 2 (n - 2) degrees of freedom for n views.
    Where the segments' covariances are too small for most tracks, they are scaled first.
    """
    views = (index >= 0).sum(axis=1)
    in_three, frame = views > 2, frames_of(seen.lines, index)
    marked = np.zeros(len(index), dtype=bool)
    if in_three.any():
        limit = chi_square_limit(tuning.significance, 2 * (views[in_three] - 2))
        usual = broadcast_groups(
            typical_misfit(index, misfit, tuning, frame), take_groups(frame, in_three)
        )
        marked[in_three] = misfit[in_three] > usual * limit
    for view in range(index.shape[1]):
        free = np.ones(seen.counts[view], dtype=bool)
        matched = index[in_three, view]
        free[matched[matched >= 0]] = False
        free = np.flatnonzero(free)
        rows = np.flatnonzero(~in_three & (index[:, view] < 0))
        matrix = matrices_of(seen.lines, take_groups(frame, rows))[:, view]
        expected = project_by_matrix(matrix, ends_mm[rows])
        # The free segments of a row's own frame follow one another.
        first, last = np.zeros(len(rows), np.int64), np.full(len(rows), len(free))
        if frame is not None:
            bounds = np.searchsorted(free, seen.starts[:, view])
            first, last = bounds[frame[rows]], bounds[frame[rows] + 1]
        size = ROWS if frame is None else max(len(rows), 1)
        for part in blocks(len(rows), size):
            i, j = expand_ranges(first[part], last[part])
            segments = seen.ends_px[view][free[j]]
            beside = _is_beside(expected[part][i], segments, tuning)
            marked[rows[part][i[beside]]] = True
    return marked


def typical_misfit(
    index: Int[np.ndarray, "t v"],
    misfit: Float[np.ndarray, "t"],
    tuning: TrackTuning = DEFAULT.tracks,
    frame: Int[np.ndarray, "t"] | None = None,
) -> Float[np.ndarray, "*f"] | float:
    """How much larger than stated the variance of segments is for most tracks; at least 1.

    With the `frame` of each track, for each frame.
    """
    views = (index >= 0).sum(axis=1)
    in_three = views > 2
    frames = 1 if frame is None or len(frame) == 0 else int(frame.max()) + 1
    own = take_groups(frame, in_three)
    enough = group_sums(np.ones(in_three.sum()), own, frames) >= tuning.min_tracks_to_learn
    share = misfit[in_three] / chi_square_quantile(0.5, 2 * (views[in_three] - 2))
    typical = np.where(enough, group_medians(share, own, frames), 1.0)
    return np.maximum(typical, 1.0)


def _is_beside(
    expected_px: Float[np.ndarray, "p 2 2"],
    segments_px: Float[np.ndarray, "p 2 2"],
    tuning: TrackTuning,
) -> Bool[np.ndarray, "p"]:
    """Whether each segment lies beside the place at which one was expected."""
    beside = np.zeros(len(expected_px), dtype=bool)
    way, turn = expected_px[:, 1] - expected_px[:, 0], segments_px[:, 1] - segments_px[:, 0]
    area = way[:, 0] * turn[:, 1] - way[:, 1] * turn[:, 0]
    squares = (way**2).sum(axis=1), (turn**2).sum(axis=1)
    sine = np.sin(np.radians(tuning.beside_deg))
    rows = np.flatnonzero(area**2 < sine**2 * squares[0] * squares[1])
    length, size = (np.sqrt(square[rows]) for square in squares)
    u, v = (way[rows] / length[:, None]).T[:, :, None]
    offset = segments_px[rows] - expected_px[rows, :1]
    along = np.sort(offset[..., 0] * u + offset[..., 1] * v, axis=1)
    across = np.abs(offset[..., 1] * u - offset[..., 0] * v).max(axis=1)
    common = np.minimum(along[:, 1], length) - np.maximum(along[:, 0], 0.0)
    enough = tuning.abreast_share * np.minimum(length, size)
    beside[rows] = (across < tuning.beside_px) & (common > enough)
    return beside
