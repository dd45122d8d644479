"""Do these segments and this rig belong together? Competition with decoys.

Segments of pictures that a rig did not take meet by chance in two views, and now and then in three;
how often depends on the scene. The same segments with one view mirrored or upside down are decoys:
what is found among them is what chance gives in this scene. Where the rig finds hardly more, none
of it may be sure. Most sets show so many lines in three views that no decoy is needed.

A set is SUSPECT, too, where far more lines or far smaller errors are found once a likely mistake is
undone. What is tried, is tried on the longest segments, which bounds the time.

Source: Elias and Gygi, "Target-decoy search strategy", Nature Methods 4, 2007.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trinoc.match.explanations import (
    MIRRORED,
    UPSIDE_DOWN,
    change_view,
    find_shifts,
    take_longest,
    undo_mistakes,
)
from trinoc.match.observations.match_input import FrameInput
from trinoc.match.observations.unusable import EQUAL, UNPLACED
from trinoc.match.tracks.answers import MATCHED, OUTSIDE
from trinoc.match.tracks.matches import EVEN, SUSPECT_SETS, TRINOCULAR, Matches
from trinoc.match.tuning.tracks import DecoyTuning

UNKNOWN = (
    "Check that this rig took these pictures of one scene at one time, in the size that it states, "
    "and that each stands under its own camera's name."
)


# Matches a frame; with `in_three=True` of lines in three views alone, which takes less time.
MatchFrame = Callable[..., Matches]


class SureTracks(NamedTuple):
    """Number of sure tracks through three views or more, through two, and of those through three
    that are next to certain."""

    in_three: int
    in_two: int
    certain: int


def check_set(
    frame: FrameInput,
    names: tuple[str, ...],
    found: Matches,
    match: MatchFrame,
    tuning: DecoyTuning,
) -> Matches:
    """The matches, SUSPECT where chance gives about as many lines as the rig does, or where some
    mistake undone gives more.

    `frame` is what was matched, `names` are the caller's views, `match` matches a frame as if no
    pattern repeated: of patterns little is sure, and that says nothing about the set. Of a
    suspect set no track is likelier than not, and of tracks that chance gives none; a note says
    the likeliest cause. Three views are asked; more, and two, are not.
    """
    fewest = min(int((~np.isin(found.reasons[name], (UNPLACED, EQUAL))).sum()) for name in names)
    if len(names) != 3 or fewest < tuning.fewest_segments:
        return found
    sure = count_sure(found, tuning)
    if sure.in_three < tuning.clear_share * fewest:
        sure = count_sure(match(frame), tuning)
    share = sure.in_three / fewest
    is_clear = share >= tuning.clear_share
    if is_clear and found.noise_scale <= tuning.noisy_above:
        return found
    chance = [] if is_clear else count_by_chance(frame, sure, share, match, tuning)
    by_chance = bool(chance) and not is_above_chance(sure, chance, share, tuning)
    every = by_chance or bool(share < tuning.few_share)
    cause = say_excluded_depths(found) if every else None
    if cause is None and (every or found.noise_scale > tuning.shifted_above):
        cause = find_cause(frame, match, tuning, every=every)
    if by_chance or cause:
        note = _note_of_set(sure, chance if by_chance else [], cause)
        return _doubt(found, sure, chance if by_chance else [], note)
    if found.noise_scale > tuning.moved_above and share < tuning.noisy_share:
        note = (
            f"Only {sure.in_three} of {fewest} segments are sure in three views, and their errors "
            f"are {found.noise_scale:.2g} times those stated: a camera was moved, or a picture is "
            "cut or shifted; check the rig (check_rig) before you use these matches."
        )
        return _doubt(found, sure, [], note)
    return found


def say_excluded_depths(found: Matches) -> str | None:
    """What to check where the allowed depths leave out more segments than are matched."""
    words = np.concatenate([np.asarray(words, dtype=str) for words in found.reasons.values()])
    excluded = int((words == OUTSIDE).sum())
    if excluded <= np.char.startswith(words, MATCHED).sum():
        return None
    return (
        f"{excluded} segments have no partner in the depths allowed: check depth_range_mm, which "
        "is from each camera, in mm."
    )


def count_by_chance(
    frame: FrameInput, sure: SureTracks, share: float, match: MatchFrame, tuning: DecoyTuning
) -> list[SureTracks]:
    """Sure tracks of the decoys, until one of them leaves no doubt that the rig finds more."""
    chance = []
    for decoy in decoys(frame):
        chance.append(count_sure(match(decoy), tuning))
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


def count_sure(found: Matches, tuning: DecoyTuning) -> SureTracks:
    """Sure tracks by the number of their views."""
    sure, in_three = found.posterior > tuning.sure, found.stage == TRINOCULAR
    certain = in_three & (found.posterior > tuning.certain)
    return SureTracks(*(int(each.sum()) for each in (sure & in_three, sure & ~in_three, certain)))


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
    frame: FrameInput, match: MatchFrame, tuning: DecoyTuning, *, every: bool
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
        return count_sure(matches, tuning).in_three, matches.noise_scale

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


def _doubt(found: Matches, sure: SureTracks, chance: Sequence[SureTracks], note: str) -> Matches:
    """The matches as SUSPECT, with probabilities times the share that chance does not give, half
    at most."""
    mean = np.mean(chance, axis=0)[:2] if chance else (0.0, 0.0)
    shares = [1 - by_chance / max(own, 1) for own, by_chance in zip(sure[:2], mean, strict=True)]
    # A share of none would leave log odds that nothing can compare.
    factor = np.where(found.stage == TRINOCULAR, *np.clip(shares, 1e-3, EVEN))
    return replace(
        found,
        posterior=found.posterior * factor,
        rival_posterior=found.rival_posterior * factor,
        notes=(note, *found.notes),
        counts=found.counts | {SUSPECT_SETS: 1},
    )
