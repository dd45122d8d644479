"""Cameras and boards brought into one frame each, in turns.

Cameras that see one board in a shot, or boards known to be fixed to each other, are connected; and
boards that a camera sees in a shot, or cameras known to be fixed to each other. Each makes more of
the other known. Where neither goes on, two cameras that see a board each still move together.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

from trinoc.calib.starts.hand_eye import link_by_motion
from trinoc.calib.starts.links import Links, Poses, chain_links, link_boards, link_cameras
from trinoc.calib.starts.sightings import IN_PLACE, Sighting
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


def connect(
    sightings: Mapping[int, Sequence[Sighting]], boards: Sequence[int], target: AbstractTarget
) -> Connected:
    """All cameras and boards that the shots connect. `sightings` : of each camera."""
    groups: list[Poses] = [{board: IN_PLACE} for board in boards]
    cameras_by_motion: Links = {}
    boards_by_motion: Links = {}
    while True:
        links = _link_all_cameras(_in_sets(sightings, groups), groups, target)
        cameras = chain_links({**cameras_by_motion, **links}, sightings)
        if len(boards) == 1:
            return Connected(cameras, groups, links)
        before = len(groups)
        board_links = _link_all_boards(sightings, cameras, boards, target)
        chained = chain_links({**boards_by_motion, **board_links}, boards)
        groups = [{board: pose.inverse for board, pose in own.items()} for own in chained]
        if len(groups) < before:
            continue
        found = None
        if len(cameras) > 1:
            found = link_by_motion(_in_sets(sightings, groups), cameras, groups, target)
        if found is None:
            return Connected(cameras, groups, links)
        cameras_by_motion |= found[0]
        boards_by_motion |= found[1]


def in_set(sighting: Sighting, groups: Sequence[Poses]) -> Sighting:
    """The sighting with the place of its board among those that it is connected to."""
    own = next(group for group in groups if sighting.board in group)
    return sighting._replace(set_from_board=own[sighting.board])


def _in_sets(
    sightings: Mapping[int, Sequence[Sighting]], groups: Sequence[Poses]
) -> dict[int, list[Sighting]]:
    return {camera: [in_set(each, groups) for each in own] for camera, own in sightings.items()}


def _link_all_cameras(
    sightings: Mapping[int, Sequence[Sighting]], groups: Sequence[Poses], target: AbstractTarget
) -> Links:
    links: Links = {}
    for a, b in combinations(sightings, 2):
        # For each shot, and each group of boards, a pair: of one board where there is one.
        pairs: dict[tuple[int, int], tuple[Sighting, Sighting]] = {}
        for one in sightings[a]:
            group = next(k for k, own in enumerate(groups) if one.board in own)
            for other in sightings[b]:
                if other.shot != one.shot or other.board not in groups[group]:
                    continue
                known = pairs.get((one.shot, group))
                if known is None or (known[0].board != known[1].board and one.board == other.board):
                    pairs[one.shot, group] = one, other
        if pairs:
            links[a, b] = link_cameras([pairs[key] for key in sorted(pairs)], target)
    return links


def _link_all_boards(
    sightings: Mapping[int, Sequence[Sighting]],
    cameras: Sequence[Poses],
    boards: Sequence[int],
    target: AbstractTarget,
) -> Links:
    links: Links = {}
    for a, b in combinations(boards, 2):
        pairs = [
            (one, other, poses)
            for poses in cameras
            for one in (s for camera in poses for s in sightings[camera] if s.board == a)
            for other in (s for camera in poses for s in sightings[camera] if s.board == b)
            if one.shot == other.shot
        ]
        if pairs:
            links[a, b] = link_boards(sorted(pairs, key=lambda pair: pair[0].shot), target)
    return links
