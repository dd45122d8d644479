"""The straight line in space that any number of segments show: maximum likelihood.

Each segment says where the line's image is at its two ends, across the segment, under its own
covariance; where it begins and ends says nothing about the line. What is unknown are the
distances of the line from a first estimate, at two places along it, in two directions: four.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.intrinsics import undistort_pixels
from trinoc.geometry.projection import distances_from_line, project_with_jacobian
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.assembly import typical_misfit
from trinoc.match.tracks.line_fit import positions_abreast
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.line_map import CollinearTuning
from trinoc.match.tuning.tracks import TrackTuning
from trinoc.numerics.robust_loss import ScaleMixture
from trinoc.numerics.small_least_squares import Residuals, gauss_newton, whitening
from trinoc.numerics.vectors import complete_axes

# numerical: Gauss-Newton steps.
STEPS = 4


class LineFragments(NamedTuple):
    """Segments, or parts of them, that show one line, in undistorted pixels.

    matrix_px : projection matrix of the view of each. ends_px : its ends, of any order.
    covariance_px2 : of the ends.
    """

    matrix_px: Float[np.ndarray, "n 3 4"]
    ends_px: Float[np.ndarray, "n 2 2"]
    covariance_px2: Float[np.ndarray, "n 4 4"]


class LineFit(NamedTuple):
    """A line through two points abreast of those it was asked for.

    ends_mm : the points. covariance_mm2 : of the points across the line; along it they are
        as they were given. chi_square : of the segments, `degrees` its degrees of freedom;
        errors that the heavy tail explains count for less than their square.
    """

    ends_mm: Float[np.ndarray, "2 3"]
    covariance_mm2: Float[np.ndarray, "6 6"]
    chi_square: float
    degrees: int


def fit_line(
    shown: LineFragments,
    near_mm: Float[np.ndarray, "2 3"],
    tuning: CollinearTuning = DEFAULT.collinear,
) -> LineFit:
    """The likeliest line near two points, of which it moves only across.

    The covariance is not a number where the segments do not determine a line.
    """
    way = near_mm[1] - near_mm[0]
    axes = complete_axes(way / np.linalg.norm(way))
    loss = ScaleMixture(tuning.error_shares, tuning.error_scales, 2)
    ends, equations = gauss_newton(
        lambda ends: line_residuals(shown, ends, axes),
        lambda ends, offsets: ends + offsets.reshape(2, 2) @ axes,
        near_mm,
        steps=STEPS,
        loss=loss,
    )
    blocks = equations.covariance().reshape(2, 2, 2, 2)
    covariance = np.einsum("eafb,ai,bj->eifj", blocks, axes, axes).reshape(6, 6)
    chi_square = float(np.sum(loss.rho(equations.squared)))
    return LineFit(ends, covariance, chi_square, 2 * len(shown.ends_px) - 4)


def line_residuals(
    shown: LineFragments, ends_mm: Float[np.ndarray, "2 3"], axes: Float[np.ndarray, "2 3"]
) -> Residuals:
    """Distances of each segment's ends from the line's image, two numbers of one observation, by
    the offsets of the line's two points along the two axes."""
    blocks = shown.covariance_px2.reshape(-1, 2, 2, 2, 2)
    # Across the segment itself: along it an end that a plane cuts is not known at all, and of
    # that the line's own normal, a fraction of a degree away, would take in pixels.
    along = shown.ends_px[:, 1] - shown.ends_px[:, 0]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    by = whitening(np.einsum("ni,neifj,nj->nef", normal, blocks, normal))
    beside = distances_from_line(shown.matrix_px, ends_mm, shown.ends_px)
    by_offsets = (beside.by_ends @ axes.T).reshape(-1, 2, 4)
    return Residuals((by @ beside.distance_px[..., None])[None, ..., 0], (by @ by_offsets)[None])


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
            np.nan_to_num(undistort_pixels(rig[name].intrinsics, matches.fragments_px[:, view]))
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
    by_point = project_with_jacobian(matrix_px, points_mm[None]).by_point
    scale = np.sqrt((by_point**2).sum(axis=(2, 3)) / 2).T
    return (scale * seen).sum(axis=1) / seen.sum(axis=1)


def collect_fragments(pieces: TrackTable, tracks: tuple[int, ...]) -> LineFragments:
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
