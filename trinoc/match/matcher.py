"""The matcher: segments of two or more pictures to lines in space."""

from collections.abc import Mapping

import numpy as np

from trinoc.geometry import Rig, Segments
from trinoc.match.candidates import (
    Candidates,
    concatenated,
    in_depth_range,
    no_candidates,
    trinocular_candidates,
)
from trinoc.match.observations import fit_clutter, prepare
from trinoc.match.occlusion import occluded_pairs
from trinoc.match.selection import Selection, Tracks, select, tracks_of
from trinoc.match.tracks import Matches, assemble, merge_triplets, view_triplets
from trinoc.numerics import ArrayLike, in_float64


@in_float64
def match_segments(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] | None = None,
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

    Returns
    -------
    Matches; `posterior` is the probability of each, `rival_posterior` that of its best rival, and
    `reasons` says of every unmatched segment why it is.

    Raises
    ------
    MatchError, InputError : names without a camera, fewer than two views, coordinates that
        are not finite, segments without length.

    The order of segments, of their ends and of views changes nothing but the numbering.

    Source: Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular
    vision", 1986: candidates, selection by neighbours, occluded segments.
    """
    seen = prepare(segments, rig, sigma_px)
    clutter = fit_clutter(seen.lines, seen.counts)
    selections: list[Selection] = []
    outside = [np.zeros((0, len(seen.names)), dtype=np.int64)]
    for views in view_triplets(seen.lines):
        candidates = trinocular_candidates(seen.lines, views, seen.counts, clutter)
        if depth_range_mm is not None:
            inside = in_depth_range(candidates, seen.lines, depth_range_mm)
            outside.append(candidates.index[~inside])
            candidates = Candidates(*(field[inside] for field in candidates))
        selections.append(select(candidates, float(np.mean([seen.counts[v] for v in views]))))
    triples = [tracks_of(selection) for selection in selections]
    if triples:
        tracks = Tracks(
            concatenated([t.candidates for t in triples]),
            np.concatenate([t.posterior_log_odds for t in triples]),
            np.concatenate([t.rival_posterior for t in triples]),
        )
    else:
        tracks = Tracks(no_candidates(len(seen.names)), np.zeros(0), np.zeros(0))
    if len(triples) > 1:
        tracks = merge_triplets(seen.lines, tracks)
    pairs = occluded_pairs(seen.lines, seen.counts, clutter, tracks, selections, depth_range_mm)
    return assemble(seen, tracks, selections, pairs, np.concatenate(outside), tuple(segments))
