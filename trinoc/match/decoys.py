"""Test whether segments and rig belong together, by comparison with decoys.

If the rig did not take the images, segments match by chance in two views, and sometimes in three.
The number of such matches depends on the scene. Decoys are the same segments with one view mirrored
or upside down. The number of tracks of the decoys is the number by chance in this scene. If the rig
has hardly more tracks, no track is sure.

Most sets need no decoy. A large share of their segments is on sure tracks of three views, or many
of their tracks are nearly certain. Other sets are compared with up to three decoys.

A set is also SUSPECT if its errors are large and a shift of one view explains these errors. The
same holds if a set has few lines, and far more lines after a mistake is corrected. Mistakes are
tested on the longest segments, with about 30 matchings, or 10 for a shift alone. `verify="quick"`
skips these tests.

Reference: Elias and Gygi, "Target-decoy search strategy", Nature Methods 4, 2007.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Int

from trinoc.match import sentences
from trinoc.match.explanations import (
    MIRRORED,
    UPSIDE_DOWN,
    change_view,
    find_shifts,
    seems_shifted,
    take_longest,
    undo_mistakes,
)
from trinoc.match.observations.match_input import BEYOND_FOLD, FrameInput
from trinoc.match.observations.unusable import DUPLICATE, POSITION_UNKNOWN
from trinoc.match.tracks.answers import CERTAIN, SURE
from trinoc.match.tracks.matches import EVEN_POSTERIOR, SUSPECT_SETS, Matches
from trinoc.match.tracks.reliability import depth_range_remedy
from trinoc.match.tuning.tracks import DecoyTuning

# How thoroughly `check_set` tests a set.
Verification = Literal["full", "quick", "off"]

# Function that matches a frame. With `three_views_only=True` it skips pairs, which takes less time.
MatchFrame = Callable[..., Matches]


class SureTracks(NamedTuple):
    """Numbers of sure tracks in three views, for the rig or for one decoy.

    A decoy is the same set of segments with one view mirrored or upside down. The sure tracks of a
    decoy show how many tracks are sure by chance. The posteriors are those before the reduction for
    repeated patterns.

    Attributes
    ----------
    three_view : int
        Number of sure tracks in three views: posterior above `DecoyTuning.sure_posterior`.
    near_certain : int
        Number of tracks with a posterior above `DecoyTuning.certain_posterior`.
    """

    three_view: int
    near_certain: int


def check_set(
    frame: FrameInput,
    names: tuple[str, ...],
    matches: Matches,
    match: MatchFrame,
    tuning: DecoyTuning,
    verify: Verification = "full",
) -> Matches:
    """Return the matches, with the status SUSPECT if segments and rig do not belong together.

    A sure line is a track with a posterior above 0.9. A decoy is the same set of segments with one
    view mirrored or upside down. The status is SUSPECT in three cases. Decoys have about as many
    sure lines as the rig. The correction of a mistake, such as a shifted image, gives far more sure
    lines or much smaller errors. Few segments are on sure lines, and the errors are large.

    Parameters
    ----------
    frame : FrameInput
        Segments and cameras of the frame.
    names : tuple of str
        Names of the views in the caller's sequence.
    matches : Matches
        Result for the frame. Results of two views, or of more than three, are not tested.
    match : callable
        Matches a frame without the reduction for repeated patterns. A repeated pattern lowers all
        posteriors, but is no evidence against the set.
    tuning : DecoyTuning
        Tuned constants.
    verify : "full", "quick" or "off"
        "full" also searches for the mistake in a SUSPECT or very doubtful set. "quick" does not.
        "off" tests nothing.

    Returns
    -------
    Matches
        If SUSPECT, no posterior is above 0.5, and the first note names the most likely cause.
    """
    is_usable = [
        ~np.isin(matches.reasons[name], (BEYOND_FOLD, POSITION_UNKNOWN, DUPLICATE))
        for name in names
    ]
    fewest = min(int(of_view.sum()) for of_view in is_usable)
    if verify == "off" or len(names) != 3 or fewest < tuning.min_segments:
        return matches
    sure = count_sure(matches)
    share, noise = sure.three_view / fewest, matches.noise_scale
    is_clear = share >= tuning.clear_share
    # So many nearly certain lines are no chance, even if they are a small share of the segments.
    is_certain = sure.near_certain >= tuning.clear_certain
    decoy_counts: list[SureTracks] = []
    if not (is_clear or is_certain):
        decoy_counts = count_by_chance(frame, sure, share, match, tuning)
    is_chance = bool(decoy_counts) and not is_above_chance(sure, decoy_counts, share, tuning)
    cause = depth_range_remedy(matches) if is_chance else None
    if cause is None and verify == "full":
        tries_all_mistakes = is_chance or (share < tuning.few_share and not is_certain)
        # The residuals of the tracks show a shift only if most segments are sure.
        is_shifted = noise > (tuning.noisy_above if is_clear else tuning.shifted_above) and (
            not is_clear or seems_shifted(frame, _tracks_in_three(matches, frame), tuning)
        )
        if tries_all_mistakes or is_shifted:
            cause = find_cause(frame, match, tuning, all_kinds=tries_all_mistakes)
    if is_chance or cause:
        note = _note_of_set(sure, decoy_counts if is_chance else [], cause)
        return _as_suspect(matches, sure, decoy_counts if is_chance else [], note)
    if noise > tuning.moved_above and share < tuning.noisy_share:
        note = sentences.rig_has_changed(sure.three_view, fewest, noise)
        return _as_suspect(matches, sure, [], note)
    return matches


def _tracks_in_three(matches: Matches, frame: FrameInput) -> Int[np.ndarray, "t 3"]:
    """Return the segments (t, 3) of the tracks in three views, numbered as in `frame`."""
    columns = []
    for name, order in zip(frame.names, frame.order, strict=True):
        row_of_segment = np.full(len(matches.reasons[name]), -1)
        row_of_segment[order] = np.arange(len(order))
        segments = matches.index[:, matches.views.index(name)]
        columns.append(np.where(segments >= 0, row_of_segment[segments], -1))
    index = np.stack(columns, axis=1)
    return index[(index >= 0).all(axis=1)]


def count_by_chance(
    frame: FrameInput, sure: SureTracks, share: float, match: MatchFrame, tuning: DecoyTuning
) -> list[SureTracks]:
    """Match decoys (one view mirrored or upside down), and return each decoy's sure tracks.

    No further decoy is matched once the rig clearly has more sure tracks than chance gives. `sure`
    are the sure tracks of the rig, `share` their number over the number of segments.
    """
    decoy_counts = []
    for decoy in decoys(frame):
        decoy_counts.append(count_sure(match(decoy, three_views_only=True)))
        if sure.three_view > 2 * least_above_chance([decoy_counts[-1].three_view], share, tuning):
            break
    return decoy_counts


def _note_of_set(sure: SureTracks, decoy_counts: Sequence[SureTracks], cause: str | None) -> str:
    by_chance = float(np.mean(decoy_counts, axis=0)[0]) if decoy_counts else None
    return sentences.set_does_not_belong(
        sure.three_view, by_chance, cause or sentences.CHECK_THE_SET
    )


def count_sure(matches: Matches) -> SureTracks:
    """Return the numbers of sure and of nearly certain tracks in three views, see `SureTracks`."""
    return SureTracks(matches.counts[SURE], matches.counts[CERTAIN])


def is_above_chance(
    sure: SureTracks, decoy_counts: Sequence[SureTracks], share: float, tuning: DecoyTuning
) -> bool:
    """True if the rig has significantly more sure or nearly certain tracks than its decoys.

    Decoys (one view mirrored or upside down) have hardly any nearly certain tracks, so a few such
    tracks of the rig are enough.
    """
    certain_limit = _limit_by_chance(
        [counts.near_certain for counts in decoy_counts], tuning.certain_rule
    )
    limit = least_above_chance([counts.three_view for counts in decoy_counts], share, tuning)
    return sure.three_view >= limit or sure.near_certain >= certain_limit


def least_above_chance(counts: Sequence[int], share: float, tuning: DecoyTuning) -> float:
    """Return the smallest number of sure tracks of the rig that is significant against its decoys.

    `counts` are the numbers of sure tracks of the decoys, in which one view is mirrored or upside
    down. `share` is the number of sure tracks of the rig over its number of segments. A stricter
    rule applies to a small share.
    """
    return _limit_by_chance(
        counts, tuning.strict_rule if share < tuning.few_share else tuning.usual_rule
    )


def _limit_by_chance(counts: Sequence[int], rule: tuple[float, float, float]) -> float:
    """Return factor * mean + sigmas * sqrt(mean) + constant, for the mean of `counts`.

    `rule` is (factor, sigmas, constant). The square root is the standard deviation of a Poisson
    count.
    """
    factor, sigmas, constant = rule
    mean = float(np.mean(counts))
    return factor * mean + sigmas * float(np.sqrt(mean)) + constant


def decoys(frame: FrameInput) -> Iterator[FrameInput]:
    """Yield three decoys, each with the segments of one view mirrored or upside down."""
    for view, change in enumerate((MIRRORED, UPSIDE_DOWN, MIRRORED)):
        yield change_view(frame, view, change)


def find_cause(
    frame: FrameInput,
    match: MatchFrame,
    tuning: DecoyTuning,
    *,
    all_kinds: bool,
) -> str | None:
    """Return the sentence on the mistake that best explains a bad result, or None if none does.

    Shifted images are always tested. With `all_kinds`, exchanged, turned and resized images are
    tested too. A mistake explains the result if its correction gives far more sure lines
    (posterior above 0.9). As many sure lines with much smaller errors are also enough.
    """
    sample = take_longest(frame, tuning.sample_size)

    shifts = list(find_shifts(sample, match, tuning))
    if not (shifts or all_kinds):
        return None

    def count_lines(candidate: FrameInput) -> tuple[int, float]:
        matches = match(candidate, three_views_only=True)
        return count_sure(matches).three_view, matches.noise_scale

    sample_count, noise = count_lines(sample)
    # One decoy may be the correction of the mistake, so the decoy with most lines is ignored.
    decoy_counts = sorted(count_lines(decoy)[0] for decoy in decoys(sample))[:-1]
    # The limit is stricter for a set with hardly any sure line.
    limit = max(sample_count, least_above_chance(decoy_counts, 0.0 if all_kinds else 1.0, tuning))
    factor, constant = tuning.correction_rule
    for mistakes in (*(undo_mistakes(sample) if all_kinds else ()), shifts):
        trials = [(*count_lines(mistake.corrected), mistake.description) for mistake in mistakes]
        # Several shifts may explain about as many lines. The true one leaves the smallest errors.
        corrected_count, scale, description = max(
            trials, key=lambda trial: trial[0] / trial[1], default=(0, noise, "")
        )
        is_quieter = noise > tuning.noisy_above and scale < tuning.quieter_share * noise
        is_larger = corrected_count > factor * sample_count + constant
        if corrected_count > limit and (is_quieter or is_larger):
            return sentences.most_likely_mistake(description, corrected_count, sample_count)
    return None


def _as_suspect(
    matches: Matches, sure: SureTracks, decoy_counts: Sequence[SureTracks], note: str
) -> Matches:
    """Return the matches with the status SUSPECT and with reduced posteriors.

    All posteriors are multiplied by one factor: the share of the sure tracks that exceeds the mean
    number of the decoys, at most 0.5.
    """
    mean_by_chance = (
        np.mean([counts.three_view for counts in decoy_counts]) if decoy_counts else 0.0
    )
    # A share of 0 would give log odds of -inf, which cannot be compared.
    factor = float(np.clip(1 - mean_by_chance / max(sure.three_view, 1), 1e-3, EVEN_POSTERIOR))
    members = matches.member_posterior
    return replace(
        matches,
        member_posterior=None if members is None else members * factor,
        posterior=matches.posterior * factor,
        rival_posterior=matches.rival_posterior * factor,
        notes=(note, *matches.notes),
        counts=matches.counts | {SUSPECT_SETS: 1},
    )
