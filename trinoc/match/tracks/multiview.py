"""More than three views: merge the triples of several view triplets to tracks through all views.

A triple joins a track if they share two segments at one part, since two segments fix the line.
Its third segment must then agree with the track. A triple that contradicts a better one is
dropped, so that every cycle of a track closes. Two tracks of different views are merged if
triples link them in both directions.
"""

from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.observations.table import SegmentTable
from trinoc.match.selection.marginals import Tracks
from trinoc.match.tracks.line_fit import overlap_share, segment_position
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.tracks import TrackTuning


def view_triplets(
    lines: SegmentTable, tuning: TrackTuning = DEFAULT.tracks
) -> list[tuple[int, int, int]]:
    """Return the triplets of views to match.

    Few views: all triplets. Many views: each view with any two of its nearest views.
    """
    views = lines.size_px.shape[-2]
    if views <= tuning.max_views_all_triplets:
        return list(combinations(range(views), 3))
    centre = np.asarray(lines.centre_mm)
    distance = np.linalg.norm(centre[:, None] - centre, axis=2)
    nearest = np.argsort(distance, axis=1, kind="stable")[:, 1 : tuning.nearest_views + 1]
    triplets = set()
    for view in range(views):
        for other, another in combinations(nearest[view].tolist(), 2):
            a, b, c = sorted((view, other, another))
            triplets.add((a, b, c))
    return sorted(triplets)


def merge_triplets(lines: SegmentTable, tracks: Tracks, tuning: MatchTuning = DEFAULT) -> Tracks:
    """Merge the triples of several triplets of views to tracks through all views.

    The most likely triples are merged first.
    """
    order = np.lexsort((*tracks.candidates.index.T, -tracks.posterior_log_odds))
    index = tracks.candidates.index.copy()
    interval = tracks.candidates.interval.copy()
    ends = tracks.candidates.ends_mm.copy()
    matrix, segment_ends = np.asarray(lines.matrix_px), np.asarray(lines.ends_px)
    conflict, smallest_share = tuning.selection.conflict_overlap, tuning.tracks.min_shared_part
    on_segment: dict[tuple[int, int], list[int]] = {}
    selected_rows, links = [], []
    for row in order.tolist():
        views = np.flatnonzero(index[row] >= 0)
        rivals = [
            (track, view)
            for view in views
            for track in on_segment.get((int(view), int(index[row, view])), [])
            if overlap_share(interval[track, view], interval[row, view]) > conflict
        ]
        if not rivals:
            selected_rows.append(row)
            for view in views:
                on_segment.setdefault((int(view), int(index[row, view])), []).append(row)
            continue
        shared: dict[int, set[int]] = {}
        for track, view in rivals:
            shared.setdefault(track, set()).add(int(view))
        track = max(shared, key=lambda other: len(shared[other]))
        if len(shared) == 2 and sum(len(shared_views) for shared_views in shared.values()) == len(
            views
        ):
            links.append((track, min(other for other in shared if other != track)))
        new = [view for view in views if index[track, view] < 0]
        agrees = len(shared[track]) >= 2 and len(shared[track]) + len(new) == len(views)
        if not agrees or len(shared) > 1:
            continue
        for view in new:
            segment = segment_ends[view, index[row, view]]
            position = segment_position(segment, matrix[view], ends[track])
            if overlap_share(position, np.array([0.0, 1.0])) < smallest_share:
                continue
            index[track, view], interval[track, view] = index[row, view], position
            _shorten_to_common_part(index, interval, ends, track, matrix, segment_ends)
            on_segment.setdefault((int(view), int(index[row, view])), []).append(track)
    merged_rows = _link_tracks(links, index, interval, ends, matrix, segment_ends, smallest_share)
    selected_rows = np.array(
        [row for row in selected_rows if row not in merged_rows], dtype=np.int64
    )
    candidates = tracks.candidates._replace(index=index, interval=interval, ends_mm=ends)
    return tracks._replace(candidates=candidates).take(selected_rows)


def _link_tracks(
    links: list[tuple[int, int]],
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    ends_mm: Float[np.ndarray, "m 2 3"],
    matrix_px: Float[np.ndarray, "v 3 4"],
    segment_ends_px: Float[np.ndarray, "v n 2 2"],
    least_shared: float,
) -> set[int]:
    """Merge pairs of tracks without a common view that are linked in both directions.

    A link (a, b) is a triple with two segments of track a and one segment of track b. Links (a, b)
    and (b, a) together are evidence that both tracks show one line. The arrays are changed in
    place. The line of a and each segment of b must overlap by at least the share `least_shared` of
    the shorter one. Returns the tracks that were merged into another track.
    """
    merged: set[int] = set()
    merged_into: dict[int, int] = {}

    def current_track(track: int) -> int:
        return current_track(merged_into[track]) if track in merged_into else track

    both_ways = set(links)
    for a, b in dict.fromkeys(link for link in links if link[::-1] in both_ways):
        a, b = current_track(a), current_track(b)
        views = np.flatnonzero(index[b] >= 0)
        if a == b or (index[a, views] >= 0).any():
            continue
        positions = [
            segment_position(segment_ends_px[view, index[b, view]], matrix_px[view], ends_mm[a])
            for view in views
        ]
        if (
            min(overlap_share(position, np.array([0.0, 1.0])) for position in positions)
            < least_shared
        ):
            continue
        index[a, views], interval[a, views] = index[b, views], positions
        _shorten_to_common_part(index, interval, ends_mm, a, matrix_px, segment_ends_px)
        merged_into[b] = a
        merged.add(b)
    return merged


def _shorten_to_common_part(
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    ends_mm: Float[np.ndarray, "m 2 3"],
    track: int,
    matrix_px: Float[np.ndarray, "v 3 4"],
    segment_ends_px: Float[np.ndarray, "v n 2 2"],
) -> None:
    """Shorten the line of a track to the part that all of its segments show, in place."""
    views = np.flatnonzero(index[track] >= 0)
    begin, end = 0.0, 1.0
    for view in views:
        first, last = interval[track, view]
        bounds = np.sort((np.array([0.0, 1.0]) - first) / (last - first))
        begin, end = max(begin, bounds[0]), min(end, bounds[1])
    weight = np.array([[1 - begin, begin], [1 - end, end]])
    ends_mm[track] = weight @ ends_mm[track]
    for view in views:
        segment = segment_ends_px[view, index[track, view]]
        interval[track, view] = segment_position(segment, matrix_px[view], ends_mm[track])
