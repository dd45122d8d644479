"""Cameras brought into one frame by the shots that they share, and shots that do not fit found.

Two cameras that saw one board stand to each other as their poses before it say; a pose that many
shots agree on is believed. Cameras that never share a shot are chained over others.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.shots.motions import chained, inverse
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
    """The relative pose that most pairs of sightings, taken in turn, agree on."""
    pairs = list(zip(first, second, strict=True))
    judges = [pairs[k] for k in _spread(len(pairs), _JUDGES)]
    best, best_score = PairLink(np.eye(3, 4), len(judges), 0), (-1, 0.0)
    for k in _spread(len(pairs), _ASKED):
        one, other = pairs[k]
        for pose in other.cam_from_board:
            step = chained(pose, inverse(one.cam_from_board[0]))
            misses = [
                b.nearest(chained(step, a.cam_from_board[0]), target)[1] / b.agreement_px
                for a, b in judges
            ]
            agreeing = int(np.sum(np.array(misses) < 1.0))
            score = (agreeing, -float(np.median(misses)))
            if score > best_score:
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
    best = None
    for one in sightings:
        board = chained(inverse(cam_from_rig[one.camera]), one.cam_from_board[0])
        members, stragglers, total = [], [], 0.0
        for other in sightings:
            if other is one:
                members.append((one, 0))
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
