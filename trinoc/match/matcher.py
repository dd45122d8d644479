"""The matcher: segments of two or more pictures to lines in space."""

from collections.abc import Iterable, Mapping, Sequence
from typing import get_args

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.candidates.table import Candidates
from trinoc.match.decoys import Verification, check_set
from trinoc.match.observations.clutter import fit_clutter
from trinoc.match.observations.common_view import mirror_rig, mirrored_rig_error, views_diverge
from trinoc.match.observations.match_input import (
    FrameInput,
    MatchInput,
    prepare_frame,
    stack_frames,
    with_noise_scale,
)
from trinoc.match.observations.table import segments_per_view
from trinoc.match.observations.unusable import leave_out_unusable
from trinoc.match.occlusion.pairs import match_occluded
from trinoc.match.scouting import find_triples
from trinoc.match.selection.marginals import Selection, learn_noise_scale, select
from trinoc.match.tracks.assembly import assemble
from trinoc.match.tracks.consolidation import tracks_through_views
from trinoc.match.tracks.matches import Matches
from trinoc.match.tracks.view_support import with_view_support
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.tables import with_field


@in_float64
def match_segments(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] | None = None,
    verify: Verification = "full",
    tuning: MatchTuning = DEFAULT,
) -> Matches:
    """Match line segments across the views of a rig, by geometry and the grey levels beside them.

    Parameters
    ----------
    segments : camera names to Segments, or to arrays of x1 y1 x2 y2 from any detector, (n, 4) or
        (n, 1, 4), in pixels of the picture. Two views give pairs only, three or more give triples,
        and pairs of what the others do not show.
    rig : holds a camera of every name in `segments`, and may hold more.
    sigma_px : standard deviation of the ends across the segments, in place of their own.
    depth_range_mm : least and greatest depth before every camera that sees a line; by default
        lines lie anywhere before the cameras.
    verify : how thoroughly three views are checked for belonging to the rig. "quick" compares
        doubtful sets with what chance gives, which takes a part of the matching's own time;
        "full" also looks for the mistake in a refused or very doubtful set, up to 30 matchings of
        its longest segments; "off" checks nothing.
    tuning : every tuned constant of the method; a benchmark or a study changes them.

    Returns
    -------
    Matches; `posterior` is the probability of each, `rival_posterior` that of its best rival, and
    `reasons` says of every unmatched segment why it is.

    Raises
    ------
    MatchError, InputError : names without a camera, fewer than two views, coordinates that
        are not finite, segments without length, mirrored cameras, depths that are no range.

    The order of segments, of their ends and of views changes nothing but the numbering.

    Source: Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular
    vision", 1986: candidates, selection by neighbours, occluded segments.
    """
    check_depth_range(depth_range_mm)
    check_verification(verify)
    frame = prepare_frame(segments, rig, sigma_px, tuning.sides)
    found = match_frames([frame], [tuple(segments)], depth_range_mm, tuning)[0]
    check_before_cameras(frame, found, segments, rig, sigma_px, depth_range_mm, tuning)
    return check_together(frame, tuple(segments), found, depth_range_mm, tuning, verify)


def check_depth_range(depth_range_mm: tuple[float, float] | None) -> None:
    """Raises InputError for what is no pair of depths, or holds none."""
    if depth_range_mm is None:
        return
    near, far = depth_range_mm if np.shape(depth_range_mm) == (2,) else (np.nan, np.nan)
    if not 0 <= near < far:
        raise InputError(
            f"depth_range_mm is {depth_range_mm}, which holds no depth: give the least, then the "
            "greatest, in mm."
        )


def check_verification(verify: str) -> None:
    """Raises InputError for a word that names no verification."""
    if verify not in get_args(Verification):
        raise InputError(f'verify is "{verify}": give "full", "quick" or "off".')


