"""Match segments of two or more views: steps 1 to 3 of the paper, repeated until the noise scale
is stable.
"""

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
from trinoc.match.observations.unusable import exclude_unusable
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
    """Match line segments of two or more views, and return the tracks with their lines in space.

    Parameters
    ----------
    segments : mapping
        `Segments` for each camera name. Arrays (n, 4) or (n, 1, 4) of x1 y1 x2 y2 from any
        detector, in pixels of the image, are also accepted. Two views give pairs only. Three or
        more views give triples, and pairs of segments that the other views do not show.
    rig : Rig
        The cameras. A rig may have more cameras than `segments` has names.
    sigma_px : float, optional
        Standard deviation of the ends across the segments, instead of the covariances of the
        segments.
    depth_range_mm : (float, float), optional
        Smallest and largest depth in front of every camera that shows a line. Default: any positive
        depth.
    verify : "full", "quick" or "off"
        Test whether the segments of three views belong to the rig. If few segments match, "quick"
        compares their number with chance, in a fraction of the matching time. "full" also searches
        for the mistake if the status is SUSPECT or very few segments match. It then matches the
        longest segments up to 30 times. "off" tests nothing.
    tuning : MatchTuning
        All tuned constants of the method.

    Returns
    -------
    Matches
        `posterior` is the probability of each match. `rival_posterior` is that of its best rival,
        another match that uses the same part of a segment. `reasons` contains the reason why a
        segment has no match.

    Raises
    ------
    MatchError, InputError
        If a name has no camera or fewer than two views have segments. If coordinates are not finite
        or a segment has no length. If a camera is mirrored or the depth range is invalid.

    Notes
    -----
    The matches depend on the geometry and on the grey levels beside the segments. Another sequence
    of segments, of their ends or of views changes only the numbering of the result.

    References
    ----------
    Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular vision", 1986.
    """
    check_depth_range(depth_range_mm)
    check_verification(verify)
    frame = prepare_frame(segments, rig, sigma_px, tuning.sides)
    matches = match_frames([frame], [tuple(segments)], depth_range_mm, tuning)[0]
    check_before_cameras(frame, matches, segments, rig, sigma_px, depth_range_mm, tuning)
    return check_rig_consistency(frame, tuple(segments), matches, depth_range_mm, tuning, verify)


def check_depth_range(depth_range_mm: tuple[float, float] | None) -> None:
    """Raise `InputError` unless the range is None or two depths with 0 <= smallest < largest."""
    if depth_range_mm is None:
        return
    smallest, largest = depth_range_mm if np.shape(depth_range_mm) == (2,) else (np.nan, np.nan)
    if not 0 <= smallest < largest:
        raise InputError(
            f"depth_range_mm is {depth_range_mm}, which contains no depth: give the smallest, then "
            "the largest depth, in mm."
        )


def check_verification(verify: str) -> None:
    """Raise `InputError` if `verify` is not one of the allowed values."""
    if verify not in get_args(Verification):
        raise InputError(f'verify is "{verify}": give "full", "quick" or "off".')


def check_rig_consistency(
    frame: FrameInput,
    names: tuple[str, ...],
    matches: Matches,
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
    verify: Verification,
) -> Matches:
    """Return the matches, with the status SUSPECT if the segments do not belong to the rig.

    The number of sure tracks is compared with that of decoys: the same segments with one view
    mirrored or upside down. See `check_set`. `names` is the caller's sequence of views.
    """

    def match(frame: FrameInput, *, three_views_only: bool = False) -> Matches:
        # Repeated patterns lower posteriors of rig and decoys alike, so both go without.
        decoy_tuning = with_field(tuning, "repetition.max_log_odds", np.inf)
        if three_views_only:
            # No segment remains for pairs. Decoys need few passes over their noise.
            decoy_tuning = with_field(decoy_tuning, "occlusion.max_matched_share", 0.0)
            decoy_tuning = with_field(decoy_tuning, "noise.passes", tuning.decoys.passes)
        return match_frames([frame], [frame.names], depth_range_mm, decoy_tuning)[0]

    return check_set(frame, names, matches, match, tuning.decoys, verify)


