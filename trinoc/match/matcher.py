"""The matcher: segments of two or more pictures to lines in space."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Int

from trinoc.geometry import Rig, Segments
from trinoc.match.candidates import in_depth_range, no_candidates, trinocular_candidates
from trinoc.match.observations import (
    ClutterModel,
    MatchInput,
    fit_clutter,
    look_apart,
    mirrored_error,
    prepare,
    turned_round,
    with_noise_scale,
)
from trinoc.match.occlusion import occluded_pairs
from trinoc.match.selection import Selection, Tracks, residual_scale, select, tracks_of
from trinoc.match.tracks import (
    Matches,
    assemble,
    consolidated,
    merge_triplets,
    view_triplets,
)
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
    found = _matched(seen, tuple(segments), depth_range_mm, tuning)
    few = tuning.tracks.few_share * min(seen.counts)
    if len(found) < few and look_apart({name: rig[name] for name in segments}):
        turned = prepare(segments, turned_round(rig), sigma_px, tuning.sides)
        behind = len(_matched(turned, tuple(segments), depth_range_mm, tuning))
        if behind > few:
            raise mirrored_error(segments, len(found), behind)
    return found


def _matched(
    seen: MatchInput,
    names: tuple[str, ...],
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
) -> Matches:
    clutter = fit_clutter(seen.lines, seen.counts, tuning.clutter)
    noise_scale, stated = 1.0, seen
    for _ in range(tuning.noise.passes):
        selections, outside = _triples(seen, clutter, depth_range_mm, tuning)
        larger = residual_scale(selections, tuning.noise) if selections else 1.0
        before = noise_scale
        noise_scale = float(np.clip(before * larger, 1 / tuning.noise.most, tuning.noise.most))
        seen = with_noise_scale(stated, noise_scale)
        if tuning.noise.again_below < noise_scale / before < tuning.noise.again_above:
            break
    triples = [tracks_of(selection, tuning.evidence) for selection in selections]
    if triples:
        tracks = concatenate_rows(triples)
    else:
        tracks = Tracks(no_candidates(len(seen.names)), np.zeros(0), np.zeros(0))
    if len(triples) > 1:
        tracks = consolidated(seen, merge_triplets(seen.lines, tracks, tuning), tuning)
    pairs = occluded_pairs(
        seen.lines, seen.counts, clutter, tracks, selections, depth_range_mm, tuning
    )
    return assemble(seen, tracks, selections, pairs, outside, names, noise_scale, tuning)


def _triples(
    seen: MatchInput,
    clutter: ClutterModel,
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
) -> tuple[list[Selection], Int[np.ndarray, "o v"]]:
    """(what is selected in each three of the views, segments of triples out of range)."""
    selections: list[Selection] = []
    outside = [np.zeros((0, len(seen.names)), dtype=np.int64)]
    for views in view_triplets(seen.lines, tuning.tracks):
        candidates = trinocular_candidates(seen.lines, views, seen.counts, clutter, tuning)
        inside = in_depth_range(candidates, seen.lines, depth_range_mm)
        outside.append(candidates.index[~inside])
        candidates = candidates.take(inside)
        typical = float(np.mean([seen.counts[view] for view in views]))
        selections.append(select(candidates, typical, tuning=tuning))
    return selections, np.concatenate(outside)
