"""Maximum-likelihood fit of one straight line in space to any number of segments.

Each segment observes the line's image across itself, at its two ends, with its covariance. The
positions of its ends along the line are no information. The four unknowns are the offsets of the
line from a first estimate, at two positions along it, in two directions.
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
    """Segments, or parts of segments, that show one line in space, in undistorted pixels.

    Attributes
    ----------
    matrix_px : (n, 3, 4)
        Projection matrix of the view of each segment.
    ends_px : (n, 2, 2)
        Ends of each segment, in any sequence.
    covariance_px2 : (n, 4, 4)
        Covariance of the ends.
    """

    matrix_px: Float[np.ndarray, "n 3 4"]
    ends_px: Float[np.ndarray, "n 2 2"]
    covariance_px2: Float[np.ndarray, "n 4 4"]


class LineFit(NamedTuple):
    """Line in space fitted to segments, represented by two points.

    Attributes
    ----------
    ends_mm : (2, 3)
        The two points. The fit moves the points only perpendicular to the initial line.
    covariance_mm2 : (6, 6)
        Covariance of both points across the line; the part along the line is 0.
    chi_square, degrees : float and int
        Misfit of the segments under the heavy-tailed loss, and its degrees of freedom.
    """

    ends_mm: Float[np.ndarray, "2 3"]
    covariance_mm2: Float[np.ndarray, "6 6"]
    chi_square: float
    degrees: int


def fit_line(
    fragments: LineFragments,
    start_mm: Float[np.ndarray, "2 3"],
    tuning: CollinearTuning = DEFAULT.collinear,
) -> LineFit:
    """Fit a line in space to segments, from an initial line through the two points `start_mm`.

    The points move only perpendicular to the initial line. The covariance is NaN if the segments do
    not determine a line.
    """
    step = start_mm[1] - start_mm[0]
    axes = complete_axes(step / np.linalg.norm(step))
    loss = ScaleMixture(tuning.error_shares, tuning.error_scales, 2)
    ends, equations = gauss_newton(
        lambda ends: line_residuals(fragments, ends, axes),
        lambda ends, offsets: ends + offsets.reshape(2, 2) @ axes,
        start_mm,
        steps=STEPS,
        loss=loss,
    )
    blocks = equations.covariance().reshape(2, 2, 2, 2)
    covariance = np.einsum("eafb,ai,bj->eifj", blocks, axes, axes).reshape(6, 6)
    chi_square = float(np.sum(loss.rho(equations.squared)))
    return LineFit(ends, covariance, chi_square, 2 * len(fragments.ends_px) - 4)


def line_residuals(
    fragments: LineFragments, ends_mm: Float[np.ndarray, "2 3"], axes: Float[np.ndarray, "2 3"]
) -> Residuals:
    """Return the whitened distances of the segments' ends from the image of a line, with
    derivatives.

    The line passes through the two points `ends_mm`. The derivatives are by the offsets of both
    points along the two `axes`.
    """
    blocks = fragments.covariance_px2.reshape(-1, 2, 2, 2, 2)
    # The covariance is projected on the segment's normal. A cut end has a very large variance along
    # the segment, which the line's normal, a fraction of a degree away, would include.
    direction = fragments.ends_px[:, 1] - fragments.ends_px[:, 0]
    direction = direction / np.linalg.norm(direction, axis=1)[:, None]
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    whitener = whitening(np.einsum("ni,neifj,nj->nef", normal, blocks, normal))
    distances = distances_from_line(fragments.matrix_px, ends_mm, fragments.ends_px)
    by_offsets = (distances.by_ends @ axes.T).reshape(-1, 2, 4)
    return Residuals(
        (whitener @ distances.distance_px[..., None])[None, ..., 0], (whitener @ by_offsets)[None]
    )


class TrackTable(NamedTuple):
    """Tracks with undistorted fragments.

    Attributes
    ----------
    index : (t, v)
        Segment of each view; -1 where the view does not show the track.
    common_mm : (t, 2, 3)
        Ends of the common part of the segments, on the line in space.
    ends_mm, covariance_mm2 : (t, 2, 3) and (t, 6, 6)
        Ends of the line, and their covariance.
    fragments_px, fragments_covariance_px2 : (t, v, 2, 2) and (t, v, 4, 4)
        Ends of the fragments in undistorted pixels, and their covariance.
    matrix_px : (v, 3, 4)
        Projection matrices.
    px_per_mm : (t,)
        Image displacement per mm in space at the line's midpoint.
    posterior : (t,)
        Posterior of each track.
    """

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
    """Build the table of the tracks with the indices `order`.

    If most residuals are larger than the stated errors, all covariances are multiplied by one
    factor.
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
    is_observed = np.asarray(matches.index) >= 0
    middle = np.asarray(matches.lines_mm).mean(axis=1)
    return TrackTable(
        np.asarray(matches.index)[order],
        _common_parts(matrix, fragments, is_observed, np.asarray(matches.lines_mm))[order],
        np.asarray(matches.lines_mm)[order],
        noise * np.asarray(matches.covariance_mm2)[order],
        fragments[order],
        noise * np.asarray(matches.fragments_covariance_px2)[order],
        matrix,
        px_per_mm(matrix, middle, is_observed)[order],
        np.asarray(matches.posterior)[order],
    )


