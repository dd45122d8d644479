"""Cameras and boards brought into one frame each, in turns.

Cameras that see one board in a shot, or boards known to be fixed to each other, are connected; and
boards that a camera sees in a shot, or cameras known to be fixed to each other. Each makes more of
the other known. Where neither goes on, two cameras that see a board each still move together: what
one camera sees of its board in a shot is T, what the other sees of the other board is U, and with
the cameras fixed to each other by X and the boards by Y, U = X T Y in every shot.
Source: F. Dornaika and R. Horaud, "Simultaneous robot-world and hand-eye calibration", IEEE
Transactions on Robotics and Automation 14(4), 1998; rotations as F. Park and B. Martin, "Robot
sensor calibration: solving AX = XB on the Euclidean group", ibid. 10(5), 1994.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations, permutations
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool

from trinoc.calib.starts.camera_start import nearest_rotation
from trinoc.calib.starts.links import Link, Links, Poses, chain_links, link_boards, link_cameras
from trinoc.calib.starts.sightings import IN_PLACE, Sighting
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.geometry.pose import Pose

# numerical: two motions about two axes.
FEWEST_SHOTS = 3
# numerical: subsets of shots, and their size, that are tried where all together do not agree.
_TRIES, _SUBSET = 60, 4


class ConnectedShots(NamedTuple):
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
    sightings: Mapping[int, Sequence[Sighting]],
    boards: Sequence[int],
    target: AbstractTarget,
    tuning: CalibTuning,
) -> ConnectedShots:
    """All cameras and boards that the shots connect. `sightings` : of each camera."""
    groups: list[Poses] = [{board: IN_PLACE} for board in boards]
    cameras_by_motion: Links = {}
    boards_by_motion: Links = {}
    while True:
        links = _link_all_cameras(_in_sets(sightings, groups), groups, target, tuning)
        cameras = chain_links({**cameras_by_motion, **links}, sightings)
        if len(boards) == 1:
            return ConnectedShots(cameras, groups, links)
        before = len(groups)
        board_links = _link_all_boards(sightings, cameras, boards, target, tuning)
        chained = chain_links({**boards_by_motion, **board_links}, boards)
        groups = [{board: pose.inverse for board, pose in own.items()} for own in chained]
        if len(groups) < before:
            continue
        found = None
        if len(cameras) > 1:
            found = link_by_motion(_in_sets(sightings, groups), cameras, groups, target, tuning)
        if found is None:
            return ConnectedShots(cameras, groups, links)
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
    sightings: Mapping[int, Sequence[Sighting]],
    groups: Sequence[Poses],
    target: AbstractTarget,
    tuning: CalibTuning,
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
            links[a, b] = link_cameras([pairs[key] for key in sorted(pairs)], target, tuning)
    return links


def _link_all_boards(
    sightings: Mapping[int, Sequence[Sighting]],
    cameras: Sequence[Poses],
    boards: Sequence[int],
    target: AbstractTarget,
    tuning: CalibTuning,
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
            links[a, b] = link_boards(sorted(pairs, key=lambda pair: pair[0].shot), target, tuning)
    return links


class HandEye(NamedTuple):
    """`second` = cameras @ `first` @ boards, for every shot's pair of poses."""

    cameras: Pose
    boards: Pose


def solve_hand_eye(
    first: Sequence[Pose], second: Sequence[Pose], tuning: CalibTuning
) -> HandEye | None:
    """The motions that explain all pairs best; None where they leave something open."""
    if len(first) < FEWEST_SHOTS:
        return None
    pairs = list(combinations(range(len(first)), 2))
    before = [first[t] @ first[s].inverse for s, t in pairs]
    after = [second[t] @ second[s].inverse for s, t in pairs]
    axes, turned = (
        np.stack([cv2.Rodrigues(np.asarray(motion.rotation))[0].ravel() for motion in motions])
        for motions in (before, after)
    )
    spread = np.linalg.svd(axes, compute_uv=False)
    if not spread[1] > tuning.starts.least_other_turns * spread[0]:
        return None
    rotation = nearest_rotation(turned.T @ axes)
    rows = np.concatenate([motion.rotation - np.eye(3) for motion in after])
    right = [
        rotation @ one.translation_mm - two.translation_mm
        for one, two in zip(before, after, strict=True)
    ]
    shift, *_ = np.linalg.lstsq(rows, np.concatenate(right), rcond=None)
    cameras = Pose(np.column_stack([rotation, shift]))
    mean = np.mean(
        [
            ((cameras @ one).inverse @ two).cam_from_world
            for one, two in zip(first, second, strict=True)
        ],
        axis=0,
    )
    boards = Pose(np.column_stack([nearest_rotation(mean[:, :3]), mean[:, 3]]))
    return HandEye(cameras, boards)


