"""The matcher: segments of two or more pictures to lines in space."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from trinoc.geometry.arrays import ArrayLike
from trinoc.geometry.precision import in_float64
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.candidates import Candidates, strangers_of, trinocular_candidates
from trinoc.match.matches import Matches
from trinoc.match.observed import observe
from trinoc.match.occluded import occluded
from trinoc.match.selection import select
from trinoc.match.tracks import assemble


@in_float64
def match_segments(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    sigma_px: float | None = None,
) -> Matches:
    """Match line segments across the views of a rig, by geometry.

    `segments` maps camera names to Segments, or to (n, 4) arrays of x1 y1 x2 y2 in pixels of
    the picture. `sigma_px` overrides the standard deviation of ends across the segments.
    Raises MatchError and InputError.

    Source: Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular
    vision", 1986.
    """
    seen = observe(segments, rig, sigma_px)
    strangers = strangers_of(seen.lines, seen.counts)
    found = [
        trinocular_candidates(seen.lines, views, seen.counts, strangers)
        for views in combinations(range(len(seen.names)), 3)
    ]
    candidates = Candidates(*(np.concatenate(column) for column in zip(*found, strict=True)))
    selection = select(candidates, float(np.mean(seen.counts)))
    pairs = occluded(seen.lines, seen.counts, strangers, selection)
    return assemble(seen, selection, pairs, tuple(segments))
