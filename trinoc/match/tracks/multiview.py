"""More than three views: triples of several triplets of views become tracks through all of them.

A triple joins a track with which it shares two segments at one part, since two fix the line;
then its third segment must not contradict the track's own. A triple that contradicts a better
one is dropped: every cycle of a track closes. Tracks of different views that triples tie both
ways are one.
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
    """The triplets of views to match: all of a few views, or each view with two of its nearest."""
    views = lines.size_px.shape[-2]
    if views <= tuning.all_triplets:
        return list(combinations(range(views), 3))
    centre = np.asarray(lines.centre_mm)
    distance = np.linalg.norm(centre[:, None] - centre, axis=2)
    near = np.argsort(distance, axis=1, kind="stable")[:, 1 : tuning.nearest_views + 1]
    threes = set()
    for view in range(views):
        for other, another in combinations(near[view].tolist(), 2):
            a, b, c = sorted((view, other, another))
            threes.add((a, b, c))
    return sorted(threes)


def merge_triplets(lines: SegmentTable, tracks: Tracks, tuning: MatchTuning = DEFAULT) -> Tracks:
    """Tracks through all views, from triples of several triplets, the likeliest first."""
    order = np.lexsort((*tracks.candidates.index.T, -tracks.posterior_log_odds))
    index, interval, ends = (
        tracks.candidates.index.copy(),
        tracks.candidates.interval.copy(),
        tracks.candidates.ends_mm.copy(),
    )
    matrix, segment_ends = np.asarray(lines.matrix_px), np.asarray(lines.ends_px)
    conflict, least = tuning.selection.conflict_overlap, tuning.tracks.min_shared
    on_segment: dict[tuple[int, int], list[int]] = {}
    kept, links = [], []
    for row in order.tolist():
        views = np.flatnonzero(index[row] >= 0)
        rivals = [
            (track, view)
            for view in views
            for track in on_segment.get((int(view), int(index[row, view])), [])
            if overlap_share(interval[track, view], interval[row, view]) > conflict
        ]
        if not rivals:
            kept.append(row)
            for view in views:
                on_segment.setdefault((int(view), int(index[row, view])), []).append(row)
            continue
        shared: dict[int, set[int]] = {}
        for track, view in rivals:
            shared.setdefault(track, set()).add(int(view))
        track = max(shared, key=lambda other: len(shared[other]))
        if len(shared) == 2 and sum(len(seen) for seen in shared.values()) == len(views):
            links.append((track, min(other for other in shared if other != track)))
        new = [view for view in views if index[track, view] < 0]
        agrees = len(shared[track]) >= 2 and len(shared[track]) + len(new) == len(views)
        if not agrees or len(shared) > 1:
            continue
        for view in new:
            segment = segment_ends[view, index[row, view]]
            place = segment_position(segment, matrix[view], ends[track])
            if overlap_share(place, np.array([0.0, 1.0])) < least:
                continue
            index[track, view], interval[track, view] = index[row, view], place
            _cut(index, interval, ends, track, matrix, segment_ends)
            on_segment.setdefault((int(view), int(index[row, view])), []).append(track)
    gone = _link_tracks(links, index, interval, ends, matrix, segment_ends, least)
    kept = np.array([row for row in kept if row not in gone], dtype=np.int64)
    candidates = tracks.candidates._replace(index=index, interval=interval, ends_mm=ends)
    return tracks._replace(candidates=candidates).take(kept)


def _link_tracks(
    links: list[tuple[int, int]],
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    ends_mm: Float[np.ndarray, "m 2 3"],
    matrix_px: Float[np.ndarray, "v 3 4"],
    segment_ends_px: Float[np.ndarray, "v n 2 2"],
    least_shared: float,
) -> set[int]:
    """Tracks that became part of others: those of other views, tied to them both ways.

    A link (a, b) is a triple of two segments of track a and one of b: with one from b to a,
    the segments of both are of one line.
    """
    gone: set[int] = set()
    joined: dict[int, int] = {}

    def now(track: int) -> int:
        return now(joined[track]) if track in joined else track

    both_ways = set(links)
    for a, b in dict.fromkeys(link for link in links if link[::-1] in both_ways):
        a, b = now(a), now(b)
        into = np.flatnonzero(index[b] >= 0)
        if a == b or (index[a, into] >= 0).any():
            continue
        places = [
            segment_position(segment_ends_px[view, index[b, view]], matrix_px[view], ends_mm[a])
            for view in into
        ]
        if min(overlap_share(place, np.array([0.0, 1.0])) for place in places) < least_shared:
            continue
        index[a, into], interval[a, into] = index[b, into], places
        _cut(index, interval, ends_mm, a, matrix_px, segment_ends_px)
        joined[b] = a
        gone.add(b)
    return gone


def _cut(
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    ends_mm: Float[np.ndarray, "m 2 3"],
    track: int,
    matrix_px: Float[np.ndarray, "v 3 4"],
    segment_ends_px: Float[np.ndarray, "v n 2 2"],
) -> None:
    """Cut a track's line to what all of its segments show, and its parts with it."""
    views = np.flatnonzero(index[track] >= 0)
    begin, end = 0.0, 1.0
    for view in views:
        first, last = interval[track, view]
        inside = np.sort((np.array([0.0, 1.0]) - first) / (last - first))
        begin, end = max(begin, inside[0]), min(end, inside[1])
    weight = np.array([[1 - begin, begin], [1 - end, end]])
    ends_mm[track] = weight @ ends_mm[track]
    for view in views:
        segment = segment_ends_px[view, index[track, view]]
        interval[track, view] = segment_position(segment, matrix_px[view], ends_mm[track])
