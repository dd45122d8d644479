"""Do these segments and this rig belong together? Competition with decoys.

Segments of pictures that a rig did not take meet by chance in two views, and now and then in three;
how often depends on the scene. The same segments with one view mirrored or upside down are decoys:
the tracks among them are what chance gives in this scene. Where the rig has hardly more, none of
its tracks may be sure. Most sets have so many tracks in three views, or so many that are next to
certain, that no decoy is needed; others are compared with up to three.

A set is SUSPECT, too, where its errors are large and a shift of one view explains them, or where
it has few lines and far more once a mistake is undone. Mistakes are undone on the longest segments:
some 30 matchings, some 10 for a shift alone. `verify="quick"` leaves them out.

Source: Elias and Gygi, "Target-decoy search strategy", Nature Methods 4, 2007.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Int

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
from trinoc.match.observations.unusable import EQUAL, UNPLACED
from trinoc.match.tracks.answers import CERTAIN, SURE
from trinoc.match.tracks.matches import EVEN, SUSPECT_SETS, Matches
from trinoc.match.tracks.reliability import say_excluded_depths
from trinoc.match.tuning.tracks import DecoyTuning

UNKNOWN = (
    "Check that this rig took these pictures of one scene at one time, in the size that it states, "
    "and that each stands under its own camera's name."
)


# How thoroughly a set is checked: see `check_set`.
Verification = Literal["full", "quick", "off"]

# Matches a frame; with `in_three=True` of lines in three views alone, which takes less time.
MatchFrame = Callable[..., Matches]


class SureTracks(NamedTuple):
    """Number of sure tracks through three views, and of those that are next to certain, as if no
    pattern repeated."""

    in_three: int
    certain: int


def check_set(
    frame: FrameInput,
    names: tuple[str, ...],
    matches: Matches,
    match: MatchFrame,
    tuning: DecoyTuning,
    verify: Verification = "full",
) -> Matches:
    """The matches, SUSPECT where chance gives about as many lines as the rig does, or where a view
    is shifted.

    Parameters
    ----------
    frame : what was matched; `names` are the caller's views.
    matches : of the frame. Only those of three views are checked.
    match : matches a frame as if no pattern repeated: of patterns little is sure, and that says
        nothing about the set.
    verify : "full" looks for the mistake in a refused or very doubtful set, "quick" does not, "off"
        checks nothing.

    Returns
    -------
    Matches; of a suspect set no track is likelier than not, and of tracks that chance gives none.
    The first note names the likeliest cause.
    """
    usable = [~np.isin(matches.reasons[name], (BEYOND_FOLD, UNPLACED, EQUAL)) for name in names]
    fewest = min(int(of_view.sum()) for of_view in usable)
    if verify == "off" or len(names) != 3 or fewest < tuning.fewest_segments:
        return matches
    sure = count_sure(matches)
    share, noise = sure.in_three / fewest, matches.noise_scale
    is_clear = share >= tuning.clear_share
    # However few of its segments they are, so many lines are no chance.
    is_certain = sure.certain >= tuning.clear_certain
    chance: list[SureTracks] = []
    if not (is_clear or is_certain):
        chance = count_by_chance(frame, sure, share, match, tuning)
    by_chance = bool(chance) and not is_above_chance(sure, chance, share, tuning)
    cause = say_excluded_depths(matches) if by_chance else None
    if cause is None and verify == "full":
        every = by_chance or (share < tuning.few_share and not is_certain)
        # Where most segments are sure, the tracks show a shift; elsewhere it is to be tried.
        is_shifted = noise > (tuning.noisy_above if is_clear else tuning.shifted_above) and (
            not is_clear or seems_shifted(frame, _tracks_in_three(matches, frame), tuning)
        )
        if every or is_shifted:
            cause = find_cause(frame, match, tuning, every=every)
    if by_chance or cause:
        note = _note_of_set(sure, chance if by_chance else [], cause)
        return _doubt(matches, sure, chance if by_chance else [], note)
    if noise > tuning.moved_above and share < tuning.noisy_share:
        note = (
            f"Only {sure.in_three} of {fewest} segments are sure in three views, and their errors "
            f"are {noise:.2g} times those stated: a camera was moved, or a picture is cut or "
            "shifted; check the rig (check_rig) before you use these matches."
        )
        return _doubt(matches, sure, [], note)
    return matches


def _tracks_in_three(matches: Matches, frame: FrameInput) -> Int[np.ndarray, "t 3"]:
    """Segments of the tracks in three views, by the frame's views and its numbers of segments."""
    columns = []
    for name, order in zip(frame.names, frame.order, strict=True):
        number = np.full(len(matches.reasons[name]), -1)
        number[order] = np.arange(len(order))
        segments = matches.index[:, matches.views.index(name)]
        columns.append(np.where(segments >= 0, number[segments], -1))
    index = np.stack(columns, axis=1)
    return index[(index >= 0).all(axis=1)]