def check_together(
    frame: FrameInput,
    names: tuple[str, ...],
    found: Matches,
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
    verify: Verification,
) -> Matches:
    """The matches with the status that competition with decoys gives."""

    def match(frame: FrameInput, *, in_three: bool = False) -> Matches:
        # Chance is as sure of patterns as the rig: both are counted as if nothing repeated.
        rules = with_field(tuning, "repetition.greatest_log_odds", np.inf)
        if in_three:
            # No segment is left for pairs, and wrong views learn no noise for long.
            rules = with_field(rules, "occlusion.max_matched_share", 0.0)
            rules = with_field(rules, "noise.passes", tuning.decoys.passes)
        return match_frames([frame], [frame.names], depth_range_mm, rules)[0]

    return check_set(frame, names, found, match, tuning.decoys, verify)


def check_before_cameras(
    frame: FrameInput,
    found: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    sigma_px: float | None,
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
) -> None:
    """Raise InputError where few lines lie before cameras that diverge, and more behind them."""
    few = tuning.tracks.few_share * min(len(ends) for ends in frame.ends_px)
    if len(found) < few and views_diverge({name: rig[name] for name in segments}):
        turned = prepare_frame(segments, mirror_rig(rig), sigma_px, tuning.sides)
        behind = len(match_frames([turned], [tuple(segments)], depth_range_mm, tuning)[0])
        if behind > few:
            raise mirrored_rig_error(segments, len(found), behind)


def match_frames(
    frames: Sequence[FrameInput],
    names: Sequence[tuple[str, ...]],
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
) -> list[Matches]:
    """Matches of frames of as many views each, as one problem; `names` are the caller's views.

    More than one frame have three views at most, and are FRAMES_AT_ONCE at most. Each learns the
    errors of its own segments, in as many passes as that takes.
    """
    frames = [leave_out_unusable(frame, tuning.observations) for frame in frames]
    stated, left = stack_frames(frames), np.arange(len(frames))
    scale, found = np.ones(len(frames)), dict[int, Matches]()
    for passes_left in reversed(range(tuning.noise.passes)):
        seen = with_noise_scale(stated, scale[left])
        clutter = fit_clutter(seen.lines, seen.counts, tuning.clutter)
        # The steps of the paper: 1 candidates, 2 selection by neighbours, 3 occluded segments.
        triples = find_triples(seen, clutter, depth_range_mm, tuning)
        selections, outside = _select_triples(seen, triples, tuning)
        scale[left], again = learn_noise_scale(
            selections, np.asarray(stated.lines.across_px2), scale[left], tuning.noise
        )
        again &= passes_left > 0
        if not again.all():
            seen = with_noise_scale(stated, scale[left])
            tracks, larger = tracks_through_views(seen, selections, tuning)
            seen = with_noise_scale(seen, np.full(len(left), larger))
            scale[left] *= larger
            tracks, pairs = match_occluded(
                seen, clutter, tracks, selections, depth_range_mm, tuning
            )
            tracks = with_view_support(seen, tracks, tuning)
            called, judged = [names[k] for k in left.tolist()], (tracks, selections, pairs, outside)
            results = assemble(seen, *judged, called, scale[left], tuning)
            found |= {k: results[n] for n, k in enumerate(left.tolist()) if not again[n]}
        if not again.any():
            break
        left = left[again]
        stated = stack_frames([frames[k] for k in left.tolist()])
    return [found[k] for k in range(len(frames))]


def _select_triples(
    seen: MatchInput,
    triples: Iterable[tuple[tuple[int, int, int], Candidates, np.ndarray]],
    tuning: MatchTuning,
) -> tuple[list[Selection], list[np.ndarray]]:
    """(selection among the triples of each three of the views, segments of those out of range)."""
    selections, outside = [], []
    for views, candidates, index in triples:
        counts = [seen.counts[view] if view in views else 0 for view in range(len(seen.counts))]
        typical = segments_per_view(seen.lines, counts) * len(counts) / 3
        selections.append(select(candidates, typical, tuning=tuning))
        outside.append(index)
    return selections, outside
