"""The line in space of each track: maximum likelihood of all of its segments, tested as a whole.

1. Reach. A line is put out as far as two of its views show it, which is further than all of them
   do. Where one view's segment ends, the epipolar plane of that end cuts the others'.
2. What ends are worth. A cut is no observation of its own: it moves along its segment by (error
   across) / sin(angle to the epipolar line), all of which the errors across say already. So only
   the view whose segment ends there knows the place along the line, and in the others it is free:
   views whose blocks are then taken for independent give the line's true covariance.
3. The fit. What moves an edge alike in all views is no independent error: it stays as large as one
   view states it.
4. The test. Triples that share segments two by two chain to tracks whose ends no longer agree. So
   the whole track is tested, and what does not fit is split off, the worst first.
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


def two_view_span(reach: Float[np.ndarray, "t v 2"]) -> Float[np.ndarray, "t 2"]:
    """Where what at least two views show of each line begins and ends, given what each does."""
    # NaN, where a view does not see the line, sorts last.
    begin = np.sort(reach[..., 0], axis=1)[:, 1]
    return np.stack([begin, -np.sort(-reach[..., 1], axis=1)[:, 1]], axis=1)


def points_on_lines(
    ends_mm: Float[np.ndarray, "t 2 3"], span: Float[np.ndarray, "t 2"]
) -> Float[np.ndarray, "t 2 3"]:
    """Points at two positions on each line, 0 and 1 at its ends."""
    return ends_mm[:, :1] + span[..., None] * (ends_mm[:, 1] - ends_mm[:, 0])[:, None]


def track_intervals(
    seen: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Float[np.ndarray, "t v 2"]:
    """Where the ends of each line lie along every segment, 0 at its first end.

    On segments that end before, this is outside [0, 1]: their lines run on.
    """
    interval = np.zeros((*index.shape, 2))
    for view, on, segment, matrix in _each_view(seen, index):
        along = segment[:, 1] - segment[:, 0]
        offset = project_by_matrix(matrix, ends_mm[on]) - segment[:, :1]
        square = (along**2).sum(axis=1)[:, None]
        interval[on, view] = np.einsum("tei,ti->te", offset, along) / square
    return interval


def segment_reaches(
    seen: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Float[np.ndarray, "t v 2"]:
    """Where every segment begins and ends along its track's line, 0 and 1 at the line's ends."""
    reach = np.full((*index.shape, 2), np.nan)
    for view, on, segment, matrix in _each_view(seen, index):
        reach[on, view] = np.sort(positions_abreast(matrix, segment, ends_mm[on]), axis=1)
    return reach


def _each_view(
    seen: MatchInput, index: Int[np.ndarray, "t v"]
) -> Iterator[tuple[int, Int[np.ndarray, "_n"], np.ndarray, np.ndarray]]:
    """(view, tracks that it sees, their segments there, the matrices of these)."""
    frame = look_up_frames(seen.lines, index)
    for view, ends in enumerate(seen.ends_px):
        on = np.flatnonzero(index[:, view] >= 0)
        matrix = take_matrices(seen.lines, take_groups(frame, on))[:, view]
        yield view, on, ends[index[on, view]], matrix


def positions_abreast(
    matrix_px: Float[np.ndarray, "*t 3 4"],
    segment_px: Float[np.ndarray, "t 2 2"],
    ends_mm: Float[np.ndarray, "t 2 3"],
) -> Float[np.ndarray, "t 2"]:
    """Positions on each line, 0 and 1 at its ends, whose images lie abreast of a segment's ends."""
    first, last = np.moveaxis(homogeneous_pixel(matrix_px, ends_mm), 1, 0)
    step = last - first
    along = segment_px[:, 1] - segment_px[:, 0]
    place = np.einsum("tei,ti->te", segment_px, along)
    # The image at position s is (first + s step) / its depth: linear over linear.
    at_first, at_step = (first[:, :2] * along).sum(axis=1), (step[:, :2] * along).sum(axis=1)
    return (place * first[:, 2:] - at_first[:, None]) / (at_step[:, None] - place * step[:, 2:])


def common_part(
    seen: MatchInput, index: Int[np.ndarray, "v"], near_mm: Float[np.ndarray, "2 3"]
) -> Float[np.ndarray, "2 3"] | None:
    """Ends, on a line through two points, of what all of its segments show; None where nothing."""
    views = np.flatnonzero(index >= 0)
    segments = np.stack([seen.ends_px[view][index[view]] for view in views])
    matrix = np.asarray(seen.lines.matrix_px)[views]
    near = np.broadcast_to(near_mm, (len(views), 2, 3))
    reach = np.sort(positions_abreast(matrix, segments, near), axis=1)
    begin, end = reach[:, 0].max(), reach[:, 1].min()
    if not begin < end:
        return None
    return near_mm[0] + np.array([[begin], [end]]) * (near_mm[1] - near_mm[0])


