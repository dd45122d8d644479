"""Do these segments and this rig belong together? Competition with decoys.

Segments of pictures that a rig did not take meet by chance in two views, and now and then in three;
how often depends on the scene. The same segments with one view mirrored or upside down are decoys:
what is found among them is what chance gives in this scene. Where the rig finds hardly more, none
of it may be sure. Most sets show so many lines in three views that no decoy is needed.

Source: Elias and Gygi, "Target-decoy search strategy", Nature Methods 4, 2007.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.match.observations.match_input import FrameInput, order_ends
from trinoc.match.observations.unusable import EQUAL, UNPLACED
from trinoc.match.tracks.matches import SUSPECT_SETS, TRINOCULAR, Matches
from trinoc.match.tuning.tracks import DecoyTuning

# numerical: what a picture is turned by about its middle: along u, along v, by half a turn.
MIRRORED, UPSIDE_DOWN, TURNED = (np.diag(signs) for signs in ((-1.0, 1), (1, -1.0), (-1.0, -1.0)))

_MatchFrame = Callable[[FrameInput, tuple[str, ...]], Matches]


class SureTracks(NamedTuple):
    """Number of sure tracks through three views or more, and through two."""

    in_three: int
    in_two: int


def check_set(
    frame: FrameInput,
    names: tuple[str, ...],
    found: Matches,
    match: _MatchFrame,
    tuning: DecoyTuning,
) -> Matches:
    """The matches, SUSPECT where chance gives about as many lines as the rig does.

    `frame` is what was matched, `names` are the caller's views, `match` matches a frame. Of a
    suspect set the probabilities are times the share of tracks that chance does not give, and a
    note says the likeliest cause. Three views are asked; more, and two, are not.
    """
    fewest = min(int((~np.isin(found.reasons[name], (UNPLACED, EQUAL))).sum()) for name in names)
    if len(names) != 3 or fewest < tuning.fewest_segments:
        return found
    sure = count_sure(found, tuning)
    share = sure.in_three / fewest
    if share < tuning.clear_share:
        chance = []
        for decoy in decoys(frame):
            chance.append(count_sure(match(decoy, names), tuning))
            if sure.in_three > 2 * least_above_chance([chance[-1]], share, tuning):
                break
        if sure.in_three < least_above_chance(chance, share, tuning):
            return _suspect(frame, names, found, match, chance, tuning)
    if found.noise_scale > tuning.noisy_above and share < tuning.noisy_share:
        note = (
            f"Only {sure.in_three} of {fewest} segments are sure in three views, and their errors "
            f"are {found.noise_scale:.2g} times those stated: a camera was moved, or a picture is "
            "cut or shifted; check the rig (check_rig) before you use these matches."
        )
        return _with_note(found, note)
    return found


def count_sure(found: Matches, tuning: DecoyTuning) -> SureTracks:
    """Sure tracks by the number of their views."""
    sure, in_three = found.posterior > tuning.sure, found.stage == TRINOCULAR
    return SureTracks(int((sure & in_three).sum()), int((sure & ~in_three).sum()))


def least_above_chance(chance: Sequence[SureTracks], share: float, tuning: DecoyTuning) -> float:
    """How many sure tracks through three views are more than decoys give: a multiple of their mean,
    and so many standard deviations of a count of it."""
    mean = float(np.mean([each.in_three for each in chance]))
    times, deviations, more = tuning.few if share < tuning.few_share else tuning.some
    return times * mean + deviations * np.sqrt(mean) + more


def decoys(frame: FrameInput) -> Iterator[FrameInput]:
    """Three wrong geometries of the same segments, each with one view mirrored or upside down."""
    for view, change in enumerate((MIRRORED, UPSIDE_DOWN, MIRRORED)):
        yield turn_view(frame, view, change)


def turn_view(frame: FrameInput, view: int, change: Float[np.ndarray, "2 2"]) -> FrameInput:
    """The frame with the segments of a view turned about the middle of the picture."""
    middle = (np.asarray(frame.cameras.size_px[view]) - 1) / 2
    ends = (frame.ends_px[view] - middle) @ change.T + middle
    both = np.kron(np.eye(2), change)
    # Tables hold ends from left to right, and segments in the order of their places.
    ends, covariance, swap = order_ends(ends, both @ frame.covariance_px2[view] @ both.T)
    # The darker side changes with the ends, and with the handedness of the picture.
    exchanged = swap ^ (np.linalg.det(change) < 0)
    polarity = np.where(exchanged, -1, 1) * frame.polarity[view]
    sides = np.where(
        exchanged[:, None], frame.sides[view][:, [1, 0, 3, 2, 4, 5, 6]], frame.sides[view]
    )
    rank = np.lexsort(ends.reshape(-1, 4).T[::-1])
    columns = {
        "order": frame.order[view],
        "ends_px": ends,
        "covariance_px2": covariance,
        "polarity": polarity,
        "sides": sides,
    }
    return frame._replace(
        **{
            name: [column[rank] if k == view else own for k, own in enumerate(getattr(frame, name))]
            for name, column in columns.items()
        }
    )


def _suspect(
    frame: FrameInput,
    names: tuple[str, ...],
    found: Matches,
    match: _MatchFrame,
    chance: Sequence[SureTracks],
    tuning: DecoyTuning,
) -> Matches:
    sure, mean = count_sure(found, tuning), np.mean(chance, axis=0)
    in_three = found.stage == TRINOCULAR
    shares = [
        max(0.0, 1 - by_chance / max(own, 1)) for own, by_chance in zip(sure, mean, strict=True)
    ]
    # A share of none would leave log odds that nothing can compare.
    factor = np.where(in_three, *(max(share, 1e-3) for share in shares))
    least = max(least_above_chance(chance, 0.0, tuning), 2.0 * sure.in_three)
    cause = next(
        (
            f"Most likely {words}: with that undone, {count} lines are sure."
            for words, other in _explanations(frame)
            if (count := count_sure(match(other, names), tuning).in_three) > least
        ),
        "Check that this rig took these pictures of one scene at one time, in the size that it "
        "states, and that each stands under its own camera's name.",
    )
    note = (
        f"These segments and this rig do not seem to belong together: {sure.in_three} lines are "
        f"sure in three views, and {mean[0]:.0f} where a picture is mirrored on purpose. {cause}"
    )
    tempered = replace(
        found,
        posterior=found.posterior * factor,
        rival_posterior=found.rival_posterior * factor,
    )
    return _with_note(tempered, note)


def _with_note(found: Matches, note: str) -> Matches:
    counts = found.counts | {SUSPECT_SETS: 1}
    return replace(found, notes=(note, *found.notes), counts=counts)


def _explanations(frame: FrameInput) -> Iterator[tuple[str, FrameInput]]:
    """(what may be wrong, the frame without it), the commonest first."""
    for order in permutations(range(3)):
        moved = [k for k in range(3) if order[k] != k]
        if moved:
            which = " and ".join(f'"{frame.names[k]}"' for k in moved)
            cameras = frame.cameras.take(list(order))
            yield f"the pictures of {which} are exchanged", frame._replace(cameras=cameras)
    for view, name in enumerate(frame.names):
        for change, word in ((TURNED, "upside down"), (MIRRORED, "mirrored")):
            yield f'the picture of "{name}" is {word}', turn_view(frame, view, change)
