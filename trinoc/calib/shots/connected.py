"""Cameras and boards brought into one frame each, in turns.

Cameras that see one board in a shot, or boards known to be fixed to each other, are connected; and
boards that a camera sees in a shot, or cameras known to be fixed to each other. Each makes more of
the other known. Where neither goes on, two cameras that see a board each still move together.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from trinoc.calib.problem.motions import inverse
from trinoc.calib.shots.chain import board_link, linked_groups, pair_link
from trinoc.calib.shots.moving_together import Links, Poses, moving_together
from trinoc.calib.shots.sightings import Sighting
from trinoc.calib.targets import AbstractTarget


class Connected(NamedTuple):
    """What is fixed to what.

    Fields
    ------
    cameras : groups of cameras, each with cam_from_rig of its members.
    boards : groups of boards, each with set_from_board of its members.
    links : between cameras.
    """

    cameras: list[Poses]
    boards: list[Poses]
    links: Links


def connected(
    seen: Mapping[int, Sequence[Sighting]], boards: Sequence[int], target: AbstractTarget
) -> Connected:
    """All cameras and boards that the shots connect. `seen` : by each camera."""
    groups: list[Poses] = [{board: np.eye(3, 4)} for board in boards]
    more_cameras: Links = {}
    more_boards: Links = {}
    while True:
        placed = {camera: [in_set(each, groups) for each in own] for camera, own in seen.items()}
        links = _camera_links(placed, groups, target)
        cameras = linked_groups({**more_cameras, **links}, list(seen))
        if len(boards) == 1:
            return Connected(cameras, groups, links)
        before = len(groups)
        groups = _board_groups(seen, cameras, boards, more_boards, target)
        if len(groups) < before:
            continue
        found = None
        if len(cameras) > 1:
            placed = {camera: [in_set(s, groups) for s in own] for camera, own in seen.items()}
            found = moving_together(placed, cameras, groups, target)
        if found is None:
            return Connected(cameras, groups, links)
        more_cameras |= found[0]
        more_boards |= found[1]


def in_set(sighting: Sighting, groups: Sequence[Poses]) -> Sighting:
    """The sighting with the place of its board among those that it is connected to."""
    own = next(group for group in groups if sighting.board in group)
    return sighting._replace(set_from_board=own[sighting.board])


def _group_of(groups: Sequence[Poses], member: int) -> int:
    return next(k for k, group in enumerate(groups) if member in group)


def _camera_links(
    placed: Mapping[int, Sequence[Sighting]], groups: Sequence[Poses], target: AbstractTarget
) -> Links:
    links: Links = {}
    for a, b in combinations(placed, 2):
        pairs = _of_one_shot(placed[a], placed[b], groups)
        if pairs:
            links[a, b] = pair_link([p for p, _ in pairs], [q for _, q in pairs], target)
    return links


def _of_one_shot(
    first: Sequence[Sighting], second: Sequence[Sighting], groups: Sequence[Poses]
) -> list[tuple[Sighting, Sighting]]:
    """For each shot, and each group of boards, a pair of sightings: of one board where there is."""
    best: dict[tuple[int, int], tuple[Sighting, Sighting]] = {}
    for one in first:
        group = _group_of(groups, one.board)
        for other in second:
            if other.shot != one.shot or other.board not in groups[group]:
                continue
            known = best.get((one.shot, group))
            if known is None or (known[0].board != known[1].board and one.board == other.board):
                best[one.shot, group] = one, other
    return [best[key] for key in sorted(best)]


def _board_groups(
    seen: Mapping[int, Sequence[Sighting]],
    cameras: Sequence[Poses],
    boards: Sequence[int],
    more: Links,
    target: AbstractTarget,
) -> list[Poses]:
    links: Links = {}
    for a, b in combinations(boards, 2):
        pairs = [
            (one, other, poses)
            for poses in cameras
            for one in (s for camera in poses for s in seen[camera] if s.board == a)
            for other in (s for camera in poses for s in seen[camera] if s.board == b)
            if one.shot == other.shot
        ]
        if pairs:
            links[a, b] = board_link(sorted(pairs, key=lambda pair: pair[0].shot), target)
    groups = linked_groups({**more, **links}, boards)
    return [{board: inverse(pose) for board, pose in group.items()} for group in groups]