def link_by_motion(
    sightings: Mapping[int, Sequence[Sighting]],
    cameras: Sequence[Poses],
    boards: Sequence[Poses],
    target: AbstractTarget,
    tuning: CalibTuning,
) -> tuple[Links, Links] | None:
    """Two groups of cameras and two of boards that move as if both were fixed to each other.

    sightings : of each camera. The links between both pairs of groups that most shots agree on.
    """
    best: tuple[_Agreement, Links, Links] | None = None
    for near, far in combinations(cameras, 2):
        for front, back in permutations(boards, 2):
            first, second = (
                _largest_by_shot(sightings, *own) for own in ((near, front), (far, back))
            )
            pairs = [(first[shot], second[shot]) for shot in sorted(set(first) & set(second))]
            found = _most_agreed(pairs, near, far, target, tuning)
            if found is None or (best is not None and found.agreeing <= best[0].agreeing):
                continue
            counts = len(pairs), found.agreeing
            best = (
                found,
                {(min(near), min(far)): Link(found.motions.cameras, *counts)},
                {(min(front), min(back)): Link(found.motions.boards.inverse, *counts)},
            )
    return None if best is None else best[1:]


def _largest_by_shot(
    sightings: Mapping[int, Sequence[Sighting]], cameras: Poses, boards: Poses
) -> dict[int, Sighting]:
    """The sighting with most places of each shot, of these cameras and boards."""
    own = [each for camera in cameras for each in sightings[camera] if each.board in boards]
    largest: dict[int, Sighting] = {}
    for each in own:
        known = largest.setdefault(each.shot, each)
        if len(each.detections[0]) > len(known.detections[0]):
            largest[each.shot] = each
    return largest


class _Agreement(NamedTuple):
    """Motions between two groups of cameras and of boards, and which pairs agree on them."""

    motions: HandEye
    agrees: Bool[np.ndarray, "s"]

    @property
    def agreeing(self) -> int:
        """How many pairs agree."""
        return int(self.agrees.sum())


def _most_agreed(
    pairs: Sequence[tuple[Sighting, Sighting]],
    near: Poses,
    far: Poses,
    target: AbstractTarget,
    tuning: CalibTuning,
) -> _Agreement | None:
    """What most pairs agree on: by all shots, by few of them, and by those that agreed."""
    count = len(pairs)
    first = [near[a.camera].inverse @ a.cam_from_set[0] for a, _ in pairs]
    second = [far[b.camera].inverse @ b.cam_from_set[0] for _, b in pairs]

    def by_rows(rows: np.ndarray) -> _Agreement | None:
        found = solve_hand_eye([first[k] for k in rows], [second[k] for k in rows], tuning)
        if found is None:
            return None
        agrees = np.zeros(count, dtype=bool)
        for k, (_, other) in enumerate(pairs):
            pose = far[other.camera] @ found.cameras @ first[k] @ found.boards
            agrees[k] = other.nearest(pose, target)[1] < other.agreement_px(tuning)
        return _Agreement(found, agrees)

    random, tried = np.random.default_rng(0), [np.arange(count)]
    if count > _SUBSET:
        tried += [random.choice(count, _SUBSET, replace=False) for _ in range(_TRIES)]
    best: _Agreement | None = None
    for rows in tried:
        found = by_rows(rows)
        if found is not None and (best is None or found.agreeing > best.agreeing):
            best = found
        if best is not None and best.agreeing == count:
            return best
    if best is None or best.agreeing < FEWEST_SHOTS:
        return None
    again = by_rows(np.flatnonzero(best.agrees))
    best = again if again is not None and again.agreeing >= best.agreeing else best
    return best if 2 * best.agreeing > count else None
