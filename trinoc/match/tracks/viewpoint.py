"""Tracks that are no line in space: what they show depends on the viewpoint.

Each camera sees another outline of a round body, and another line of light on a shiny one. Where
three views are joined to a track all the same, they disagree about its place. Where the third
view was rejected, its own outline is left over beside the place where the track would be.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from trinoc.geometry import project_by_matrix
from trinoc.match.observations import MatchInput
from trinoc.match.tuning import DEFAULT, TrackTuning

# Lines of two views, and segments, compared at once.
ROWS = 1024


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
    in_three = views > 2
    marked = np.zeros(len(index), dtype=bool)
    if in_three.any():
        limit = chi2.isf(tuning.significance, 2 * (views[in_three] - 2))
        marked[in_three] = misfit[in_three] > typical_misfit(index, misfit, tuning) * limit
    for view in range(index.shape[1]):
        free = np.ones(seen.counts[view], dtype=bool)
        matched = index[in_three, view]
        free[matched[matched >= 0]] = False
        rows = np.flatnonzero(~in_three & (index[:, view] < 0))
        matrix = np.asarray(seen.lines.matrix_px)[view]
        expected = project_by_matrix(matrix, ends_mm[rows])
        for start in range(0, len(rows), ROWS):
            part = slice(start, start + ROWS)
            marked[rows[part]] |= _one_beside(expected[part], seen.ends_px[view][free], tuning)
    return marked


def typical_misfit(
    index: Int[np.ndarray, "t v"],
    misfit: Float[np.ndarray, "t"],
    tuning: TrackTuning = DEFAULT.tracks,
) -> float:
    """How much larger than stated the variance of segments is for most tracks; at least 1."""
    views = (index >= 0).sum(axis=1)
    in_three = views > 2
    if in_three.sum() < tuning.min_tracks_to_learn:
        return 1.0
    share = misfit[in_three] / chi2.median(2 * (views[in_three] - 2))
    return max(float(np.median(share)), 1.0)


def _one_beside(
    expected_px: Float[np.ndarray, "m 2 2"],
    segments_px: Float[np.ndarray, "n 2 2"],
    tuning: TrackTuning,
) -> Bool[np.ndarray, "m"]:
    """Whether a segment lies beside each place at which one was expected."""
    way = expected_px[:, 1] - expected_px[:, 0]
    length = np.linalg.norm(way, axis=1)[:, None]
    u, v = (way / length).T[:, :, None]
    turn = segments_px[:, 1] - segments_px[:, 0]
    size = np.linalg.norm(turn, axis=1)
    sine = np.abs(u * turn[:, 1] - v * turn[:, 0]) / size
    i, j = np.nonzero(sine < np.sin(np.radians(tuning.beside_deg)))
    offset = segments_px[j] - expected_px[i, 0, None]
    u, v, length, size = u[i], v[i], length[i, 0], size[j]
    along = np.sort(offset[..., 0] * u + offset[..., 1] * v, axis=1)
    across = np.abs(offset[..., 1] * u - offset[..., 0] * v).max(axis=1)
    common = np.minimum(along[:, 1], length) - np.maximum(along[:, 0], 0.0)
    enough = tuning.abreast_share * np.minimum(length, size)
    beside = (across < tuning.beside_px) & (common > enough)
    found = np.zeros(len(expected_px), dtype=bool)
    found[i[beside]] = True
    return found