def check_before_cameras(
    frame: FrameInput,
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    sigma_px: float | None,
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
) -> None:
    """Raise `InputError` if the rig is mirrored, that is, if the scene lies behind its cameras.

    A rig is mirrored under three conditions. Its cameras diverge, few lines lie in front of the
    cameras, and more lines lie behind the cameras.
    """
    few_lines = tuning.tracks.mirror_test_share * min(len(ends) for ends in frame.ends_px)
    if len(matches) < few_lines and views_diverge({name: rig[name] for name in segments}):
        mirrored_frame = prepare_frame(segments, mirror_rig(rig), sigma_px, tuning.sides)
        count_behind = len(
            match_frames([mirrored_frame], [tuple(segments)], depth_range_mm, tuning)[0]
        )
        if count_behind > few_lines:
            raise mirrored_rig_error(segments, len(matches), count_behind)


def match_frames(
    frames: Sequence[FrameInput],
    names: Sequence[tuple[str, ...]],
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning,
) -> list[Matches]:
    """Match several frames with the same number of views as one problem.

    The noise scale of each frame is estimated from its own segments. A frame whose scale changes
    much is matched again.

    Parameters
    ----------
    frames : sequence of FrameInput
        Segments and cameras of each frame. With more than three views, a single frame; otherwise at
        most FRAMES_AT_ONCE frames.
    names : sequence of tuple of str
        View names of each frame, in the caller's sequence.
    depth_range_mm : (float, float) or None
        Allowed depths before each camera.
    tuning : MatchTuning
        Tuned constants.

    Returns
    -------
    list of Matches
        Matches of each frame.
    """
    frames = [exclude_unusable(frame, tuning.observations) for frame in frames]
    stated_inputs, active_frames = stack_frames(frames), np.arange(len(frames))
    frame_noise_scale, matches = np.ones(len(frames)), dict[int, Matches]()
    for passes_left in reversed(range(tuning.noise.passes)):
        inputs = with_noise_scale(stated_inputs, frame_noise_scale[active_frames])
        clutter = fit_clutter(inputs.lines, inputs.counts, tuning.clutter)
        # The steps of the paper: 1 candidates, 2 selection by neighbours, 3 occluded segments.
        triples = find_triples(inputs, clutter, depth_range_mm, tuning)
        selections, out_of_range = _select_triples(inputs, triples, tuning)
        frame_noise_scale[active_frames], needs_another_pass = learn_noise_scale(
            selections,
            np.asarray(stated_inputs.lines.across_px2),
            frame_noise_scale[active_frames],
            tuning.noise,
        )
        needs_another_pass &= passes_left > 0
        if not needs_another_pass.all():
            inputs = with_noise_scale(stated_inputs, frame_noise_scale[active_frames])
            tracks, noise_factor = tracks_through_views(inputs, selections, tuning)
            inputs = with_noise_scale(inputs, np.full(len(active_frames), noise_factor))
            frame_noise_scale[active_frames] *= noise_factor
            tracks, pairs = match_occluded(
                inputs, clutter, tracks, selections, depth_range_mm, tuning
            )
            tracks = with_view_support(inputs, tracks, tuning)
            results = assemble(
                inputs,
                tracks,
                selections,
                pairs,
                out_of_range,
                [names[k] for k in active_frames.tolist()],
                frame_noise_scale[active_frames],
                tuning,
            )
            matches |= {
                k: results[n]
                for n, k in enumerate(active_frames.tolist())
                if not needs_another_pass[n]
            }
        if not needs_another_pass.any():
            break
        active_frames = active_frames[needs_another_pass]
        stated_inputs = stack_frames([frames[k] for k in active_frames.tolist()])
    return [matches[k] for k in range(len(frames))]


def _select_triples(
    inputs: MatchInput,
    triples: Iterable[tuple[tuple[int, int, int], Candidates, np.ndarray]],
    tuning: MatchTuning,
) -> tuple[list[Selection], list[np.ndarray]]:
    """Compute the posteriors of the candidate triples, separately for each triplet of views.

    Returns (selection of each triplet, segments of its triples outside the depth range).
    """
    selections, out_of_range = [], []
    for views, candidates, index in triples:
        counts = [inputs.counts[view] if view in views else 0 for view in range(len(inputs.counts))]
        mean_count = segments_per_view(inputs.lines, counts) * len(counts) / 3
        selections.append(select(candidates, mean_count, tuning=tuning))
        out_of_range.append(index)
    return selections, out_of_range
