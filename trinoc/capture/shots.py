"""Shots of several cameras: new information of each, and the goal for the next one."""

from collections.abc import Mapping, Sequence
from itertools import combinations, permutations
from typing import NamedTuple

from trinoc.capture.advice import ENOUGH, adds_information, field_share, next_goal, next_step
from trinoc.capture.goal import Goal
from trinoc.capture.image_quality import ImageQuality

# An image of a plane gives two constraints on a lens, which has at least four parameters.
FEWEST_SHOTS = 3


class Shot(NamedTuple):
    """Images of the cameras at one time.

    Attributes
    ----------
    name : str
        Name of the time.
    qualities : mapping of ImageQuality
        Quality of each camera's image, by camera name.
    saved_name : str
        Name of the saved images; "" if they were not saved.
    """

    name: str
    qualities: Mapping[str, ImageQuality]
    saved_name: str = ""

    @property
    def good_cameras(self) -> tuple[str, ...]:
        """Names of the cameras whose image is good for calibration."""
        return tuple(name for name, each in self.qualities.items() if each.is_good)


class Advice(NamedTuple):
    """Advice for the user: a sentence, and the wanted board position of each camera it concerns."""

    sentence: str
    goals: Mapping[str, Goal]


def camera_qualities(
    shots: Sequence[Shot], camera: str, partner: str | None = None
) -> list[ImageQuality]:
    """Image qualities of one camera, in all shots or in those with a good image of `partner`."""
    return [
        shot.qualities[camera]
        for shot in shots
        if camera in shot.qualities and (partner is None or partner in shot.good_cameras)
    ]


def is_new_shot(earlier: Sequence[Shot], last: Shot) -> bool:
    """True if a shot adds information for a camera, or for a pair of cameras.

    Pairs connect the cameras: they must have the board in view at the same time.
    """
    pairs = [(name, None) for name in last.good_cameras] + list(permutations(last.good_cameras, 2))
    return any(
        adds_information(camera_qualities(earlier, name, partner), last.qualities[name])
        for name, partner in pairs
    )


def advise_cameras(shots: Sequence[Shot], cameras: Sequence[str]) -> Advice:
    """Advice for several cameras.

    Faults of the last shot come first, then the camera with the least coverage.
    """
    if len(cameras) == 1:
        qualities = camera_qualities(shots, cameras[0])
        goal = next_goal(qualities)
        return Advice(next_step(qualities), {} if goal is None else {cameras[0]: goal})
    goals = {name: next_goal(camera_qualities(shots, name)) for name in cameras}
    wanted = {name: goal for name, goal in goals.items() if goal is not None}
    neediest = min(wanted, key=lambda name: field_share(camera_qualities(shots, name)), default="")
    goals_to_draw = {neediest: wanted[neediest]} if neediest else {}
    if not shots:
        return Advice("Hold the board where all cameras see it, and hold it still.", {})
    if not shots[-1].good_cameras:
        return Advice(_describe_fault(shots[-1]), goals_to_draw)
    groups = connect_cameras(shots, cameras)
    if len(groups) > 1 and all(_list_good(shots, name) for name in cameras):
        first, second = (" or ".join(group) for group in groups[:2])
        return Advice(f"Hold the board where {first} sees it together with {second}.", {})
    return Advice(
        f"For {neediest}: {wanted[neediest].sentence}" if neediest else ENOUGH, goals_to_draw
    )


def connect_cameras(
    shots: Sequence[Shot], cameras: Sequence[str], by: int = FEWEST_SHOTS
) -> list[tuple[str, ...]]:
    """Groups of cameras that are connected by shots, directly or through other cameras.

    Two cameras are connected directly if both have a good image in at least `by` shots. One group
    if all are connected.
    """
    groups = [{name} for name in cameras]
    for pair in combinations(cameras, 2):
        if sum(set(pair) <= set(shot.good_cameras) for shot in shots) >= by:
            joined = [group for group in groups if group & set(pair)]
            groups = [group for group in groups if not group & set(pair)]
            groups.append(set().union(*joined))
    order = {name: k for k, name in enumerate(cameras)}
    sorted_groups = [tuple(sorted(group, key=order.__getitem__)) for group in groups]
    return sorted(sorted_groups, key=lambda group: order[group[0]])


def find_missing(shots: Sequence[Shot], cameras: Sequence[str]) -> str | None:
    """Sentence on why these shots are too few for a calibration; None if they may suffice."""
    for name in cameras:
        count = len(_list_good(shots, name))
        if count < FEWEST_SHOTS:
            owner = f' of "{name}"' if name else ""
            return (
                f"There is no calibration, because there are only {count} good pictures{owner} "
                f"with new views of the board ({FEWEST_SHOTS} are needed). Take more pictures, "
                "with another tilt of the board in each."
            )
    groups = connect_cameras(shots, cameras, by=1)
    if len(groups) > 1:
        first, second = (" or ".join(group) for group in groups[:2])
        return (
            f"There is no calibration, because no shot shows the board to {first} and {second} at "
            "the same time. Hold the board where both cameras see it."
        )
    return None


def shot_line(shot: Shot) -> str:
    """One line: saved or not, and the quality of each camera's image."""
    states = []
    for name, quality in shot.qualities.items():
        if quality.is_good:
            states.append(f"{name} good")
        elif quality.is_detected:
            states.append(f"{name} AGAIN ({'; '.join(quality.faults)})")
        else:
            states.append(f"{name} not found")
    reason = "nothing new" if shot.good_cameras else "not good"
    verdict = f"kept as {shot.saved_name}" if shot.saved_name else reason
    return f"{' '.join(shot.name.split())}: {verdict}; {', '.join(states)}"


def summarise_watch(shots: Sequence[Shot], cameras: Sequence[str]) -> list[str]:
    """Two lines: numbers of shots with each camera's covered field, and the next step."""
    saved_count = sum(bool(shot.saved_name) for shot in shots)
    shares = ", ".join(
        f"{name} {field_share(camera_qualities(shots, name)):.0%}" for name in cameras
    )
    counts = (
        f"{len(shots)} moments tested, {saved_count} shots kept; share of the field covered: "
        f"{shares}."
    )
    return [counts, advise_cameras(shots, cameras).sentence]


def _list_good(shots: Sequence[Shot], camera: str) -> list[ImageQuality]:
    return [quality for quality in camera_qualities(shots, camera) if quality.is_good]


def _describe_fault(shot: Shot) -> str:
    """Sentence on a shot without a good image."""
    for name, quality in shot.qualities.items():
        if quality.faults and quality.is_detected:
            return f"Again, {name}: {quality.faults[0]}."
    name, quality = next(iter(shot.qualities.items()))
    return f"No camera finds the board. Reason for {name}: {quality.refusal}"