def segment_position(
    segment_px: Float[np.ndarray, "2 2"],
    matrix_px: Float[np.ndarray, "3 4"],
    ends_mm: Float[np.ndarray, "2 3"],
) -> Float[np.ndarray, "2"]:
    """Where two points in space lie along a segment, from 0 at its first end to 1."""
    step = segment_px[1] - segment_px[0]
    return (project_by_matrix(matrix_px, ends_mm) - segment_px[0]) @ step / (step @ step)


def overlap_share(first: Float[np.ndarray, "2"], second: Float[np.ndarray, "2"]) -> float:
    """Common length of two parts as a share of the shorter."""
    low, high = max(first.min(), second.min()), min(first.max(), second.max())
    return float((high - low) / min(np.ptp(first), np.ptp(second)))


# numerical: standard deviation along its segment of an end that a plane cuts, px: nothing is
# known of it.
FREE_PX = 1e4


def ending_view(
    seen: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Bool[np.ndarray, "t v 2"]:
    """Whether it is this view's segment that ends at each of the ends of a track's line."""
    return ends_in_span(segment_reaches(seen, index, ends_mm), np.array([0.0, 1.0]))


def ends_in_span(
    reach: Float[np.ndarray, "t v 2"], span: Float[np.ndarray, "*t 2"]
) -> Bool[np.ndarray, "t v 2"]:
    """The same of lines of which the part `span` is meant, where segments `reach` along them."""
    off = np.abs(reach - np.expand_dims(span, -2))
    nearest = np.nanargmin(off, axis=1) if len(reach) else np.zeros((0, 2), dtype=np.int64)
    return np.arange(reach.shape[1])[None, :, None] == nearest[:, None, :]


def cut_fragments(
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
    half = _weigh_observations(given, weight)
    return _weigh_observations(half.transpose(2, 3, 0, 1, 4), weight).transpose(2, 3, 0, 1, 4)


def _weigh_observations(
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


def before_cameras(
    lines: SegmentTable, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Bool[np.ndarray, "t"]:
    """Whether both ends, and so all between them, lie before every camera that sees the track."""
    matrix = take_matrices(lines, look_up_frames(lines, index))
    depth = matrix[..., 2, :3] @ ends_mm.mT + matrix[..., 2, 3:]
    return np.asarray(((depth > 0).all(axis=2) | (index < 0)).all(axis=1))


# numerical: few enough for a processor's cache.
MOST_AT_ONCE = 1 << 10


@kept_jit
def _triangulate_tracks(
    matrix_px: Float[ArrayLike, "*f v 3 4"],
    frame: Int[ArrayLike, "t"] | None,
    fragments_px: Float[ArrayLike, "t v 2 2"],
    covariance_px2: Float[ArrayLike, "t v 4 4"],
    shown: Bool[ArrayLike, "t v"],
) -> Segment3D:
    matrix = matrix_px if frame is None else matrix_px[frame]
    each = jax.vmap(triangulate_segment, in_axes=(None if frame is None else 0, 0, 0, 0))
    return each(matrix, fragments_px, covariance_px2, shown)


def lines_in_space(
    seen: MatchInput,
    index: Int[np.ndarray, "t v"],
    common_mm: Float[np.ndarray, "t 2 3"],
    reach: Float[np.ndarray, "t v 2"] | None = None,
) -> tuple[Float[np.ndarray, "t 2 3"], Float[np.ndarray, "t 6 6"], Float[np.ndarray, "t"]]:
    """Maximum-likelihood ends of what two views show, with covariance, and the chi-square by which
    the views disagree.

    `common_mm` are the ends of the part that all views of a track show, `reach` what
    `segment_reaches` says of them, if at hand.
    """
    reach = segment_reaches(seen, index, common_mm) if reach is None else reach
    span = two_view_span(reach)
    # Beyond the common part a line may pass behind a camera that sees it.
    before = before_cameras(seen.lines, index, points_on_lines(common_mm, span))
    span = np.where(before[:, None], span, np.array([0.0, 1.0]))
    part_mm, ends_here = points_on_lines(common_mm, span), ends_in_span(reach, span)
    shown = cut_fragments(seen, index, track_intervals(seen, index, part_mm), ends_here)
    # Rows of padding hold no view, which leaves their lines undetermined, and harmless.
    block, frame = min(seen.lines.ends_px.shape[1], MOST_AT_ONCE), look_up_frames(seen.lines, index)

    def triangulate(
        fragments: np.ndarray, covariance: np.ndarray, members: np.ndarray, *frames: np.ndarray
    ) -> Segment3D:
        own = frames[0] if frames else None
        return _triangulate_tracks(seen.lines.matrix_px, own, fragments, covariance, members)

    frames = () if frame is None else (frame,)
    found = in_blocks(triangulate, block, *shown, index >= 0, *frames)
    misfit = np.where((index >= 0).sum(axis=1) > 2, found.chi_square, 0.0)
    ends_mm, covariance_mm2 = (np.array(each) for each in (found.ends_mm, found.covariance_mm2))
    more = common_error_covariance(seen, index)
    some = np.flatnonzero((more != 0).any(axis=(1, 2, 3)))
    if len(some):
        columns = (shown[0], shown[1] + more, index >= 0, *frames)
        again = in_blocks(triangulate, block, *(column[some] for column in columns))
        ends_mm[some], covariance_mm2[some] = again.ends_mm, again.covariance_mm2
    return ends_mm, covariance_mm2, misfit


def common_error_covariance(
    seen: MatchInput, index: Int[np.ndarray, "t v"]
) -> Float[np.ndarray, "t v 4 4"]:
    """What is added to the covariances of a track's fragments for errors common to its n views.

    Views that are taken for independent average an error away: one that is common to them stays
    as large as it is where each has n times its variance. Misfits do not hold it.
    """
    more = np.zeros((*index.shape, 4, 4))
    views = (index >= 0).sum(axis=1)
    for view in range(index.shape[1]):
        on = np.flatnonzero(index[:, view] >= 0)
        segment = index[on, view]
        normal = np.asarray(seen.lines.line)[view, segment, :2]
        common = common_error_variance(np.asarray(seen.lines.across_px2)[view, segment])
        added = ((views[on] - 1) * common)[:, None, None] * normal[:, :, None] * normal[:, None]
        more[on, view] = np.tile(added, (1, 2, 2))
    return more


class FittedTracks(NamedTuple):
    """Tracks with their lines: segments of each view, common part, ends, covariance, misfit."""

    index: Int[np.ndarray, "t v"]
    common_mm: Float[np.ndarray, "t 2 3"]
    ends_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    misfit: Float[np.ndarray, "t"]


def fit_tracks(
    seen: MatchInput, index: Int[np.ndarray, "t v"], common_mm: Float[np.ndarray, "t 2 3"]
) -> FittedTracks:
    """The lines of these tracks."""
    return FittedTracks(index, common_mm, *lines_in_space(seen, index, common_mm))


def consistent(
    inputs: MatchInput,
    tracks: FittedTracks,
    tuning: MatchTuning = DEFAULT,
    noise_tail: float = 0.0,
) -> Bool[np.ndarray, "t"]:
    """Whether the segments of tracks may be of one line: the misfit of all is likely enough under
    errors as unequal as `noise_tail` says, and no segment is far from the line in pixels."""
    degrees = 2 * ((tracks.index >= 0).sum(axis=1) - 2)
    significance = chi_square_tail(tuning.candidates.gate, 2)
    limit = misfit_limit(significance, np.maximum(degrees, 1), noise_tail)
    fits = (tracks.misfit <= np.where(degrees > 0, limit, np.inf)) & np.isfinite(tracks.misfit)
    rows = np.flatnonzero(fits & (degrees > 0))
    fits[rows] = are_near(inputs, take_rows(tracks, rows), tuning.tracks)
    return fits


def are_near(
    inputs: MatchInput, tracks: FittedTracks, tuning: TrackTuning = DEFAULT.tracks
) -> Bool[np.ndarray, "t"]:
    """Whether every segment of a track lies within so many pixels of its line, or so many standard
    deviations where these are more. Unequal errors alone would let in anything."""
    near = np.ones(len(tracks.index), dtype=bool)
    for view, on, segment, matrix in _each_view(inputs, tracks.index):
        first, last = np.moveaxis(homogeneous_pixel(matrix, tracks.ends_mm[on]), 1, 0)
        line = np.cross(first, last)
        line = line / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
        off_px = np.abs(np.einsum("tei,ti->te", segment, line[:, :2]) + line[:, 2:])
        across = np.asarray(inputs.lines.across_px2)[view, tracks.index[on, view]]
        sigma_px = np.sqrt(np.einsum("tee->te", across))
        limit_px = np.maximum(tuning.farthest_px, tuning.farthest_sigmas * sigma_px)
        near[on] &= (off_px <= limit_px).all(axis=1)
    return near


def split_off_misfits(
    seen: MatchInput, tracks: FittedTracks, tuning: MatchTuning = DEFAULT
) -> FittedTracks:
    """Tracks that are consistent, or made so by leaving out the views that fit worst; rows of
    those that even three views do not agree on hold no view."""
    index = tracks.index.copy()
    now = tracks
    while True:
        bad = np.flatnonzero(~consistent(seen, now, tuning))
        views = (index[bad] >= 0).sum(axis=1)
        index[bad[views <= 3]] = -1
        bad = bad[views > 3]
        if len(bad) == 0:
            return now._replace(index=index)
        owner, view = np.nonzero(index[bad] >= 0)
        trial = index[bad][owner]
        trial[np.arange(len(owner)), view] = -1
        misfit = np.nan_to_num(
            fit_tracks(seen, trial, now.common_mm[bad][owner]).misfit, nan=np.inf
        )
        best = np.lexsort((misfit, owner))
        best = best[np.unique(owner[best], return_index=True)[1]]
        index[bad] = trial[best]
        again = fit_tracks(seen, index[bad], now.common_mm[bad])
        columns = [column.copy() for column in now]
        for column, new in zip(columns, again, strict=True):
            column[bad] = new
        now = FittedTracks(*columns)
