"""Line in space of each track: maximum-likelihood fit to all of its segments, with a test of the
whole.

1. Extent. The line reaches as far as two of its views show it, which is further than all views do.
   At the end of one view's segment, the epipolar plane cuts the segments of the others.
2. Weight of ends. A cut is not an observation of its own. It moves along its segment by (error
   across) / sin(angle to the epipolar line), and the errors across already include this. So only
   the view whose segment ends there constrains the position along the line. In the other views this
   position is free. With these blocks, independent views give the line's true covariance.
3. Fit. An error that is common to all views is not averaged. It stays as large as one view states
   it.
4. Test. Triples that share segments pairwise may chain to tracks whose ends disagree. So the
   whole track is tested, and the worst members are split off first.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.projection import homogeneous_pixel, project_by_matrix
from trinoc.geometry.triangulation import Segment3D, triangulate_segment
from trinoc.match.observations.match_input import MatchInput, common_error_variance
from trinoc.match.observations.table import SegmentTable, look_up_frames, take_matrices
from trinoc.match.tracks.unequal_errors import misfit_limit
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.tracks import TrackTuning
from trinoc.numerics.buckets import in_blocks
from trinoc.numerics.joins import take_groups
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.tables import take_rows
from trinoc.numerics.tails import chi_square_tail


def two_view_span(extents: Float[np.ndarray, "t v 2"]) -> Float[np.ndarray, "t 2"]:
    """Return the interval of each line that at least two views show, (t, 2).

    `extents` are the intervals of the segments along the line, NaN for views without a segment.
    """
    # NaN (no segment in a view) sorts last.
    begin = np.sort(extents[..., 0], axis=1)[:, 1]
    return np.stack([begin, -np.sort(-extents[..., 1], axis=1)[:, 1]], axis=1)


def points_on_lines(
    ends_mm: Float[np.ndarray, "t 2 3"], span: Float[np.ndarray, "t 2"]
) -> Float[np.ndarray, "t 2 3"]:
    """Return the points at two positions on each line, (t, 2, 3) mm.

    0 is the first end of the line, 1 its second end.
    """
    return ends_mm[:, :1] + span[..., None] * (ends_mm[:, 1] - ends_mm[:, 0])[:, None]


def line_end_positions(
    inputs: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Float[np.ndarray, "t v 2"]:
    """Return the positions of each line's ends along every segment of its track, (t, v, 2).

    0 is the first end of the segment, 1 its second end. Values outside [0, 1] mean that the line
    extends beyond the segment.
    """
    interval = np.zeros((*index.shape, 2))
    for view, rows, segment, matrix in _iterate_views(inputs, index):
        step = segment[:, 1] - segment[:, 0]
        offset = project_by_matrix(matrix, ends_mm[rows]) - segment[:, :1]
        square = (step**2).sum(axis=1)[:, None]
        interval[rows, view] = np.einsum("tei,ti->te", offset, step) / square
    return interval


def segment_extents(
    inputs: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Float[np.ndarray, "t v 2"]:
    """Return the interval of every segment along the line of its track, (t, v, 2).

    0 is the first end of the line, 1 its second end. Views without a segment have NaN.
    """
    extents = np.full((*index.shape, 2), np.nan)
    for view, rows, segment, matrix in _iterate_views(inputs, index):
        extents[rows, view] = np.sort(positions_abreast(matrix, segment, ends_mm[rows]), axis=1)
    return extents


def _iterate_views(
    inputs: MatchInput, index: Int[np.ndarray, "t v"]
) -> Iterator[tuple[int, Int[np.ndarray, "_n"], np.ndarray, np.ndarray]]:
    """Yield, for each view: its index, the tracks with a segment in it, segment ends, matrices.

    The ends are (n, 2, 2), undistorted pixels. The projection matrices are (n, 3, 4), or one for
    all tracks of a single frame.
    """
    frame = look_up_frames(inputs.lines, index)
    for view, ends in enumerate(inputs.ends_px):
        rows = np.flatnonzero(index[:, view] >= 0)
        matrix = take_matrices(inputs.lines, take_groups(frame, rows))[:, view]
        yield view, rows, ends[index[rows, view]], matrix


def positions_abreast(
    matrix_px: Float[np.ndarray, "*t 3 4"],
    segment_px: Float[np.ndarray, "t 2 2"],
    ends_mm: Float[np.ndarray, "t 2 3"],
) -> Float[np.ndarray, "t 2"]:
    """Return the positions on each line whose images are nearest to the ends of a segment, (t, 2).

    0 is the first end of the line, 1 its second end.
    """
    first, last = np.moveaxis(homogeneous_pixel(matrix_px, ends_mm), 1, 0)
    image_step = last - first
    step = segment_px[:, 1] - segment_px[:, 0]
    position = np.einsum("tei,ti->te", segment_px, step)
    # The image at position s is (first + s step) / its depth: linear over linear.
    at_first, at_step = (first[:, :2] * step).sum(axis=1), (image_step[:, :2] * step).sum(axis=1)
    return (position * first[:, 2:] - at_first[:, None]) / (
        at_step[:, None] - position * image_step[:, 2:]
    )


def common_part(
    inputs: MatchInput, index: Int[np.ndarray, "v"], line_mm: Float[np.ndarray, "2 3"]
) -> Float[np.ndarray, "2 3"] | None:
    """Return the ends of the part of a line that all segments of a track show, (2, 3) mm.

    The result is None if there is no common part.
    """
    views = np.flatnonzero(index >= 0)
    segments = np.stack([inputs.ends_px[view][index[view]] for view in views])
    matrix = np.asarray(inputs.lines.matrix_px)[views]
    line = np.broadcast_to(line_mm, (len(views), 2, 3))
    extents = np.sort(positions_abreast(matrix, segments, line), axis=1)
    begin, end = extents[:, 0].max(), extents[:, 1].min()
    if not begin < end:
        return None
    return line_mm[0] + np.array([[begin], [end]]) * (line_mm[1] - line_mm[0])


def segment_position(
    segment_px: Float[np.ndarray, "2 2"],
    matrix_px: Float[np.ndarray, "3 4"],
    ends_mm: Float[np.ndarray, "2 3"],
) -> Float[np.ndarray, "2"]:
    """Return the positions of two points in space along a segment, (2,).

    0 is the first end of the segment, 1 its second end.
    """
    step = segment_px[1] - segment_px[0]
    return (project_by_matrix(matrix_px, ends_mm) - segment_px[0]) @ step / (step @ step)


def overlap_share(first: Float[np.ndarray, "2"], second: Float[np.ndarray, "2"]) -> float:
    """Return the common length of two intervals over the length of the shorter interval."""
    low, high = max(first.min(), second.min()), min(first.max(), second.max())
    return float((high - low) / min(np.ptp(first), np.ptp(second)))


# numerical: standard deviation of a cut along its segment, px: so large that it has no weight.
FREE_PX = 1e4


def view_ends_line(
    inputs: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Bool[np.ndarray, "t v 2"]:
    """Mark, for each of a line's two ends, the view whose segment ends there, (t, v, 2)."""
    return view_bounds_span(segment_extents(inputs, index, ends_mm), np.array([0.0, 1.0]))


