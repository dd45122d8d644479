"""Build tracks from the selected candidates: fragments, lines in space with covariance, and
reasons.

Two views locate a line at the intersection of their interpretation planes. A segment nearly along
its epipolar line makes this intersection uncertain. The measure is the standard deviation of its
direction over its angle to the epipolar line. Errors in space are inversely proportional to that
angle. Their second order matters if the ratio is large. No covariance exists if the angle may be
zero.

Some tracks are no line in space, because what they show depends on the viewpoint. Each camera
sees a different outline of a round body, and a different highlight on a shiny one. If three
views are joined nevertheless, their misfit is large. If the third view was rejected, its own
segment lies beside the predicted position.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.geometry.projection import project_by_matrix
from trinoc.match.observations.match_input import MatchInput
from trinoc.match.observations.table import SegmentTable, look_up_frames, take_matrices
from trinoc.match.occlusion.possible_pairs import Pairs
from trinoc.match.selection.marginals import Selection, Tracks
from trinoc.match.selection.repetition import (
    NO_REPETITION,
    Repetition,
    find_repetition,
    greatest_log_odds,
    limit_log_odds,
)
from trinoc.match.tracks.answers import (
    CERTAIN,
    DISCARDED_TRIPLES,
    SURE,
    UNLOCATED_TRACKS,
    TrackLines,
    build_matches,
    unmatched_reasons,
)
from trinoc.match.tracks.line_fit import (
    cut_fragments,
    fit_lines,
    lie_before_cameras,
    segment_extents,
    view_bounds_span,
)
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.tracks import TrackTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.joins import (
    broadcast_groups,
    expand_ranges,
    group_medians,
    group_sums,
    take_groups,
)
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.tails import chi_square_limit, chi_square_quantile


def assemble(
    inputs: MatchInput,
    tracks: Tracks,
    selections: list[Selection],
    pairs: Pairs,
    out_of_range: Sequence[Int[np.ndarray, "_ _v"]],
    names: Sequence[tuple[str, ...]],
    noise_scale: Float[np.ndarray, "f"],
    tuning: MatchTuning = DEFAULT,
) -> list[Matches]:
    """Build the matches of each frame, with views and segments numbered as in the caller's input.

    Tracks along the epipolar lines of all their pairs of views have no depth. These tracks are
    excluded, and the reason of their segments is "along the epipolar lines".

    Parameters
    ----------
    inputs : MatchInput
        Input of the matcher, with covariances that include `noise_scale`.
    tracks : Tracks
        Tracks in three or more views.
    selections : list of Selection
        Selection of each triplet of views.
    pairs : Pairs
        Pairs of segments that only two views show.
    out_of_range : sequence of arrays
        For each triplet, segments of its triples outside the depth range or behind a camera.
    names : sequence of tuple of str
        View names of each frame, in the caller's sequence.
    noise_scale : (f,)
        Noise scale of each frame.
    tuning : MatchTuning
        Tuned constants.
    """
    repeating = [
        find_repetition(
            selection.candidates, selection.log_odds, selection.graph, tuning.repetition
        )
        for selection in selections
    ]
    repetition = concatenate_rows([NO_REPETITION, *repeating])
    lines, unlocated = _build_lines(
        inputs, tracks, pairs.take(pairs.is_accepted), repetition, tuning
    )
    reasons = _reasons(inputs, selections, pairs, out_of_range, unlocated, lines, tuning.tracks)
    counted_groups = {
        "triples considered": [selection.candidates.index for selection in selections],
        "triples outside depth": out_of_range,
        DISCARDED_TRIPLES: [selection.discarded_index for selection in selections],
        "tracks in three views or more": [tracks.candidates.index],
        "pairs considered": [pairs.candidates.index],
        "tracks in two views": [pairs.candidates.index[pairs.is_accepted]],
        UNLOCATED_TRACKS: [unlocated],
        "tracks that seem to move with the viewpoint": [lines.index[lines.viewpoint_dependent]],
        SURE: [lines.index_likelier_than(tuning.decoys.sure_posterior)],
        CERTAIN: [lines.index_likelier_than(tuning.decoys.certain_posterior)],
    }
    counts = {name: _count_per_frame(inputs, groups) for name, groups in counted_groups.items()}
    frame = look_up_frames(inputs.lines, lines.index)
    frame_of_line = np.zeros(len(lines.index), np.int64) if frame is None else frame
    return build_matches(
        inputs, lines, frame_of_line, reasons, counts, names, noise_scale, tuning.noise
    )


def _count_per_frame(inputs: MatchInput, groups: list[np.ndarray]) -> Int[np.ndarray, "f"]:
    """Return the number of candidates in each frame, (f,): rows of segments in `groups`."""
    frames = [look_up_frames(inputs.lines, index) for index in groups]
    labels = [
        np.zeros(len(index), np.int64) if frame is None else frame
        for frame, index in zip(frames, groups, strict=True)
    ]
    all_labels = np.concatenate([np.zeros(0, np.int64), *labels])
    return np.bincount(all_labels, minlength=len(inputs.frames))


def _build_lines(
    inputs: MatchInput, tracks: Tracks, accepted: Pairs, repetition: Repetition, tuning: MatchTuning
) -> tuple[TrackLines, Int[np.ndarray, "u v"]]:
    """Fit the lines in space of all tracks and accepted pairs.

    Returns (lines, segments (u, v) of the tracks whose depth no pair of views determines).
    """
    index = np.concatenate([tracks.candidates.index, accepted.candidates.index])
    interval = np.concatenate([tracks.candidates.interval, accepted.candidates.interval])
    sources = (tracks, accepted)
    log_odds = np.concatenate([source.posterior_log_odds for source in sources])
    pattern_limit = np.concatenate(
        [greatest_log_odds(source.candidates, repetition) for source in sources]
    )
    is_in_pattern = pattern_limit < np.minimum(log_odds, tuning.repetition.likely_log_odds)
    track_tuning = tuning.tracks
    rival_posterior = np.concatenate(
        [tracks.rival_posterior, np.full(len(accepted.is_accepted), -np.inf)]
    )
    track_members = tracks.member_posterior
    members = np.full((len(index), index.shape[1]), np.nan)
    if track_members is not None:
        members[: len(track_members)] = track_members
    common_mm = np.concatenate([tracks.candidates.ends_mm, accepted.candidates.ends_mm])
    doubt = direction_doubt(inputs.lines, index)
    is_located = doubt < track_tuning.max_direction_doubt
    extents = segment_extents(inputs, index, common_mm)
    ends_here = view_bounds_span(extents, np.array([0.0, 1.0]))
    fragments, covariance = cut_fragments(inputs, index, interval, ends_here)
    ends_mm, covariance_mm2, misfit = fit_lines(inputs, index, common_mm, extents)
    covariance_mm2 = covariance_mm2 * (1 + track_tuning.second_order * doubt**2)[:, None, None]
    is_sound = np.isfinite(ends_mm).all(axis=(1, 2)) & np.isfinite(covariance_mm2).all(axis=(1, 2))
    is_sound &= is_located & lie_before_cameras(inputs.lines, index, ends_mm)
    all_lines = TrackLines(
        index,
        fragments,
        ends_mm,
        covariance_mm2,
        limit_log_odds(log_odds, pattern_limit),
        rival_posterior,
        covariance,
        misfit,
        np.zeros(len(index), dtype=bool),
        is_in_pattern,
        log_odds,
        members,
    )
    lines = take_rows(all_lines, is_sound)
    is_viewpoint_dependent = flag_viewpoint_dependent(
        inputs, lines.index, lines.ends_mm, lines.misfit, track_tuning
    )
    return lines._replace(viewpoint_dependent=is_viewpoint_dependent), index[~is_located]


def direction_doubt(lines: SegmentTable, index: Int[np.ndarray, "t v"]) -> Float[np.ndarray, "t"]:
    """Return the ratio of direction error to epipolar angle for each track, (t,).

    A large ratio means that the depth of the track is not determined. For a segment, the ratio is
    the standard deviation of its direction over its angle to the epipolar line. For a pair of
    views, it is the larger ratio of the two segments. For a track, it is the smallest ratio of all
    pairs of views.
    """
    smallest, frame = np.full(len(index), np.inf), look_up_frames(lines, index)
    for a, b in combinations(range(index.shape[1]), 2):
        rows = np.flatnonzero((index[:, a] >= 0) & (index[:, b] >= 0))
        frame_of_row = take_groups(frame, rows)
        pair = np.maximum(
            _direction_doubt_in_view(lines, a, b, index[rows, a], frame_of_row),
            _direction_doubt_in_view(lines, b, a, index[rows, b], frame_of_row),
        )
        smallest[rows] = np.minimum(smallest[rows], pair)
    return smallest


def _direction_doubt_in_view(
    lines: SegmentTable,
    view: int,
    other: int,
    segment: Int[np.ndarray, "n"],
    frame: Int[np.ndarray, "n"] | None,
) -> Float[np.ndarray, "n"]:
    """Return the ratio of direction error to epipolar angle for segments of one view, (n,).

    The epipolar angle is that between the segment and the epipolar line of camera `other`.
    """
    ends = np.asarray(lines.ends_px)[view, segment]
    across = np.asarray(lines.across_px2)[view, segment]
    centre = np.asarray(lines.centre_mm)
    centre = centre[None, other] if frame is None else centre[frame, other]
    matrix = take_matrices(lines, frame)[:, view]
    epipole = (matrix[..., :3] @ centre[..., None])[..., 0] + matrix[..., 3]
    step, middle = ends[:, 1] - ends[:, 0], ends.mean(axis=1)
    # Homogeneous form, because the epipole may lie at infinity.
    toward = epipole[:, :2] - epipole[:, 2:] * middle
    area = step[:, 0] * toward[:, 1] - step[:, 1] * toward[:, 0]
    spread = np.sqrt(across[:, 0, 0] + across[:, 1, 1] - 2 * across[:, 0, 1])
    offset = np.abs(area) / np.linalg.norm(toward, axis=1)
    return spread / np.maximum(offset, 1e-12)


def _reasons(
    inputs: MatchInput,
    selections: list[Selection],
    pairs: Pairs,
    out_of_range: Sequence[Int[np.ndarray, "_ _v"]],
    unlocated: Int[np.ndarray, "u v"],
    tracks: TrackLines,
    tuning: TrackTuning,
) -> list[Shaped[np.ndarray, "_"]]:
    sources = [*selections, pairs]
    candidate = np.concatenate([source.candidates.index for source in sources])
    log_odds = np.concatenate([source.log_odds for source in sources])
    reasons = []
    for view, count in enumerate(inputs.counts):
        is_out_of_range, is_along_epipolar, is_matched, is_missing_in_third, is_in_pattern = (
            np.zeros((5, count), dtype=bool)
        )
        is_observed = tracks.index[:, view] >= 0
        is_matched[tracks.index[is_observed, view]] = True
        is_in_pattern[tracks.index[is_observed & tracks.is_in_pattern, view]] = True
        for index_outside in out_of_range:
            is_out_of_range[index_outside[index_outside[:, view] >= 0, view]] = True
        is_along_epipolar[unlocated[unlocated[:, view] >= 0, view]] = True
        is_rejected_by_third = (pairs.log_odds <= 0) & (pairs.log_odds > pairs.miss_log_odds)
        segment = pairs.candidates.index[is_rejected_by_third, view]
        is_missing_in_third[segment[segment >= 0]] = True
        kinds = is_out_of_range, is_along_epipolar, is_matched, is_missing_in_third, is_in_pattern
        reasons.append(unmatched_reasons(candidate[:, view], log_odds, *kinds, tuning))
    return reasons


# numerical: number of lines that are compared at once with all segments of a view.
ROWS_AT_A_TIME = 256


def flag_viewpoint_dependent(
    inputs: MatchInput,
    index: Int[np.ndarray, "t v"],
    ends_mm: Float[np.ndarray, "t 2 3"],
    misfit: Float[np.ndarray, "t"],
    tuning: TrackTuning = DEFAULT.tracks,
) -> Bool[np.ndarray, "t"]:
    """Return the mask of the tracks that probably show no line in space, (t,).

    In three or more views, the misfit of such a track is larger than noise explains. For tracks in
    two views, a third view has an unmatched segment that is parallel and close to the predicted
    segment. If most misfits are too large for the stated errors, all misfits are scaled first.

    Parameters
    ----------
    inputs : MatchInput
        Input of the matcher.
    index : (t, v)
        Segments of the tracks.
    ends_mm : (t, 2, 3)
        Ends of the lines, world frame.
    misfit : (t,)
        Chi-square of each fit, with 2 (n - 2) degrees of freedom for n views.
    tuning : TrackTuning
        Tuned constants.
    """
    views = (index >= 0).sum(axis=1)
    in_three, frame = views > 2, look_up_frames(inputs.lines, index)
    is_dependent = np.zeros(len(index), dtype=bool)
    if in_three.any():
        limit = chi_square_limit(tuning.significance, 2 * (views[in_three] - 2))
        noise_factor = broadcast_groups(
            typical_misfit(index, misfit, tuning, frame), take_groups(frame, in_three)
        )
        is_dependent[in_three] = misfit[in_three] > noise_factor * limit
    for view in range(index.shape[1]):
        is_free = np.ones(inputs.counts[view], dtype=bool)
        matched = index[in_three, view]
        is_free[matched[matched >= 0]] = False
        is_free = np.flatnonzero(is_free)
        rows = np.flatnonzero(~in_three & (index[:, view] < 0))
        matrix = take_matrices(inputs.lines, take_groups(frame, rows))[:, view]
        expected = project_by_matrix(matrix, ends_mm[rows])
        # Free segments of one frame are contiguous.
        first, last = np.zeros(len(rows), np.int64), np.full(len(rows), len(is_free))
        if frame is not None:
            bounds = np.searchsorted(is_free, inputs.starts[:, view])
            first, last = bounds[frame[rows]], bounds[frame[rows] + 1]
        size = ROWS_AT_A_TIME if frame is None else max(len(rows), 1)
        for part in blocks(len(rows), size):
            i, j = expand_ranges(first[part], last[part])
            segments = inputs.ends_px[view][is_free[j]]
            is_beside = _lies_beside(expected[part][i], segments, tuning)
            is_dependent[rows[part][i[is_beside]]] = True
    return is_dependent


def typical_misfit(
    index: Int[np.ndarray, "t v"],
    misfit: Float[np.ndarray, "t"],
    tuning: TrackTuning = DEFAULT.tracks,
    frame: Int[np.ndarray, "t"] | None = None,
) -> Float[np.ndarray, "*f"] | float:
    """Return the actual variance of most segments over their stated variance, at least 1.

    The estimate is the median misfit over its expected value. With `frame`, the frame of each
    track, the result has one factor for each frame, (f,).
    """
    views = (index >= 0).sum(axis=1)
    in_three = views > 2
    frames = 1 if frame is None or len(frame) == 0 else int(frame.max()) + 1
    frame_in_three = take_groups(frame, in_three)
    is_enough = (
        group_sums(np.ones(in_three.sum()), frame_in_three, frames) >= tuning.min_tracks_to_learn
    )
    ratio = misfit[in_three] / chi_square_quantile(0.5, 2 * (views[in_three] - 2))
    typical = np.where(is_enough, group_medians(ratio, frame_in_three, frames), 1.0)
    return np.maximum(typical, 1.0)


def _lies_beside(
    expected_px: Float[np.ndarray, "p 2 2"],
    segments_px: Float[np.ndarray, "p 2 2"],
    tuning: TrackTuning,
) -> Bool[np.ndarray, "p"]:
    """Return the mask of the segments that are close to the predicted segment and parallel to it,
    (p,).

    Row k of `segments_px` is compared with row k of `expected_px`.
    """
    is_beside = np.zeros(len(expected_px), dtype=bool)
    expected_step = expected_px[:, 1] - expected_px[:, 0]
    segment_step = segments_px[:, 1] - segments_px[:, 0]
    area = expected_step[:, 0] * segment_step[:, 1] - expected_step[:, 1] * segment_step[:, 0]
    squares = (expected_step**2).sum(axis=1), (segment_step**2).sum(axis=1)
    sine = np.sin(np.radians(tuning.beside_deg))
    rows = np.flatnonzero(area**2 < sine**2 * squares[0] * squares[1])
    expected_length, segment_length = (np.sqrt(square[rows]) for square in squares)
    u, v = (expected_step[rows] / expected_length[:, None]).T[:, :, None]
    offset = segments_px[rows] - expected_px[rows, :1]
    along = np.sort(offset[..., 0] * u + offset[..., 1] * v, axis=1)
    across = np.abs(offset[..., 1] * u - offset[..., 0] * v).max(axis=1)
    common = np.minimum(along[:, 1], expected_length) - np.maximum(along[:, 0], 0.0)
    required_px = tuning.abreast_share * np.minimum(expected_length, segment_length)
    is_beside[rows] = (across < tuning.beside_px) & (common > required_px)
    return is_beside
