"""Build `Matches` in the caller's numbering: reasons of unmatched segments, counts and notes."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.geometry.intrinsics import distort_pixels
from trinoc.match import sentences
from trinoc.match.evidence.mixture import probability
from trinoc.match.observations.match_input import BEYOND_FOLD, FrameInput, MatchInput
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tracks.unequal_errors import (
    degrees_of_misfit,
    fit_tails,
    scale_covariance_of_lines,
    variance_factor,
)
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.selection import NoiseTuning
from trinoc.match.tuning.tracks import TrackTuning


def cameras_are_collinear(centre_mm: Float[np.ndarray, "f v 3"]) -> Bool[np.ndarray, "f"]:
    """Return the mask of the frames whose camera centres lie on one line, (f,)."""
    centred = centre_mm - centre_mm.mean(axis=1, keepdims=True)
    spread = np.linalg.svd(centred, compute_uv=False)
    return spread[:, 1] < DEFAULT.tracks.collinear_share * spread[:, 0]


def narrow_notes(frame: FrameInput) -> tuple[str, ...]:
    """Return the warning that two cameras are too close together for depth, or no warning.

    The distance is compared with the depth of the scene.
    """
    tuning, names = DEFAULT.tracks, frame.names
    centres = frame.cameras.centre_mm
    distance_mm = np.linalg.norm(centres[:, None] - centres, axis=2)
    # With three cameras or more, the baseline is compared with the longest one.
    limit_mm = np.inf if len(names) == 2 else tuning.narrow_baselines * distance_mm.max()
    narrow_pairs = [
        (first, second, share)
        for first, second in combinations(range(len(names)), 2)
        if distance_mm[first, second] < limit_mm
        and (share := _share_at_infinity(frame, first, second)) > tuning.narrow_share
    ]
    if not narrow_pairs:
        return ()
    first, second, share = narrow_pairs[0]
    return (
        sentences.cameras_nearly_coincide(
            (names[first], names[second]),
            distance_mm[first, second],
            share,
            len(narrow_pairs) - 1,
        ),
    )


def _fold_notes(frame: FrameInput) -> tuple[str, ...]:
    """Return the warning on excluded segments where a lens is not invertible, or no warning."""
    counts = {
        name: int((reasons == BEYOND_FOLD).sum())
        for name, reasons in zip(frame.names, frame.exclusion_reasons, strict=True)
    }
    counts = {name: counts[name] for name in sorted(counts) if counts[name]}
    if not counts:
        return ()
    radius_px = {
        name: lens.valid_radius_px
        for name, lens in zip(frame.names, frame.cameras.intrinsics, strict=True)
    }
    return (sentences.segments_beyond_fold(counts, radius_px),)


def _share_at_infinity(frame: FrameInput, first: int, second: int) -> float:
    """Return the share of long segments of view `first` that match view `second` at infinite depth.

    Infinite depth means that the segment coincides with one of the second view after rotation
    alone.
    """
    tuning = DEFAULT.tracks
    ends, other_ends = frame.ends_px[first], frame.ends_px[second]
    if min(len(ends), len(other_ends)) < tuning.narrow_segments[0]:
        return 0.0
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    ends = ends[np.argsort(-length, kind="stable")[: tuning.narrow_segments[1]]]
    matrices = frame.cameras.matrix_px[:, :, :3]
    at_infinity = matrices[second] @ np.linalg.inv(matrices[first])
    at_infinity_px = np.concatenate([ends, np.ones((len(ends), 2, 1))], axis=2) @ at_infinity.T
    with np.errstate(divide="ignore", invalid="ignore"):
        at_infinity_px = np.where(
            at_infinity_px[..., 2:] > 0, at_infinity_px[..., :2] / at_infinity_px[..., 2:], np.inf
        )
    step = other_ends[:, 1] - other_ends[:, 0]
    other_length = np.linalg.norm(step, axis=1)
    direction = step / other_length[:, None]
    with np.errstate(invalid="ignore"):
        offset = at_infinity_px[:, :, None] - other_ends[:, 0]
        across_px = np.abs(offset[..., 0] * direction[:, 1] - offset[..., 1] * direction[:, 0])
        along_px = np.sum(offset.mean(axis=1) * direction, axis=2)
    variances = [
        np.median(np.linalg.eigvalsh(frame.covariance_px2[view][:, :2, :2])[:, 0])
        for view in (first, second)
    ]
    limit_px = tuning.narrow_sigmas * np.sqrt(sum(variances))
    is_on = (across_px.max(axis=1) < limit_px) & (along_px > 0) & (along_px < other_length)
    return float(is_on.any(axis=1).mean())


def write_notes(
    views: int,
    are_cameras_collinear: bool,
    unlocated: int,
    noise_scale: float,
    discarded: int,
    tuning: NoiseTuning = DEFAULT.noise,
) -> tuple[str, ...]:
    """Return the warnings on discarded triples, on unexpected noise, and on collinear cameras.

    `unlocated` is the number of excluded tracks along epipolar lines. `discarded` is the number of
    triples that exceeded the memory limit.
    """
    notes = []
    if discarded:
        notes.append(sentences.triples_discarded(discarded))
    if not 1 / tuning.warning_factor <= noise_scale <= tuning.warning_factor:
        notes.append(sentences.noise_differs(noise_scale))
    if views > 2:
        if are_cameras_collinear:
            notes.append(sentences.cameras_collinear(unlocated))
    elif unlocated:
        notes.append(sentences.two_views_leave_unlocated(unlocated))
    return tuple(notes)


MATCHED = "matched"
IN_PATTERN = f"{MATCHED} within a pattern"
NO_PARTNER = "no partner in the zone"
OUTSIDE = "outside depth"
ALONG = "along the epipolar lines"
WEAK = "evidence too weak"
MISSING_IN_THIRD = "missing in a third view"
LOST_TO_NEIGHBOUR = "lost to a neighbour"
AMBIGUOUS = "ambiguous with {}"


def unmatched_reasons(
    segment: Int[np.ndarray, "m"],
    log_odds: Float[np.ndarray, "m"],
    is_out_of_range: Bool[np.ndarray, "n"],
    is_along_epipolar: Bool[np.ndarray, "n"],
    is_matched: Bool[np.ndarray, "n"],
    is_missing_in_third: Bool[np.ndarray, "n"],
    is_in_pattern: Bool[np.ndarray, "n"],
    tuning: TrackTuning = DEFAULT.tracks,
) -> Shaped[np.ndarray, "n"]:
    """Return the reason why each segment of one view has no match, (n,) strings.

    A matched segment has the reason "matched" or "matched within a pattern".

    Parameters
    ----------
    segment : (m,)
        Segment of this view in each candidate, -1 if the candidate has none.
    log_odds : (m,)
        Log odds of each candidate before the exclusion of rivals.
    is_out_of_range : (n,)
        True for segments with a candidate outside the depth range.
    is_along_epipolar : (n,)
        True for segments whose best candidate lies along the epipolar lines of all its pairs of
        views.
    is_matched : (n,)
        True for segments on a track.
    is_missing_in_third : (n,)
        True for segments that match in two views, while a third view should show the line and does
        not. Examples are rims of round bodies, and moving shadows and highlights.
    is_in_pattern : (n,)
        True for matched segments whose match is doubtful because of a repeated pattern.
    tuning : TrackTuning
        Tuned constants.
    """
    segment_count = len(is_matched)
    has_segment = segment >= 0
    segment, log_odds = segment[has_segment], log_odds[has_segment]
    best_log_odds = np.full(segment_count, -np.inf)
    np.maximum.at(best_log_odds, segment, log_odds)
    is_serious = (log_odds > best_log_odds[segment] - tuning.rival_log_odds) & (log_odds > 0)
    rivals = np.bincount(segment[is_serious], minlength=segment_count)
    reasons = np.full(segment_count, NO_PARTNER, dtype="U40")
    reasons[is_out_of_range] = OUTSIDE
    reasons[np.isfinite(best_log_odds)] = WEAK
    reasons[is_missing_in_third & np.isfinite(best_log_odds)] = MISSING_IN_THIRD
    reasons[best_log_odds > 0] = LOST_TO_NEIGHBOUR
    for n in np.flatnonzero((best_log_odds > 0) & (rivals > 1)):
        reasons[n] = AMBIGUOUS.format(rivals[n])
    reasons[is_along_epipolar] = ALONG
    reasons[is_matched] = MATCHED
    reasons[is_in_pattern] = IN_PATTERN
    return reasons


def count_reasons(reasons: dict[str, Shaped[np.ndarray, "_"]]) -> dict[str, int]:
    """Return the number of segments with each reason, over all views.

    All reasons "ambiguous with ..." are counted together.
    """
    totals: Counter[str] = Counter()
    # Few reasons are different, so each distinct string is split once.
    for word, count in Counter(word for view in reasons.values() for word in view.tolist()).items():
        totals[word.split(" with ")[0]] += count
    return {f"segments {kind}": totals[kind] for kind in sorted(totals)}


# Name of the count of tracks that no pair of views can locate.
UNLOCATED_TRACKS = "tracks along the epipolar lines"
# Name of the count of likely triples beyond the memory limit.
DISCARDED_TRIPLES = "triples let go for memory"
# Names of the counts of sure and nearly certain tracks in three views, without the reduction for
# repeated patterns.
SURE, CERTAIN = "tracks sure against chance", "tracks certain against chance"


class TrackLines(NamedTuple):
    """Tracks of all frames with their lines, in the matcher's sequence of views and segments.

    Attributes not listed here are as in `Matches`.

    Attributes
    ----------
    ends_mm : (t, 2, 3)
        Ends of the line, world frame.
    posterior_log_odds, rival_posterior : (t,)
        Posterior log odds of the track and of its best rival.
    is_in_pattern : (t,)
        True if a repeated pattern reduces the posterior much.
    chance_log_odds : (t,)
        `posterior_log_odds` without the reduction for repeated patterns.
    member_posterior : (t, v)
        As in `Tracks`.
    """

    index: Int[np.ndarray, "t v"]
    fragments_px: Float[np.ndarray, "t v 2 2"]
    ends_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    posterior_log_odds: Float[np.ndarray, "t"]
    rival_posterior: Float[np.ndarray, "t"]
    fragments_covariance_px2: Float[np.ndarray, "t v 4 4"]
    misfit: Float[np.ndarray, "t"]
    viewpoint_dependent: Bool[np.ndarray, "t"]
    is_in_pattern: Bool[np.ndarray, "t"]
    chance_log_odds: Float[np.ndarray, "t"]
    member_posterior: Float[np.ndarray, "t v"]

    def index_likelier_than(self, posterior: float) -> Int[np.ndarray, "_ v"]:
        """Return the segments (k, v) of the tracks in three or more views that are likely enough.

        The probability of such a track, that of `chance_log_odds`, exceeds `posterior`.
        """
        in_three = (self.index >= 0).sum(axis=1) > 2
        return self.index[in_three & (probability(self.chance_log_odds) > posterior)]


def build_matches(
    inputs: MatchInput,
    lines: TrackLines,
    frame: Int[np.ndarray, "t"],
    reasons: list[Shaped[np.ndarray, "_"]],
    counts: Mapping[str, Int[np.ndarray, "_f"]],
    names: Sequence[tuple[str, ...]],
    noise_scale: Float[np.ndarray, "f"],
    tuning: NoiseTuning,
) -> list[Matches]:
    """Build the matches of each frame, with the views in the caller's sequence.

    Parameters
    ----------
    inputs : MatchInput
        Input of the matcher.
    lines : TrackLines
        Tracks of all frames.
    frame : (t,)
        Frame of each track.
    reasons : list of arrays
        For each view, the reason of each segment.
    counts : mapping
        For each count of the result, its value in each frame.
    names : sequence of tuple of str
        View names of each frame, in the caller's sequence.
    noise_scale : (f,)
        Noise scale of each frame.
    tuning : NoiseTuning
        Tuned constants.
    """
    lines, tail = _with_unequal_errors(lines, frame, inputs.frames, tuning)
    index, fragments = _in_caller_order(inputs, lines, frame)
    pairs = zip(inputs.frames, names, strict=True)
    view_order = np.array(
        [
            [frame_input.names.index(name) for name in view_names]
            for frame_input, view_names in pairs
        ]
    )
    rows = np.arange(len(frame))[:, None], view_order[frame]
    index, fragments, covariance, members = (
        column[rows]
        for column in (index, fragments, lines.fragments_covariance_px2, lines.member_posterior)
    )
    posterior = probability(lines.posterior_log_odds)
    members = np.where(np.isnan(members) & (index >= 0), posterior[:, None], members)
    positions = fragments[:, :, 0].reshape(len(frame), 2 * view_order.shape[1])
    keys = *index.T[::-1], frame
    order = np.lexsort(keys)
    # Tracks with the same segments are ordered by the positions of their fragments.
    if np.all([np.diff(key[order]) == 0 for key in keys], axis=0).any():
        order = np.lexsort((*positions.T, *keys))
    columns = {
        "index": index,
        "fragments_px": fragments,
        "lines_mm": lines.ends_mm,
        "covariance_mm2": lines.covariance_mm2,
        "stage": np.where((index >= 0).sum(axis=1) > 2, TRINOCULAR, BINOCULAR),
        "posterior": posterior,
        "member_posterior": members,
        "rival_posterior": probability(lines.rival_posterior),
        "fragments_covariance_px2": covariance,
        "misfit": lines.misfit,
        "viewpoint_dependent": lines.viewpoint_dependent,
    }
    bounds = np.searchsorted(frame[order], np.arange(len(names) + 1))
    reasons_of_frames = _reasons_in_caller_order(inputs, reasons)
    is_collinear = cameras_are_collinear(
        np.stack([frame_input.cameras.centre_mm for frame_input in inputs.frames])
    )
    results = []
    for f, view_names in enumerate(names):
        rows_of_frame = order[slice(*bounds[f : f + 2])]
        frame_columns: dict[str, Any] = {
            name: column[rows_of_frame] for name, column in columns.items()
        }
        frame_reasons = {
            name: reasons_of_frames[f][view]
            for name, view in zip(view_names, view_order[f].tolist(), strict=True)
        }
        scale = float(noise_scale[f])
        counts_of_frame = {name: int(frame_counts[f]) for name, frame_counts in counts.items()}
        results.append(
            Matches(
                **frame_columns,
                views=view_names,
                reasons=frame_reasons,
                counts=counts_of_frame | count_reasons(frame_reasons),
                noise_scale=scale,
                notes=(
                    *write_notes(
                        len(view_names),
                        bool(is_collinear[f]),
                        counts_of_frame[UNLOCATED_TRACKS],
                        scale,
                        counts_of_frame[DISCARDED_TRIPLES],
                        tuning,
                    ),
                    *narrow_notes(inputs.frames[f]),
                    *_fold_notes(inputs.frames[f]),
                ),
                noise_tail=float(tail[f]),
            )
        )
    return results


def _with_unequal_errors(
    lines: TrackLines,
    frame: Int[np.ndarray, "t"],
    frames: Sequence[FrameInput],
    tuning: NoiseTuning,
) -> tuple[TrackLines, Float[np.ndarray, "f"]]:
    """Multiply the covariance of each line by a factor, because errors differ between tracks.

    Returns (lines, `noise_tail` of each frame). `noise_tail` is 1 / degrees of freedom of the
    Student distribution of the errors. See `unequal_errors.py`.
    """
    degrees = degrees_of_misfit(lines.index)
    is_sure = (degrees > 0) & (probability(lines.posterior_log_odds) > tuning.sure_posterior)
    has_images = np.array(
        [any(np.isfinite(view).any() for view in frame_input.sides) for frame_input in frames]
    )
    tail = fit_tails(lines.misfit[is_sure], degrees[is_sure], frame[is_sure], has_images, tuning)
    factor = variance_factor(lines.misfit, degrees, tail[frame])
    covariance = scale_covariance_of_lines(lines.ends_mm, lines.covariance_mm2, factor)
    return lines._replace(covariance_mm2=covariance), tail


def _in_caller_order(
    inputs: MatchInput, lines: TrackLines, frame: Int[np.ndarray, "t"]
) -> tuple[Int[np.ndarray, "t v"], Float[np.ndarray, "t v 2 2"]]:
    """Return the segment indices of the caller's input, and the fragments in image pixels."""
    index, fragments = np.full(lines.index.shape, -1), lines.fragments_px.copy()
    for view in range(lines.index.shape[1]):
        has_line = np.flatnonzero(lines.index[:, view] >= 0)
        order = np.concatenate([frame_input.order[view] for frame_input in inputs.frames])
        index[has_line, view] = order[lines.index[has_line, view]]
        lenses = [frame_input.cameras.intrinsics[view] for frame_input in inputs.frames]
        # Frames of one rig share their lenses.
        for lens in {id(lens): lens for lens in lenses if lens.has_distortion}.values():
            rows = has_line[
                np.array([frame_lens is lens for frame_lens in lenses])[frame[has_line]]
            ]
            fragments[rows, view] = distort_pixels(lens, fragments[rows, view])
    return index, fragments


def _reasons_in_caller_order(
    inputs: MatchInput, reasons: list[Shaped[np.ndarray, "_"]]
) -> list[list[Shaped[np.ndarray, "_"]]]:
    """Return the reasons of each frame and view, with the segments numbered as in the caller's
    input.

    Excluded segments are included.
    """
    starts, result = inputs.starts, []
    for f, frame in enumerate(inputs.frames):
        result.append([column.astype("U40") for column in frame.exclusion_reasons])
        for view, order in enumerate(frame.order):
            reasons_in_view = reasons[view][slice(*starts[f : f + 2, view])]
            result[-1][view][order] = reasons_in_view
    return result