def _common_parts(
    matrix_px: Float[np.ndarray, "v 3 4"],
    fragments_px: Float[np.ndarray, "t v 2 2"],
    is_observed: Bool[np.ndarray, "t v"],
    ends_mm: Float[np.ndarray, "t 2 3"],
) -> Float[np.ndarray, "t 2 3"]:
    """Return the points on each line whose images are nearest to the fragments' ends, (t, 2, 3) mm.

    Each point is the mean over the views that show the line.
    """
    share = np.zeros((len(ends_mm), 2))
    for view, matrix in enumerate(matrix_px):
        rows = np.flatnonzero(is_observed[:, view])
        share[rows] += positions_abreast(matrix, fragments_px[rows, view], ends_mm[rows])
    share /= is_observed.sum(axis=1)[:, None]
    return ends_mm[:, :1] + share[..., None] * (ends_mm[:, 1] - ends_mm[:, 0])[:, None]


def px_per_mm(
    matrix_px: Float[np.ndarray, "v 3 4"],
    points_mm: Float[np.ndarray, "n 3"],
    is_observed: Bool[np.ndarray, "n v"],
) -> Float[np.ndarray, "n"]:
    """Return the image displacement per mm in space at each point, (n,).

    The displacement is perpendicular to the viewing ray. The result is the mean over the views that
    show the point.
    """
    by_point = project_with_jacobian(matrix_px, points_mm[None]).by_point
    scale = np.sqrt((by_point**2).sum(axis=(2, 3)) / 2).T
    return (scale * is_observed).sum(axis=1) / is_observed.sum(axis=1)


def collect_fragments(pieces: TrackTable, tracks: tuple[int, ...]) -> LineFragments:
    """Collect the segments of the given tracks, each segment once.

    If several tracks use a segment, its longest fragment is taken.
    """
    longest: dict[tuple[int, int], tuple[float, int]] = {}
    for track in tracks:
        for view in np.flatnonzero(pieces.index[track] >= 0).tolist():
            segment = int(pieces.index[track, view])
            length = float(np.linalg.norm(np.diff(pieces.fragments_px[track, view], axis=0)))
            # Of parts with equal lengths, that of the first track is used.
            key = (view, segment)
            longest[key] = max(longest.get(key, (-1.0, 0)), (length, -track))
    rows = np.array([(-track, view) for (view, _), (_, track) in longest.items()])
    return LineFragments(
        pieces.matrix_px[rows[:, 1]],
        pieces.fragments_px[rows[:, 0], rows[:, 1]],
        pieces.fragments_covariance_px2[rows[:, 0], rows[:, 1]],
    )
