"""Shots of several cameras at once: which show something new, and what the next should show."""

from collections.abc import Mapping, Sequence
from itertools import combinations, permutations
from typing import NamedTuple

from trinoc.capture.advice import ENOUGH, field_share, next_goal, next_step, shows_something_new
from trinoc.capture.goal import Goal
from trinoc.capture.judgement import Judgement

# Of a lens: a plane tells two numbers of it in each picture, and a camera has four and more.
FEWEST_SHOTS = 3


class Shot(NamedTuple):
    """What the cameras saw at one moment.

    Fields
    ------
    name : of the moment.
    judgements : of each camera's picture, by the camera's name.
    kept : the name that its pictures are kept by; "" where they are not.
    """

    name: str
    judgements: Mapping[str, Judgement]
    kept: str = ""

    @property
    def good(self) -> tuple[str, ...]:
        """The cameras whose picture is good to calibrate with."""
        return tuple(name for name, each in self.judgements.items() if each.good)


class Advice(NamedTuple):
    """What to do next: in words, and in which camera's picture the board is wanted how."""

    sentence: str
    goals: Mapping[str, Goal]


def list_own(shots: Sequence[Shot], camera: str, beside: str | None = None) -> list[Judgement]:
    """A camera's judgements, of all shots or of those in which another camera's are good."""
    return [
        shot.judgements[camera]
        for shot in shots
        if camera in shot.judgements and (beside is None or beside in shot.good)
    ]


def is_new_shot(earlier: Sequence[Shot], last: Shot) -> bool:
    """Whether a shot shows something new to a camera, or to one in the company of another.

    The second connects the cameras: they have to see one board at one moment.
    """
    pairs = [(name, None) for name in last.good] + list(permutations(last.good, 2))
    return any(
        shows_something_new(list_own(earlier, name, beside), last.judgements[name])
        for name, beside in pairs
    )


def advise_cameras(shots: Sequence[Shot], cameras: Sequence[str]) -> Advice:
    """What is wrong with the last shot; else what the cameras lack, that which lacks most first."""
    if len(cameras) == 1:
        own = list_own(shots, cameras[0])
        goal = next_goal(own)
        return Advice(next_step(own), {} if goal is None else {cameras[0]: goal})
    goals = {name: next_goal(list_own(shots, name)) for name in cameras}
    wanted = {name: goal for name, goal in goals.items() if goal is not None}
    least = min(wanted, key=lambda name: field_share(list_own(shots, name)), default="")
    drawn = {least: wanted[least]} if least else {}
    if not shots:
        return Advice("Hold the board where all cameras see it, and hold it still.", {})
    if not shots[-1].good:
        return Advice(_what_is_wrong(shots[-1]), drawn)
    groups = connect_cameras(shots, cameras)
    if len(groups) > 1 and all(_list_good(shots, name) for name in cameras):
        first, second = (" or ".join(group) for group in groups[:2])
        return Advice(f"Hold the board where {first} sees it together with {second}.", {})
    return Advice(f"For {least}: {wanted[least].sentence}" if least else ENOUGH, drawn)


def connect_cameras(
    shots: Sequence[Shot], cameras: Sequence[str], by: int = FEWEST_SHOTS
) -> list[tuple[str, ...]]:
    """Groups of cameras that shots connect, each pair by so many of them; one when all are."""
    groups = [{name} for name in cameras]
    for pair in combinations(cameras, 2):
        if sum(set(pair) <= set(shot.good) for shot in shots) >= by:
            joined = [group for group in groups if group & set(pair)]
            groups = [group for group in groups if not group & set(pair)]
            groups.append(set().union(*joined))
    order = {name: k for k, name in enumerate(cameras)}
    found = [tuple(sorted(group, key=order.__getitem__)) for group in groups]
    return sorted(found, key=lambda group: order[group[0]])


def find_missing(shots: Sequence[Shot], cameras: Sequence[str]) -> str | None:
    """Why these shots are too few to calibrate with, in a sentence; None where they may do."""
    for name in cameras:
        count = len(_list_good(shots, name))
        if count < FEWEST_SHOTS:
            who = f' of "{name}"' if name else ""
            return (
                f"There is no calibration, because good pictures{who} that show something new are "
                f"too few ({count}, at least {FEWEST_SHOTS} are needed): show it the board, tilted "
                "another way in each."
            )
    groups = connect_cameras(shots, cameras, by=1)
    if len(groups) > 1:
        first, second = (" or ".join(group) for group in groups[:2])
        return (
            f"There is no calibration, because no shot shows the board to {first} and {second} at "
            "once: hold it where both see it."
        )
    return None


def shot_line(shot: Shot) -> str:
    """One line: kept or not, and what each camera saw."""
    seen = []
    for name, each in shot.judgements.items():
        if each.good:
            seen.append(f"{name} good")
        elif each.found:
            seen.append(f"{name} AGAIN ({'; '.join(each.faults)})")
        else:
            seen.append(f"{name} not found")
    nothing_new = "nothing new" if shot.good else "not good"
    verdict = f"kept as {shot.kept}" if shot.kept else nothing_new
    return f"{' '.join(shot.name.split())}: {verdict}; {', '.join(seen)}"


def summarise_watch(shots: Sequence[Shot], cameras: Sequence[str]) -> list[str]:
    """How many shots are kept, what each camera's good pictures cover, and what to do next."""
    kept = sum(bool(shot.kept) for shot in shots)
    shares = ", ".join(f"{name} {field_share(list_own(shots, name)):.0%}" for name in cameras)
    counts = f"{len(shots)} moments looked at, {kept} shots kept; covered of the field: {shares}."
    return [counts, advise_cameras(shots, cameras).sentence]


def _list_good(shots: Sequence[Shot], camera: str) -> list[Judgement]:
    return [each for each in list_own(shots, camera) if each.good]


def _what_is_wrong(shot: Shot) -> str:
    """Of a shot that is good for no camera."""
    for name, each in shot.judgements.items():
        if each.faults and each.found:
            return f"Again, {name}: {each.faults[0]}."
    name, each = next(iter(shot.judgements.items()))
    return f"No camera finds the board; of {name}: {each.refusal}"
