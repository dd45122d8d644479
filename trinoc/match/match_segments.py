"""The matcher: segments of two or more pictures to lines in space."""

from collections.abc import Mapping

import numpy as np

from trinoc.geometry.arrays import ArrayLike
from trinoc.geometry.precision import in_float64
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.candidates import (
    Candidates,
    in_depth_range,
    joined_candidates,
    no_candidates,
    strangers_of,
    trinocular_candidates,
)
from trinoc.match.matches import Matches
from trinoc.match.merging import Tracks, merged, threes_of_views
from trinoc.match.observed import observe
from trinoc.match.occluded import occluded
from trinoc.match.selection import Selection, select, tracks_of
from trinoc.match.tracks import assemble


@in_float64
def match_segments(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] | None = None,
) -> Matches:
    """Match line segments across the views of a rig, by geometry.

    Parameters
    ----------
    segments : camera names to Segments, or to (n, 4) arrays of x1 y1 x2 y2 from any detector,
        in pixels of the picture. Two views give pairs only, three or more give triples, and
        pairs of what the others do not show.
    rig : holds a camera of every name in `segments`, and may hold more.
    sigma_px : standard deviation of the ends across the segments, in place of their own.
    depth_range_mm : least and greatest depth before every camera that sees a line; by default
        lines lie anywhere before the cameras.

    Returns
    -------
    Matches; `posterior` is the probability of each, `runner_up` that of its best rival, and
    `reasons` says of every unmatched segment why it is.

    Raises
    ------
    MatchError, InputError : names without a camera, fewer than two views, coordinates that
        are not finite, segments without length.

    The order of segments, of their ends and of views changes nothing but the numbering.

    Source: Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular
    vision", 1986: candidates, selection by neighbours, occluded segments.
    """
    seen = observe(segments, rig, sigma_px)
    strangers = strangers_of(seen.lines, seen.counts)
    selections: list[Selection] = []
    outside = [np.zeros((0, len(seen.names)), dtype=np.int64)]
    for views in threes_of_views(seen.lines):
        candidates = trinocular_candidates(seen.lines, views, seen.counts, strangers)
        if depth_range_mm is not None:
            inside = in_depth_range(candidates, seen.lines, depth_range_mm)
            outside.append(candidates.index[~inside])
            candidates = Candidates(*(field[inside] for field in candidates))
        selections.append(select(candidates, float(np.mean([seen.counts[v] for v in views]))))
    triples = [tracks_of(selection) for selection in selections]
    if triples:
        tracks = Tracks(
            joined_candidates([t.candidates for t in triples]),
            np.concatenate([t.belief for t in triples]),
            np.concatenate([t.runner_up for t in triples]),
        )
    else:
        tracks = Tracks(no_candidates(len(seen.names)), np.zeros(0), np.zeros(0))
    if len(triples) > 1:
        tracks = merged(seen.lines, tracks)
    pairs = occluded(seen.lines, seen.counts, strangers, tracks, selections, depth_range_mm)
    return assemble(seen, tracks, selections, pairs, np.concatenate(outside), tuple(segments))