def view_bounds_span(
    extents: Float[np.ndarray, "t v 2"], span: Float[np.ndarray, "*t 2"]
) -> Bool[np.ndarray, "t v 2"]:
    """Mark, for each end of an interval, the view whose segment ends nearest to it, (t, v, 2).

    `span` is the interval on each line. `extents` are the intervals of the segments on each line.
    """
    distance = np.abs(extents - np.expand_dims(span, -2))
    nearest = np.nanargmin(distance, axis=1) if len(extents) else np.zeros((0, 2), dtype=np.int64)
    return np.arange(extents.shape[1])[None, :, None] == nearest[:, None, :]


def cut_fragments(
    inputs: MatchInput,
    index: Int[np.ndarray, "t v"],
    interval: Float[np.ndarray, "t v 2"],
    ends_here: Bool[np.ndarray, "t v 2"],
) -> tuple[Float[np.ndarray, "t v 2 2"], Float[np.ndarray, "t v 4 4"]]:
    """Cut the segments of tracks to the given intervals.

    Returns the fragments (t, v, 2, 2), undistorted pixels, and their covariances (t, v, 4, 4). Both
    are NaN for views without a segment. `ends_here` marks fragment ends that are ends of their
    segment. Other fragment ends get a large variance along the segment.
    """
    tracks, views = index.shape
    fragments = np.full((tracks, views, 2, 2), np.nan)
    covariance = np.full((tracks, views, 4, 4), np.nan)
    for view in range(views):
        rows = np.flatnonzero(index[:, view] >= 0)
        segment = index[rows, view]
        ends, share = inputs.ends_px[view][segment], interval[rows, view][:, :, None]
        fragments[rows, view] = (1 - share) * ends[:, :1] + share * ends[:, 1:]
        cut_covariance = _part_covariance(
            inputs.covariance_px2[view][segment], interval[rows, view]
        )
        covariance[rows, view] = _release_cut_ends(cut_covariance, ends, ends_here[rows, view])
    return fragments, covariance


