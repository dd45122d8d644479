"""Poses between cameras, and between boards, that shots agree on, and shots that do not fit.

Two cameras that saw one board stand to each other as their poses before it say; a pose that many
shots agree on is believed. Cameras that never share a shot are chained over others.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from trinoc.calib.starts.sightings import IN_PLACE, Sighting
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.geometry.pose import Pose

# numerical: so many shots propose a relative pose, and so many judge it; it bounds the time.
_PROPOSALS, _JUDGES = 8, 24

# cam_from_rig, or set_from_board, by index.
Poses = dict[int, Pose]


class Link(NamedTuple):
    """How a second camera stands to a first one, or a second board.

    Fields
    ------
    second_from_first : the pose.
    shared : how many shots both saw, of those that judge.
    agreeing : how many of these agree on the pose.
    """

    second_from_first: Pose
    shared: int
    agreeing: int

    @property
    def holds(self) -> bool:
        """Whether more agree than chance makes: one shot has nobody to disagree with."""
        return self.agreeing >= min(2, self.shared) and 3 * self.agreeing >= self.shared


Links = dict[tuple[int, int], Link]


def link_cameras(
    pairs: Sequence[tuple[Sighting, Sighting]], target: AbstractTarget, tuning: CalibTuning
) -> Link:
    """The pose of the second camera that most pairs of sightings, taken in turn, agree on.

    Both of a pair are of one board, or of boards of which it is known how they are fixed.
    """

    def labellings(one: Sighting, other: Sighting) -> tuple[Pose, ...]:
        """Those that count: where both are of one board, the other's adapt."""
        return one.cam_from_set[:1] if one.board == other.board else one.cam_from_set

    return _most_agreed(
        [(labellings(one, other), other.cam_from_set, other) for one, other in pairs],
        lambda first, second: second @ first.inverse,
        lambda step, first: step @ first,
        target,
        tuning,
    )


def link_boards(
    pairs: Sequence[tuple[Sighting, Sighting, Poses]], target: AbstractTarget, tuning: CalibTuning
) -> Link:
    """How a second board is fixed to a first one, by what most pairs of sightings agree on.

    pairs : of sightings of both in one shot, with cam_from_rig of cameras fixed to each other.
    """

    def before_second(one: Sighting, other: Sighting, poses: Poses) -> list[Pose]:
        """Where the first board stands before the second's camera, in each labelling."""
        step = poses[other.camera] @ poses[one.camera].inverse
        return [step @ pose for pose in one.cam_from_board]

    link = _most_agreed(
        [(before_second(*pair), pair[1].cam_from_board, pair[1]) for pair in pairs],
        lambda first, second: first.inverse @ second,
        lambda first_from_second, first: first @ first_from_second,
        target,
        tuning,
    )
    return link._replace(second_from_first=link.second_from_first.inverse)


def _most_agreed(
    pairs: Sequence[tuple[Sequence[Pose], Sequence[Pose], Sighting]],
    between: Callable[[Pose, Pose], Pose],
    apply: Callable[[Pose, Pose], Pose],
    target: AbstractTarget,
    tuning: CalibTuning,
) -> Link:
    """The step `between` two poses which, if it `apply`s, leaves most second sightings in place.

    pairs : poses of the first, those of the second, and the second itself.
    """
    judges = [pairs[k] for k in _spread(len(pairs), _JUDGES)]
    best, best_score = Link(IN_PLACE, len(judges), 0), (-1, 0.0)
    for k in _spread(len(pairs), _PROPOSALS):
        firsts, seconds, _ = pairs[k]
        for second, first in product(seconds, firsts):
            step = between(first, second)
            misses = [
                min(sighting.nearest(apply(step, own), target)[1] for own in starts)
                / sighting.agreement_px(tuning)
                for starts, _, sighting in judges
            ]
            agreeing = int(np.sum(np.array(misses) < 1.0))
            score = (agreeing, -float(np.median(misses)))
            if score > best_score:
                best, best_score = Link(step, len(judges), agreeing), score
    return best


def chain_links(links: Links, members: Iterable[int]) -> list[Poses]:
    """Groups of cameras (or boards) that links connect, each with member_from_first.

    Links that more shots agree on come first (Prim's spanning tree).
    """
    left, groups = list(members), []
    while left:
        poses = {left[0]: IN_PLACE}
        while True:
            edges = [
                (link.agreeing, inner, outer, step)
                for (a, b), link in links.items()
                if link.holds
                for inner, outer, step in (
                    (a, b, link.second_from_first),
                    (b, a, link.second_from_first.inverse),
                )
                if inner in poses and outer not in poses
            ]
            if not edges:
                break
            _, inner, outer, step = max(edges, key=lambda edge: edge[0])
            poses[outer] = step @ poses[inner]
        groups.append(poses)
        left = [member for member in left if member not in poses]
    return groups


class PlacedBoard(NamedTuple):
    """Sightings that agree on one pose of the board.

    Fields
    ------
    members : (sighting, its labelling) of each.
    rig_from_board : the pose.
    stragglers : sightings of the same shot that saw the board elsewhere, and by how many px.
    """

    members: list[tuple[Sighting, int]]
    rig_from_board: Pose
    stragglers: list[tuple[Sighting, float]]


def place_board(
    sightings: Sequence[Sighting],
    cam_from_rig: Mapping[int, Pose],
    target: AbstractTarget,
    tuning: CalibTuning,
) -> PlacedBoard:
    """The pose of the board that most sightings of a shot agree on."""
    # A board alone stands as well turned as it looks the same; among others it does not.
    several = len({sighting.board for sighting in sightings}) > 1
    best: tuple[float, PlacedBoard] | None = None
    for one in sightings:
        for labelling, own in enumerate(one.cam_from_set if several else one.cam_from_set[:1]):
            board = cam_from_rig[one.camera].inverse @ own
            members, stragglers, total = [], [], 0.0
            for other in sightings:
                turn, miss = labelling, 0.0
                if other is not one:
                    turn, miss = other.nearest(cam_from_rig[other.camera] @ board, target)
                agreement_px = other.agreement_px(tuning)
                total += min(miss / agreement_px, 1.0)
                if miss < agreement_px:
                    members.append((other, turn))
                else:
                    stragglers.append((other, miss))
            if best is None or total < best[0]:
                best = total, PlacedBoard(members, board, stragglers)
    assert best is not None
    return best[1]


def _spread(count: int, most: int) -> list[int]:
    """At most so many of the first `count` numbers, evenly."""
    return sorted({int(k) for k in np.linspace(0, count - 1, min(count, most)).round()})
