"""The tracks of matches as pieces of lines: what they show, and which segments show them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry import Rig
from trinoc.match.line_map.line_fit import LineFragments
from trinoc.match.observations import undistorted
from trinoc.match.tracks import Matches, positions_abreast, typical_misfit
from trinoc.match.tuning import DEFAULT, TrackTuning


class TrackTable(NamedTuple):
    """The tracks, with undistorted fragments."""

    index: Int[np.ndarray, "t v"]
    common_mm: Float[np.ndarray, "t 2 3"]
    ends_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    fragments_px: Float[np.ndarray, "t v 2 2"]
    fragments_covariance_px2: Float[np.ndarray, "t v 4 4"]
    matrix_px: Float[np.ndarray, "v 3 4"]
    px_per_mm: Float[np.ndarray, "t"]
    posterior: Float[np.ndarray, "t"]


def track_table(
    matches: Matches,
    rig: Rig,
    order: Int[np.ndarray, "t"],
    tuning: TrackTuning = DEFAULT.tracks,
) -> TrackTable:
    """The tracks in a given order.

    Where segments err by more than they state for most tracks, their covariances are as much
    larger here.
    """
    noise = 1.0
    if matches.misfit is not None:
        noise = typical_misfit(matches.index, matches.misfit, tuning)
    fragments = np.stack(
        [
            undistorted(rig[name].intrinsics, np.nan_to_num(matches.fragments_px[:, view]))
            for view, name in enumerate(matches.views)
        ],
        axis=1,
    )
    matrix = np.stack([rig[name].matrix_px for name in matches.views])
    seen = np.asarray(matches.index) >= 0
    middle = np.asarray(matches.lines_mm).mean(axis=1)
    return TrackTable(
        np.asarray(matches.index)[order],
        _common_parts(matrix, fragments, seen, np.asarray(matches.lines_mm))[order],
        np.asarray(matches.lines_mm)[order],
        noise * np.asarray(matches.covariance_mm2)[order],
        fragments[order],
        noise * np.asarray(matches.fragments_covariance_px2)[order],
        matrix,
        px_per_mm(matrix, middle, seen)[order],
        np.asarray(matches.posterior)[order],
    )


def _common_parts(
    matrix_px: Float[np.ndarray, "v 3 4"],
    fragments_px: Float[np.ndarray, "t v 2 2"],
    seen: Bool[np.ndarray, "t v"],
    ends_mm: Float[np.ndarray, "t 2 3"],
) -> Float[np.ndarray, "t 2 3"]:
    """Places on each line whose images lie abreast of the fragments' ends, the mean of views."""
    share = np.zeros((len(ends_mm), 2))
    for view, matrix in enumerate(matrix_px):
        on = np.flatnonzero(seen[:, view])
        share[on] += positions_abreast(matrix, fragments_px[on, view], ends_mm[on])
    share /= seen.sum(axis=1)[:, None]
    return ends_mm[:, :1] + share[..., None] * (ends_mm[:, 1] - ends_mm[:, 0])[:, None]


def px_per_mm(
    matrix_px: Float[np.ndarray, "v 3 4"],
    points_mm: Float[np.ndarray, "n 3"],
    seen: Bool[np.ndarray, "n v"],
) -> Float[np.ndarray, "n"]:
    """Image displacement per mm across the viewing direction, the mean of the views that see."""
    image = np.einsum("vij,nj->nvi", matrix_px[:, :, :3], points_mm) + matrix_px[:, :, 3]
    uv = image[..., :2] / image[..., 2:]
    by_point = matrix_px[:, :2, :3] - uv[..., None] * matrix_px[:, 2:, :3]
    scale = np.sqrt((by_point**2).sum(axis=(2, 3)) / 2) / np.abs(image[..., 2])
    return (scale * seen).sum(axis=1) / seen.sum(axis=1)


def fragments_of(pieces: TrackTable, tracks: tuple[int, ...]) -> LineFragments:
    """The segments of all tracks, each once: what it says of the line, any part of it says."""
    longest: dict[tuple[int, int], tuple[float, int]] = {}
    for track in tracks:
        for view in np.flatnonzero(pieces.index[track] >= 0).tolist():
            segment = int(pieces.index[track, view])
            length = float(np.linalg.norm(np.diff(pieces.fragments_px[track, view], axis=0)))
            # Of parts of one length, the first track's.
            key = (view, segment)
            longest[key] = max(longest.get(key, (-1.0, 0)), (length, -track))
    rows = np.array([(-track, view) for (view, _), (_, track) in longest.items()])
    return LineFragments(
        pieces.matrix_px[rows[:, 1]],
        pieces.fragments_px[rows[:, 0], rows[:, 1]],
        pieces.fragments_covariance_px2[rows[:, 0], rows[:, 1]],
    )