def count_by_chance(
    frame: FrameInput, sure: SureTracks, share: float, match: MatchFrame, tuning: DecoyTuning
) -> list[SureTracks]:
    """Sure tracks of the decoys, until one of them leaves no doubt that the rig has more."""
    chance = []
    for decoy in decoys(frame):
        chance.append(count_sure(match(decoy, in_three=True)))
        if sure.in_three > 2 * least_above_chance([chance[-1].in_three], share, tuning):
            break
    return chance


def _note_of_set(sure: SureTracks, chance: Sequence[SureTracks], cause: str | None) -> str:
    by_chance = ""
    if chance:
        mean = np.mean(chance, axis=0)[0]
        by_chance = f", and {mean:.0f} where a picture is mirrored on purpose"
    return (
        "These segments and this rig do not seem to belong together: sure lines in three views "
        f"number {sure.in_three}{by_chance}. {cause or UNKNOWN}"
    )


def count_sure(matches: Matches) -> SureTracks:
    """Those of the matches."""
    return SureTracks(matches.counts[SURE], matches.counts[CERTAIN])


def is_above_chance(
    sure: SureTracks, chance: Sequence[SureTracks], share: float, tuning: DecoyTuning
) -> bool:
    """Whether the rig gives more sure tracks than decoys, or more that are next to certain, of
    which chance gives hardly any: a few of these tell where views share little."""
    few = _more_than([each.certain for each in chance], tuning.of_certain)
    least = least_above_chance([each.in_three for each in chance], share, tuning)
    return sure.in_three >= least or sure.certain >= few


def least_above_chance(counts: Sequence[int], share: float, tuning: DecoyTuning) -> float:
    """How many sure tracks through three views are more than decoys, which have `counts`, give."""
    return _more_than(counts, tuning.few if share < tuning.few_share else tuning.some)


def _more_than(counts: Sequence[int], rule: tuple[float, float, float]) -> float:
    """A multiple of the mean, so many standard deviations of a count of it, and so many more."""
    times, deviations, more = rule
    mean = float(np.mean(counts))
    return times * mean + deviations * float(np.sqrt(mean)) + more


def decoys(frame: FrameInput) -> Iterator[FrameInput]:
    """Three wrong geometries of the same segments, each with one view mirrored or upside down."""
    for view, change in enumerate((MIRRORED, UPSIDE_DOWN, MIRRORED)):
        yield change_view(frame, view, change)


def find_cause(
    frame: FrameInput,
    match: MatchFrame,
    tuning: DecoyTuning,
    *,
    every: bool,
) -> str | None:
    """The mistake that best explains the segments, in a sentence; None where none does.

    Shifts are tried, and where `every` is true pictures exchanged, turned and of other sizes. Once
    it is undone there are more sure lines by far, or as many whose errors are smaller by far.
    """
    sample = take_longest(frame, tuning.tried_segments)

    shifts = list(find_shifts(sample, match, tuning))
    if not (shifts or every):
        return None

    def count(other: FrameInput) -> tuple[int, float]:
        matches = match(other, in_three=True)
        return count_sure(matches).in_three, matches.noise_scale

    own, noise = count(sample)
    # One of the decoys may be what undoes the mistake, and tells nothing of chance then.
    chance = sorted(count(decoy)[0] for decoy in decoys(sample))[:-1]
    # Of a set that shows next to nothing more is asked for than of one that shows a part.
    least = max(own, least_above_chance(chance, 0.0 if every else 1.0, tuning))
    times, more = tuning.explained
    for kind in (*(undo_mistakes(sample) if every else ()), shifts):
        tried = [(*count(undone), words) for words, undone in kind]
        # Of shifts that explain about as many lines, the true one leaves the smallest errors.
        number, scale, words = max(tried, key=lambda one: one[0] / one[1], default=(0, noise, ""))
        is_quieter = noise > tuning.noisy_above and scale < tuning.quieter * noise
        if number > least and (is_quieter or number > times * own + more):
            return (
                f"Most likely {words}: with that undone, {number} lines of a sample are sure in "
                f"place of {own}."
            )
    return None


def _doubt(matches: Matches, sure: SureTracks, chance: Sequence[SureTracks], note: str) -> Matches:
    """The matches as SUSPECT, with probabilities times the share that chance does not give, half
    at most."""
    by_chance = np.mean([each.in_three for each in chance]) if chance else 0.0
    # A share of none would leave log odds that nothing can compare.
    factor = float(np.clip(1 - by_chance / max(sure.in_three, 1), 1e-3, EVEN))
    members = matches.member_posterior
    return replace(
        matches,
        member_posterior=None if members is None else members * factor,
        posterior=matches.posterior * factor,
        rival_posterior=matches.rival_posterior * factor,
        notes=(note, *matches.notes),
        counts=matches.counts | {SUSPECT_SETS: 1},
    )
