"""Cameras brought into one frame by the shots that they share, and shots that do not fit found.

Two cameras that saw one board stand to each other as their poses before it say; a pose that many
shots agree on is believed. Cameras that never share a shot are chained over others.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.motions import chained, inverse
from trinoc.calib.shots.sightings import Sighting
from trinoc.calib.targets import AbstractTarget

# So many shots are asked for a relative pose, and so many judge it.
_ASKED, _JUDGES = 8, 24


class PairLink(NamedTuple):
    """How a second camera stands to a first one.

    Fields
    ------
    second_from_first : (3, 4).
    shared : how many shots both saw, of those asked.
    agreeing : how many of these agree on the pose.
    """

    second_from_first: Float[np.ndarray, "3 4"]
    shared: int
    agreeing: int

    @property
    def holds(self) -> bool:
        """Whether more agree than chance makes: one shot has nobody to disagree with."""
        return self.agreeing >= min(2, self.shared) and 3 * self.agreeing >= self.shared


def pair_link(
    first: Sequence[Sighting], second: Sequence[Sighting], target: AbstractTarget
) -> PairLink:
    """The relative pose that most pairs of sightings, taken in turn, agree on.

    Both of a pair are of one board, or of boards of which it is known how they are fixed.
    """
    pairs = list(zip(first, second, strict=True))
    judges = [pairs[k] for k in _spread(len(pairs), _JUDGES)]
    best, best_score = PairLink(np.eye(3, 4), len(judges), 0), (-1, 0.0)
    for k in _spread(len(pairs), _ASKED):
        one, other = pairs[k]
        for pose, own in product(other.cam_from_set, _from(one, other)):
            step = chained(pose, inverse(own))
            misses = [
                min(b.nearest(chained(step, start), target)[1] for start in _from(a, b))
                / b.agreement_px
                for a, b in judges
            ]
            agreeing = int(np.sum(np.array(misses) < 1.0))
            score = (agreeing, -float(np.median(misses)))
            if score > best_score:
                best, best_score = PairLink(step, len(judges), agreeing), score
    return best


def _from(one: Sighting, other: Sighting) -> tuple[Float[np.ndarray, "3 4"], ...]:
    """Labellings of a sighting that count: where both are of one board, the other's adapt."""
    return one.cam_from_set[:1] if one.board == other.board else one.cam_from_set


def board_link(
    pairs: Sequence[tuple[Sighting, Sighting, dict[int, Float[np.ndarray, "3 4"]]]],
    target: AbstractTarget,
) -> PairLink:
    """How a second board is fixed to a first one: second_from_first that most pairs agree on.

    pairs : of sightings of both in one shot, with cam_from_rig of cameras fixed to each other.
    """

    def expected(one: Sighting, other: Sighting, poses: dict) -> list[Float[np.ndarray, "3 4"]]:
        """Where the first board stands before the second's camera, in each labelling."""
        step = chained(poses[other.camera], inverse(poses[one.camera]))
        return [chained(step, pose) for pose in one.cam_from_board]

    judges = [pairs[k] for k in _spread(len(pairs), _JUDGES)]
    judged = [(expected(*pair), pair[1]) for pair in judges]
    best, best_score = PairLink(np.eye(3, 4), len(judges), 0), (-1, 0.0)
    for k in _spread(len(pairs), _ASKED):
        for start, end in product(expected(*pairs[k]), pairs[k][1].cam_from_board):
            first_from_second = chained(inverse(start), end)
            misses = [
                min(b.nearest(chained(own, first_from_second), target)[1] for own in starts)
                / b.agreement_px
                for starts, b in judged
            ]
            agreeing = int(np.sum(np.array(misses) < 1.0))
            score = (agreeing, -float(np.median(misses)))
            if score > best_score:
                step = inverse(first_from_second)
                best, best_score = PairLink(step, len(judges), agreeing), score
    return best


def linked_groups(
    links: dict[tuple[int, int], PairLink], cameras: Sequence[int]
) -> list[dict[int, Float[np.ndarray, "3 4"]]]:
    """Groups of cameras that links connect, each with cam_from_rig of its members.

    The frame of a group is that of its first camera; links that more shots agree on come first
    (Prim's spanning tree).
    """
    left, groups = list(cameras), []
    while left:
        poses = {left[0]: np.eye(3, 4)}
        while True:
            edges = [
                (link.agreeing, inner, outer, step)
                for (a, b), link in links.items()
                if link.holds
                for inner, outer, step in (
                    (a, b, link.second_from_first),
                    (b, a, inverse(link.second_from_first)),
                )
                if inner in poses and outer not in poses
            ]
            if not edges:
                break
            _, inner, outer, step = max(edges, key=lambda edge: edge[0])
            poses[outer] = chained(step, poses[inner])
        groups.append(poses)
        left = [camera for camera in left if camera not in poses]
    return groups


class PlacedShot(NamedTuple):
    """Sightings that agree on one pose of the board.

    Fields
    ------
    members : (sighting, its labelling) of each.
    rig_from_board : (3, 4).
    stragglers : sightings of the same shot that saw the board elsewhere, and by how many px.
    """

    members: list[tuple[Sighting, int]]
    rig_from_board: Float[np.ndarray, "3 4"]
    stragglers: list[tuple[Sighting, float]]


def placed_shot(
    sightings: Sequence[Sighting],
    cam_from_rig: dict[int, Float[np.ndarray, "3 4"]],
    target: AbstractTarget,
) -> PlacedShot:
    """The pose of the board that most sightings of a shot agree on."""
    # A board alone stands as well turned as it looks the same; among others it does not.
    several = len({sighting.board for sighting in sightings}) > 1
    candidates = [
        (one, turn, chained(inverse(cam_from_rig[one.camera]), own))
        for one in sightings
        for turn, own in enumerate(one.cam_from_set if several else one.cam_from_set[:1])
    ]
    best = None
    for one, turn, board in candidates:
        members, stragglers, total = [], [], 0.0
        for other in sightings:
            if other is one:
                members.append((one, turn))
                continue
            seen = chained(cam_from_rig[other.camera], board)
            labelling, miss = other.nearest(seen, target)
            total += min(miss / other.agreement_px, 1.0)
            if miss < other.agreement_px:
                members.append((other, labelling))
            else:
                stragglers.append((other, miss))
        if best is None or total < best[0]:
            best = total, PlacedShot(members, board, stragglers)
    assert best is not None
    return best[1]


def _spread(count: int, most: int) -> list[int]:
    """At most so many of the first `count` numbers, evenly."""
    return sorted({int(k) for k in np.linspace(0, count - 1, min(count, most)).round()})
