"""The matcher: segments of two or more pictures to lines in space."""

from collections.abc import Mapping

import numpy as np

from trinoc.geometry import Rig, Segments
from trinoc.match.candidates import in_depth_range, no_candidates, trinocular_candidates
from trinoc.match.observations import fit_clutter, prepare
from trinoc.match.occlusion import occluded_pairs
from trinoc.match.selection import Selection, Tracks, select, tracks_of
from trinoc.match.tracks import Matches, assemble, merge_triplets, view_triplets
from trinoc.match.tuning import DEFAULT, MatchTuning
from trinoc.numerics import ArrayLike, concatenate_rows, in_float64


@in_float64
def match_segments(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] | None = None,
    tuning: MatchTuning = DEFAULT,
) -> Matches:
    """Match line segments across the views of a rig, by geometry and the grey levels beside them.

    Parameters
    ----------
    segments : camera names to Segments, or to (n, 4) arrays of x1 y1 x2 y2 from any detector,
        in pixels of the picture. Two views give pairs only, three or more give triples, and
        pairs of what the others do not show.
    rig : holds a camera of every name in `segments`, and may hold more.
    sigma_px : standard deviation of the ends across the segments, in place of their own.
    depth_range_mm : least and greatest depth before every camera that sees a line; by default
        lines lie anywhere before the cameras.
    tuning : every tuned constant of the method; a benchmark or a study changes them.

    Returns
    -------
    Matches; `posterior` is the probability of each, `rival_posterior` that of its best rival, and
    `reasons` says of every unmatched segment why it is.

    Raises
    ------
    MatchError, InputError : names without a camera, fewer than two views, coordinates that
        are not finite, segments without length, mirrored cameras.

    The order of segments, of their ends and of views changes nothing but the numbering.

    Source: Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular
    vision", 1986: candidates, selection by neighbours, occluded segments.
    """
    seen = prepare(segments, rig, sigma_px, tuning.sides)
    clutter = fit_clutter(seen.lines, seen.counts, tuning.clutter)
    selections: list[Selection] = []
    outside = [np.zeros((0, len(seen.names)), dtype=np.int64)]
    for views in view_triplets(seen.lines, tuning.tracks):
        candidates = trinocular_candidates(seen.lines, views, seen.counts, clutter, tuning)
        inside = in_depth_range(candidates, seen.lines, depth_range_mm)
        outside.append(candidates.index[~inside])
        candidates = candidates.take(inside)
        typical = float(np.mean([seen.counts[view] for view in views]))
        selections.append(select(candidates, typical, tuning=tuning))
    triples = [tracks_of(selection, tuning.evidence) for selection in selections]
    if triples:
        tracks = concatenate_rows(triples)
    else:
        tracks = Tracks(no_candidates(len(seen.names)), np.zeros(0), np.zeros(0))
    if len(triples) > 1:
        tracks = merge_triplets(seen.lines, tracks, tuning)
    pairs = occluded_pairs(
        seen.lines, seen.counts, clutter, tracks, selections, depth_range_mm, tuning
    )
    excluded = np.concatenate(outside)
    return assemble(seen, tracks, selections, pairs, excluded, tuple(segments), tuning.tracks)
