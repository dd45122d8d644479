"""From what was selected to tracks: fragments, lines in space with covariance, and reasons.

Two views place a line where their interpretation planes cross. A segment nearly along its
epipolar line leaves the crossing open: how open, tells the error of its direction in the picture
over its angle to the epipolar line. Errors in space are inverse to that angle, so that their second
order counts where it is in doubt, and they have no covariance where it may be zero.

Tracks that are no line in space: what they show depends on the viewpoint.

Each camera sees another outline of a round body, and another line of light on a shiny one. Where
three views are joined to a track all the same, they disagree about its place. Where the third
view was rejected, its own outline is left over beside the place where the track would be.
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
    LET_GO,
    SURE,
    UNLOCATED,
    Lines,
    answers,
    reasons,
)
from trinoc.match.tracks.line_fit import (
    before_cameras,
    cut_fragments,
    ends_in_span,
    lines_in_space,
    segment_reaches,
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
    seen: MatchInput,
    tracks: Tracks,
    selections: list[Selection],
    pairs: Pairs,
    outside: Sequence[Int[np.ndarray, "_ _v"]],
    names: Sequence[tuple[str, ...]],
    noise_scale: Float[np.ndarray, "f"],
    rules: MatchTuning = DEFAULT,
) -> list[Matches]:
    """Matches of each frame, in the caller's order of views (`names`) and numbers of segments.

    `seen` holds covariances that are `noise_scale` times as large, in standard deviations, as
    stated, `outside` the segments of triples that the depth range excluded, or that lie behind a
    camera. Tracks that no pair of views can locate are left out, and their segments say so.
    """
    repeating = [
        find_repetition(own.candidates, own.log_odds, own.graph, rules.repetition)
        for own in selections
    ]
    repetition = concatenate_rows([NO_REPETITION, *repeating])
    found, unlocated = _lines(seen, tracks, pairs.take(pairs.taken), repetition, rules)
    words = _reasons(seen, selections, pairs, outside, unlocated, found, rules.tracks)
    of_each = {
        "triples considered": [selection.candidates.index for selection in selections],
        "triples outside depth": outside,
        LET_GO: [selection.let_go for selection in selections],
        "tracks in three views or more": [tracks.candidates.index],
        "pairs considered": [pairs.candidates.index],
        "tracks in two views": [pairs.candidates.index[pairs.taken]],
        UNLOCATED: [unlocated],
        "tracks that seem to move with the viewpoint": [found.index[found.viewpoint_dependent]],
        SURE: [found.index_likelier_than(rules.decoys.sure)],
        CERTAIN: [found.index_likelier_than(rules.decoys.certain)],
    }
    counts = {name: _of_each_frame(seen, groups) for name, groups in of_each.items()}
    frame = look_up_frames(seen.lines, found.index)
    each = np.zeros(len(found.index), np.int64) if frame is None else frame
    return answers(seen, found, each, words, counts, names, noise_scale, rules.noise)


def _of_each_frame(seen: MatchInput, groups: list[np.ndarray]) -> Int[np.ndarray, "f"]:
    """How many groups of segments there are in each frame."""
    frames = [look_up_frames(seen.lines, index) for index in groups]
    labels = [
        np.zeros(len(index), np.int64) if frame is None else frame
        for frame, index in zip(frames, groups, strict=True)
    ]
    every = np.concatenate([np.zeros(0, np.int64), *labels])
    return np.bincount(every, minlength=len(seen.frames))


def _lines(
    seen: MatchInput, tracks: Tracks, taken: Pairs, repetition: Repetition, rules: MatchTuning
) -> tuple[Lines, Int[np.ndarray, "u v"]]:
    """(lines in space, segments of tracks that no pair of views can locate)."""
    index = np.concatenate([tracks.candidates.index, taken.candidates.index])
    interval = np.concatenate([tracks.candidates.interval, taken.candidates.interval])
    both = (tracks, taken)
    alone = np.concatenate([each.posterior_log_odds for each in both])
    greatest = np.concatenate([greatest_log_odds(each.candidates, repetition) for each in both])
    of_pattern = greatest < np.minimum(alone, rules.repetition.likely_log_odds)
    tuning = rules.tracks
    rival_posterior = np.concatenate([tracks.rival_posterior, np.full(len(taken.taken), -np.inf)])
    of_tracks = tracks.member_posterior
    members = np.full((len(index), index.shape[1]), np.nan)
    if of_tracks is not None:
        members[: len(of_tracks)] = of_tracks
    common_mm = np.concatenate([tracks.candidates.ends_mm, taken.candidates.ends_mm])
    doubt = direction_doubt(seen.lines, index)
    located = doubt < tuning.largest_direction_doubt
    reach = segment_reaches(seen, index, common_mm)
    ends_here = ends_in_span(reach, np.array([0.0, 1.0]))
    fragments, covariance = cut_fragments(seen, index, interval, ends_here)
    ends_mm, covariance_mm2, misfit = lines_in_space(seen, index, common_mm, reach)
    covariance_mm2 = covariance_mm2 * (1 + tuning.second_order * doubt**2)[:, None, None]
    sound = np.isfinite(ends_mm).all(axis=(1, 2)) & np.isfinite(covariance_mm2).all(axis=(1, 2))
    sound &= located & before_cameras(seen.lines, index, ends_mm)
    every = Lines(
        index,
        fragments,
        ends_mm,
        covariance_mm2,
        limit_log_odds(alone, greatest),
        rival_posterior,
        covariance,
        misfit,
        np.zeros(len(index), dtype=bool),
        of_pattern,
        alone,
        members,
    )
    found = take_rows(every, sound)
    dependent = flag_viewpoint_dependent(seen, found.index, found.ends_mm, found.misfit, tuning)
    return found._replace(viewpoint_dependent=dependent), index[~located]


def direction_doubt(lines: SegmentTable, index: Int[np.ndarray, "t v"]) -> Float[np.ndarray, "t"]:
    """Standard deviation of a segment's direction over its angle to the epipolar line.

    The larger of the two segments of a pair of views, and the least of all pairs of a track.
    """
    least, frame = np.full(len(index), np.inf), look_up_frames(lines, index)
    for a, b in combinations(range(index.shape[1]), 2):
        on = np.flatnonzero((index[:, a] >= 0) & (index[:, b] >= 0))
        own = take_groups(frame, on)
        pair = np.maximum(
            _of_view(lines, a, b, index[on, a], own), _of_view(lines, b, a, index[on, b], own)
        )
        least[on] = np.minimum(least[on], pair)
    return least


def _of_view(
    lines: SegmentTable,
    view: int,
    other: int,
    segment: Int[np.ndarray, "n"],
    frame: Int[np.ndarray, "n"] | None,
) -> Float[np.ndarray, "n"]:
    ends = np.asarray(lines.ends_px)[view, segment]
    across = np.asarray(lines.across_px2)[view, segment]
    centre = np.asarray(lines.centre_mm)
    centre = centre[None, other] if frame is None else centre[frame, other]
    matrix = take_matrices(lines, frame)[:, view]
    epipole = (matrix[..., :3] @ centre[..., None])[..., 0] + matrix[..., 3]
    step, middle = ends[:, 1] - ends[:, 0], ends.mean(axis=1)
    # Toward the epipole, which may lie at infinity.
    toward = epipole[:, :2] - epipole[:, 2:] * middle
    area = step[:, 0] * toward[:, 1] - step[:, 1] * toward[:, 0]
    spread = np.sqrt(across[:, 0, 0] + across[:, 1, 1] - 2 * across[:, 0, 1])
    offset = np.abs(area) / np.linalg.norm(toward, axis=1)
    return spread / np.maximum(offset, 1e-12)


def _reasons(
    seen: MatchInput,
    selections: list[Selection],
    pairs: Pairs,
    outside: Sequence[Int[np.ndarray, "_ _v"]],
    unlocated: Int[np.ndarray, "u v"],
    tracks: Lines,
    tuning: TrackTuning,
) -> list[Shaped[np.ndarray, "_"]]:
    running = [*selections, pairs]
    candidate = np.concatenate([found.candidates.index for found in running])
    log_odds = np.concatenate([found.log_odds for found in running])
    words = []
    for view, count in enumerate(seen.counts):
        excluded, along, matched, missed, of_pattern = np.zeros((5, count), dtype=bool)
        shown = tracks.index[:, view] >= 0
        matched[tracks.index[shown, view]] = True
        of_pattern[tracks.index[shown & tracks.of_pattern, view]] = True
        for index_outside in outside:
            excluded[index_outside[index_outside[:, view] >= 0, view]] = True
        along[unlocated[unlocated[:, view] >= 0, view]] = True
        turned = (pairs.log_odds <= 0) & (pairs.log_odds > pairs.missed)
        owner = pairs.candidates.index[turned, view]
        missed[owner[owner >= 0]] = True
        kinds = excluded, along, matched, missed, of_pattern
        words.append(reasons(candidate[:, view], log_odds, *kinds, tuning))
    return words


# numerical: lines of two views compared at once with all segments of a view.
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
    in_three, frame = views > 2, look_up_frames(seen.lines, index)
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
        matrix = take_matrices(seen.lines, take_groups(frame, rows))[:, view]
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
            beside = _lies_abreast(expected[part][i], segments, tuning)
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


def _lies_abreast(
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