def _part_covariance(
    covariance_px2: Float[np.ndarray, "n 4 4"], interval: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "e i f j n"]:
    """Return the covariance of the ends of a part of each segment.

    Both ends of the part are weighted means of the segment's ends. The segments are the last axis
    of the result.
    """
    # Rows are the last axis: sums of long columns are faster than many small matrix products.
    weight = np.stack([1 - interval.T, interval.T])
    by_end = np.ascontiguousarray(covariance_px2.reshape(-1, 16).T).reshape(2, 2, 2, 2, -1)
    first_end_weighted = _weigh_observations(by_end, weight)
    return _weigh_observations(first_end_weighted.transpose(2, 3, 0, 1, 4), weight).transpose(
        2, 3, 0, 1, 4
    )


def _weigh_observations(
    values: Float[np.ndarray, "a i b j n"], weight: Float[np.ndarray, "a e n"]
) -> Float[np.ndarray, "e i b j n"]:
    first, second = weight[:, :, None, None, None]
    return first * values[0] + second * values[1]


def _release_cut_ends(
    covariance_px2: Float[np.ndarray, "e i f j n"],
    segment_px: Float[np.ndarray, "n 2 2"],
    ends_here: Bool[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n 4 4"]:
    """Add a large variance along the segment to the ends that are cuts.

    `ends_here` (n, 2) is True for ends of the segment itself.
    """
    along = (segment_px[:, 1] - segment_px[:, 0]).T
    along = along / np.sqrt((along**2).sum(axis=0))
    push = FREE_PX**2 * along[:, None] * along
    for e in range(2):
        covariance_px2[e, :, e] += np.where(ends_here[:, e], 0.0, push)
    return covariance_px2.reshape(4, 4, -1).transpose(2, 0, 1)


def lie_before_cameras(
    lines: SegmentTable, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Bool[np.ndarray, "t"]:
    """Return the mask of the tracks whose line is in front of every camera that shows it, (t,)."""
    matrix = take_matrices(lines, look_up_frames(lines, index))
    depth = matrix[..., 2, :3] @ ends_mm.mT + matrix[..., 2, 3:]
    return np.asarray(((depth > 0).all(axis=2) | (index < 0)).all(axis=1))


# numerical: rows of one block, which must fit into a processor's cache.
ROWS_AT_A_TIME = 1 << 10


@kept_jit
def _triangulate_tracks(
    matrix_px: Float[ArrayLike, "*f v 3 4"],
    frame: Int[ArrayLike, "t"] | None,
    fragments_px: Float[ArrayLike, "t v 2 2"],
    covariance_px2: Float[ArrayLike, "t v 4 4"],
    shown: Bool[ArrayLike, "t v"],
) -> Segment3D:
    matrix = matrix_px if frame is None else matrix_px[frame]
    triangulate = jax.vmap(triangulate_segment, in_axes=(None if frame is None else 0, 0, 0, 0))
    return triangulate(matrix, fragments_px, covariance_px2, shown)


def fit_lines(
    inputs: MatchInput,
    index: Int[np.ndarray, "t v"],
    common_mm: Float[np.ndarray, "t 2 3"],
    extents: Float[np.ndarray, "t v 2"] | None = None,
) -> tuple[Float[np.ndarray, "t 2 3"], Float[np.ndarray, "t 6 6"], Float[np.ndarray, "t"]]:
    """Fit the line in space of each track, for the part that at least two views show.

    Parameters
    ----------
    inputs : MatchInput
        Input of the matcher.
    index : (t, v)
        Segments of the tracks.
    common_mm : (t, 2, 3)
        Ends of the part that all views of a track show.
    extents : (t, v, 2), optional
        Result of `segment_extents` for these ends.

    Returns
    -------
    tuple
        Ends of the lines (t, 2, 3), their covariance (t, 6, 6), and the chi-square of each fit
        (t,).
    """
    extents = segment_extents(inputs, index, common_mm) if extents is None else extents
    span = two_view_span(extents)
    # Outside the common part, a line may pass behind a camera that sees it.
    is_before_cameras = lie_before_cameras(inputs.lines, index, points_on_lines(common_mm, span))
    span = np.where(is_before_cameras[:, None], span, np.array([0.0, 1.0]))
    part_mm, ends_here = points_on_lines(common_mm, span), view_bounds_span(extents, span)
    observed = cut_fragments(inputs, index, line_end_positions(inputs, index, part_mm), ends_here)
    # Rows of padding have no view. Their lines are undetermined, which does no harm.
    block = min(inputs.lines.ends_px.shape[1], ROWS_AT_A_TIME)
    frame = look_up_frames(inputs.lines, index)

    def triangulate(
        fragments: np.ndarray, covariance: np.ndarray, members: np.ndarray, *frames: np.ndarray
    ) -> Segment3D:
        frame_of_row = frames[0] if frames else None
        return _triangulate_tracks(
            inputs.lines.matrix_px, frame_of_row, fragments, covariance, members
        )

    frames = () if frame is None else (frame,)
    fitted = in_blocks(triangulate, block, *observed, index >= 0, *frames)
    misfit = np.where((index >= 0).sum(axis=1) > 2, fitted.chi_square, 0.0)
    ends_mm, covariance_mm2 = (np.array(field) for field in (fitted.ends_mm, fitted.covariance_mm2))
    common_error = common_error_covariance(inputs, index)
    affected = np.flatnonzero((common_error != 0).any(axis=(1, 2, 3)))
    if len(affected):
        columns = (observed[0], observed[1] + common_error, index >= 0, *frames)
        refitted = in_blocks(triangulate, block, *(column[affected] for column in columns))
        ends_mm[affected], covariance_mm2[affected] = refitted.ends_mm, refitted.covariance_mm2
    return ends_mm, covariance_mm2, misfit


def common_error_covariance(
    inputs: MatchInput, index: Int[np.ndarray, "t v"]
) -> Float[np.ndarray, "t v 4 4"]:
    """Return the covariance to add to each fragment for errors common to all views, (t, v, 4, 4).

    A fit to n independent views divides the variance by n. A common error is not reduced by more
    views. Its variance is therefore multiplied by n in each view.
    """
    common_error = np.zeros((*index.shape, 4, 4))
    views = (index >= 0).sum(axis=1)
    for view in range(index.shape[1]):
        rows = np.flatnonzero(index[:, view] >= 0)
        segment = index[rows, view]
        normal = np.asarray(inputs.lines.line)[view, segment, :2]
        common = common_error_variance(np.asarray(inputs.lines.across_px2)[view, segment])
        added = ((views[rows] - 1) * common)[:, None, None] * normal[:, :, None] * normal[:, None]
        common_error[rows, view] = np.tile(added, (1, 2, 2))
    return common_error


class FittedTracks(NamedTuple):
    """Tracks with their fitted lines.

    Attributes
    ----------
    index : (t, v)
        Segment of each view, -1 if it has none.
    common_mm : (t, 2, 3)
        Ends of the part of the line that all views show.
    ends_mm, covariance_mm2 : (t, 2, 3) and (t, 6, 6)
        Ends of the line, world frame, and their covariance.
    misfit : (t,)
        Chi-square of the fit; 0 for two views.
    """

    index: Int[np.ndarray, "t v"]
    common_mm: Float[np.ndarray, "t 2 3"]
    ends_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    misfit: Float[np.ndarray, "t"]


def fit_tracks(
    inputs: MatchInput, index: Int[np.ndarray, "t v"], common_mm: Float[np.ndarray, "t 2 3"]
) -> FittedTracks:
    """Fit the lines of tracks to their segments. `common_mm` are the ends of the common parts."""
    return FittedTracks(index, common_mm, *fit_lines(inputs, index, common_mm))


def are_consistent(
    inputs: MatchInput,
    tracks: FittedTracks,
    tuning: MatchTuning = DEFAULT,
    noise_tail: float = 0.0,
) -> Bool[np.ndarray, "t"]:
    """Return the mask of the tracks whose segments can be images of one line, (t,).

    The misfit must be probable for Student-distributed errors, where `noise_tail` is 1 / degrees of
    freedom. Every segment must also be close to the line, see `are_near`.
    """
    degrees = 2 * ((tracks.index >= 0).sum(axis=1) - 2)
    significance = chi_square_tail(tuning.candidates.gate, 2)
    limit = misfit_limit(significance, np.maximum(degrees, 1), noise_tail)
    is_consistent = (tracks.misfit <= np.where(degrees > 0, limit, np.inf)) & np.isfinite(
        tracks.misfit
    )
    rows = np.flatnonzero(is_consistent & (degrees > 0))
    is_consistent[rows] = are_near(inputs, take_rows(tracks, rows), tuning.tracks)
    return is_consistent


def are_near(
    inputs: MatchInput, tracks: FittedTracks, tuning: TrackTuning = DEFAULT.tracks
) -> Bool[np.ndarray, "t"]:
    """Return the mask of the tracks with all segments near the line, (t,).

    The limit is a number of pixels or of standard deviations, whichever is larger. The limit is
    needed because a heavy-tailed error distribution alone would accept any segment.
    """
    is_near = np.ones(len(tracks.index), dtype=bool)
    for view, rows, segment, matrix in _iterate_views(inputs, tracks.index):
        first, last = np.moveaxis(homogeneous_pixel(matrix, tracks.ends_mm[rows]), 1, 0)
        line = np.cross(first, last)
        line = line / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
        distance_px = np.abs(np.einsum("tei,ti->te", segment, line[:, :2]) + line[:, 2:])
        across = np.asarray(inputs.lines.across_px2)[view, tracks.index[rows, view]]
        sigma_px = np.sqrt(np.einsum("tee->te", across))
        limit_px = np.maximum(tuning.max_distance_px, tuning.max_distance_sigmas * sigma_px)
        is_near[rows] &= (distance_px <= limit_px).all(axis=1)
    return is_near


def split_off_misfits(
    inputs: MatchInput, tracks: FittedTracks, tuning: MatchTuning = DEFAULT
) -> FittedTracks:
    """Remove the worst views of inconsistent tracks until the tracks are consistent.

    Tracks that are inconsistent in only three views lose all segments.
    """
    index = tracks.index.copy()
    fitted = tracks
    while True:
        misfit_rows = np.flatnonzero(~are_consistent(inputs, fitted, tuning))
        views = (index[misfit_rows] >= 0).sum(axis=1)
        index[misfit_rows[views <= 3]] = -1
        misfit_rows = misfit_rows[views > 3]
        if len(misfit_rows) == 0:
            return fitted._replace(index=index)
        owner, view = np.nonzero(index[misfit_rows] >= 0)
        trial = index[misfit_rows][owner]
        trial[np.arange(len(owner)), view] = -1
        misfit = np.nan_to_num(
            fit_tracks(inputs, trial, fitted.common_mm[misfit_rows][owner]).misfit, nan=np.inf
        )
        best = np.lexsort((misfit, owner))
        best = best[np.unique(owner[best], return_index=True)[1]]
        index[misfit_rows] = trial[best]
        refitted = fit_tracks(inputs, index[misfit_rows], fitted.common_mm[misfit_rows])
        columns = [column.copy() for column in fitted]
        for column, new in zip(columns, refitted, strict=True):
            column[misfit_rows] = new
        fitted = FittedTracks(*columns)
