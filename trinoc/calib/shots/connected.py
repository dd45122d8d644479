"""Cameras and boards brought into one frame each, in turns.

Cameras that see one board in a shot, or boards known to be fixed to each other, are connected; and
boards that a camera sees in a shot, or cameras known to be fixed to each other. Each makes more of
the other known. Where neither goes on, two cameras that see a board each still move together.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.shots.chain import PairLink, board_link, linked_groups, pair_link
from trinoc.calib.shots.hand_eye import FEWEST_SHOTS, hand_eye
from trinoc.calib.shots.motions import chained, inverse
from trinoc.calib.shots.sightings import Sighting
from trinoc.calib.targets import AbstractTarget

Poses = dict[int, Float[np.ndarray, "3 4"]]
Links = dict[tuple[int, int], PairLink]
# Subsets of shots that are tried where all of them together do not agree, and their size.
_TRIES, _SUBSET = 60, 4


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
            found = _moving_together(placed, cameras, groups, target)
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


def _moving_together(
    placed: Mapping[int, Sequence[Sighting]],
    cameras: Sequence[Poses],
    groups: Sequence[Poses],
    target: AbstractTarget,
) -> tuple[Links, Links] | None:
    """Two groups of cameras and two of boards that move as if both were fixed to each other."""
    best = None
    for g, h in combinations(range(len(cameras)), 2):
        for p in range(len(groups)):
            for q in range(len(groups)):
                if p == q:
                    continue
                first = _by_shot(placed, cameras[g], groups[p])
                second = _by_shot(placed, cameras[h], groups[q])
                shots = sorted(set(first) & set(second))
                pairs = [(first[shot], second[shot]) for shot in shots]
                found = _agreed(pairs, cameras[g], cameras[h], target)
                if found is not None and (best is None or found[2] > best[0]):
                    best = found[2], (g, h), (p, q), found
    if best is None:
        return None
    agreeing, (g, h), (p, q), (between_cameras, between_boards, _, shared) = best
    ends = min(cameras[g]), min(cameras[h])
    fixed = min(groups[p]), min(groups[q])
    return (
        {ends: PairLink(between_cameras, shared, agreeing)},
        {fixed: PairLink(inverse(between_boards), shared, agreeing)},
    )


def _by_shot(
    placed: Mapping[int, Sequence[Sighting]], cameras: Poses, boards: Poses
) -> dict[int, Sighting]:
    """The sighting with most places of each shot, of these cameras and boards."""
    best: dict[int, Sighting] = {}
    for camera in cameras:
        for each in placed[camera]:
            if each.board not in boards:
                continue
            known = best.get(each.shot)
            if known is None or len(each.detections[0]) > len(known.detections[0]):
                best[each.shot] = each
    return best


class _Agreed(NamedTuple):
    """Motions between two groups of cameras and of boards, and how many pairs of all agree."""

    cameras: Float[np.ndarray, "3 4"]
    boards: Float[np.ndarray, "3 4"]
    agreeing: int
    shared: int


def _agreed(
    pairs: Sequence[tuple[Sighting, Sighting]],
    cameras: Poses,
    other_cameras: Poses,
    target: AbstractTarget,
) -> _Agreed | None:
    """What most pairs agree on: by all shots, by few of them, and by those that agreed."""
    count = len(pairs)
    if count < FEWEST_SHOTS:
        return None
    first = np.stack([chained(inverse(cameras[a.camera]), a.cam_from_set[0]) for a, _ in pairs])
    second = np.stack(
        [chained(inverse(other_cameras[b.camera]), b.cam_from_set[0]) for _, b in pairs]
    )

    def judged(rows: np.ndarray) -> tuple[_Agreed, np.ndarray] | None:
        found = hand_eye(first[rows], second[rows])
        if found is None:
            return None
        agrees = np.zeros(count, dtype=bool)
        for k, (_, b) in enumerate(pairs):
            pose = chained(chained(found.cameras, first[k]), found.boards)
            _, miss = b.nearest(chained(other_cameras[b.camera], pose), target)
            agrees[k] = miss < b.agreement_px
        return _Agreed(found.cameras, found.boards, int(agrees.sum()), count), agrees

    random, tried = np.random.default_rng(0), [np.arange(count)]
    if count > _SUBSET:
        tried += [random.choice(count, _SUBSET, replace=False) for _ in range(_TRIES)]
    best, agrees = None, None
    for rows in tried:
        found = judged(rows)
        if found is not None and (best is None or found[0].agreeing > best.agreeing):
            best, agrees = found
        if best is not None and best.agreeing == count:
            return best
    if best is None or agrees is None or best.agreeing < FEWEST_SHOTS:
        return None
    again = judged(np.flatnonzero(agrees))
    best = again[0] if again is not None and again[0].agreeing >= best.agreeing else best
    return best if 2 * best.agreeing > count else None
