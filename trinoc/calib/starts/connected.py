"""Relative poses of all cameras, and of all boards of a set, from chains of shots.

Two cameras are connected if they see one board in a shot, or two boards with a known relative pose.
Two boards are connected if one camera sees both in a shot, or two cameras with a known relative
pose. Each step makes more relative poses known. If neither continues, the motion of two boards that
two cameras see separately may connect both cameras. Let T and U be the poses of their boards in a
shot. With constant relative poses X of the cameras and Y of the boards, U = X T Y in every shot.
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

# numerical: shots for two motions about two axes.
FEWEST_SHOTS = 3
# numerical: number and size of subsets of shots that are tried if all shots together disagree.
_TRIES, _SUBSET = 60, 4


class ConnectedShots(NamedTuple):
    """Relative poses of cameras, and of boards, that the shots determine.

    Attributes
    ----------
    cameras : groups of cameras with known relative poses. Each group maps the index of a camera to
        cam_from_rig; the rig is the first camera of the group.
    boards : groups of boards with known relative poses. Each group maps the index of a board to
        set_from_board.
    links : relative pose of each pair of cameras that saw the same boards.
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
    """Compute the relative poses of all cameras and of all boards that the shots determine.

    sightings : detections of each camera with the pose of the board; the key is the index of the
        camera.
    boards : indices of the boards.
    """
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
        groups = [{board: pose.inverse for board, pose in chain.items()} for chain in chained]
        if len(groups) < before:
            continue
        motion_links = None
        if len(cameras) > 1:
            motion_links = link_by_motion(
                _in_sets(sightings, groups), cameras, groups, target, tuning
            )
        if motion_links is None:
            return ConnectedShots(cameras, groups, links)
        cameras_by_motion |= motion_links[0]
        boards_by_motion |= motion_links[1]


def in_set(sighting: Sighting, groups: Sequence[Poses]) -> Sighting:
    """Copy of a sighting with `set_from_board` taken from the group that contains its board."""
    group = next(group for group in groups if sighting.board in group)
    return sighting._replace(set_from_board=group[sighting.board])


def _in_sets(
    sightings: Mapping[int, Sequence[Sighting]], groups: Sequence[Poses]
) -> dict[int, list[Sighting]]:
    return {
        camera: [in_set(sighting, groups) for sighting in camera_sightings]
        for camera, camera_sightings in sightings.items()
    }


def _link_all_cameras(
    sightings: Mapping[int, Sequence[Sighting]],
    groups: Sequence[Poses],
    target: AbstractTarget,
    tuning: CalibTuning,
) -> Links:
    links: Links = {}
    for a, b in combinations(sightings, 2):
        # For each shot, and each group of boards, a pair, preferably of one board.
        pairs: dict[tuple[int, int], tuple[Sighting, Sighting]] = {}
        for first in sightings[a]:
            group = next(k for k, members in enumerate(groups) if first.board in members)
            for second in sightings[b]:
                if second.shot != first.shot or second.board not in groups[group]:
                    continue
                pair = pairs.get((first.shot, group))
                if pair is None or (pair[0].board != pair[1].board and first.board == second.board):
                    pairs[first.shot, group] = first, second
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
            (first, second, poses)
            for poses in cameras
            for first in (
                sighting
                for camera in poses
                for sighting in sightings[camera]
                if sighting.board == a
            )
            for second in (
                sighting
                for camera in poses
                for sighting in sightings[camera]
                if sighting.board == b
            )
            if first.shot == second.shot
        ]
        if pairs:
            links[a, b] = link_boards(sorted(pairs, key=lambda pair: pair[0].shot), target, tuning)
    return links


class HandEye(NamedTuple):
    """Relative poses of two groups of cameras and of two groups of boards (hand-eye calibration).

    In each shot, let T be the pose of the first boards relative to the first cameras, and U that of
    the second boards relative to the second cameras. Then U = X T Y in all shots.

    Attributes
    ----------
    cameras : X, the pose of the first cameras relative to the second cameras.
    boards : Y, the pose of the second boards relative to the first boards.
    """

    cameras: Pose
    boards: Pose


def solve_hand_eye(
    first: Sequence[Pose], second: Sequence[Pose], tuning: CalibTuning
) -> HandEye | None:
    """Solve U = X T Y for the constant motions X and Y, by least squares over several shots.

    Returns None if there are too few shots, or if all motions rotate about nearly the same axis.

    first : T of each shot, the pose of the first boards relative to the first cameras.
    second : U of each shot, the pose of the second boards relative to the second cameras.
    """
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
    """Connect two groups of cameras that never see the same board, through two boards that move
    together.

    The first cameras see one group of boards, and the second cameras another group. All
    combinations of groups are tried. The combination on which most shots agree is returned, as the
    relative pose of the cameras and that of the boards. None if no combination agrees.

    sightings : detections of each camera with the pose of the board.
    cameras, boards : groups with known relative poses.
    """
    best: tuple[_Agreement, Links, Links] | None = None
    for first_cameras, second_cameras in combinations(cameras, 2):
        for first_boards, second_boards in permutations(boards, 2):
            first, second = (
                _largest_by_shot(sightings, *groups)
                for groups in ((first_cameras, first_boards), (second_cameras, second_boards))
            )
            pairs = [(first[shot], second[shot]) for shot in sorted(set(first) & set(second))]
            agreement = _most_agreed(pairs, first_cameras, second_cameras, target, tuning)
            if agreement is None or (best is not None and agreement.agreeing <= best[0].agreeing):
                continue
            counts = len(pairs), agreement.agreeing
            best = (
                agreement,
                {
                    (min(first_cameras), min(second_cameras)): Link(
                        agreement.motions.cameras, *counts
                    )
                },
                {
                    (min(first_boards), min(second_boards)): Link(
                        agreement.motions.boards.inverse, *counts
                    )
                },
            )
    return None if best is None else best[1:]


def _largest_by_shot(
    sightings: Mapping[int, Sequence[Sighting]], cameras: Poses, boards: Poses
) -> dict[int, Sighting]:
    """Detection with the most points in each shot, among those of some cameras and boards.

    The key of the result is the index of the shot.
    """
    candidates = [
        sighting for camera in cameras for sighting in sightings[camera] if sighting.board in boards
    ]
    largest: dict[int, Sighting] = {}
    for sighting in candidates:
        present = largest.setdefault(sighting.shot, sighting)
        if len(sighting.detections[0]) > len(present.detections[0]):
            largest[sighting.shot] = sighting
    return largest


class _Agreement(NamedTuple):
    """Relative poses of two groups of cameras and of boards, and the shots that agree on them.

    Attributes
    ----------
    motions : the relative poses.
    agrees : (s,) whether each of s pairs of detections, one pair per shot, agrees with them.
    """

    motions: HandEye
    agrees: Bool[np.ndarray, "s"]

    @property
    def agreeing(self) -> int:
        """Number of pairs of detections that agree."""
        return int(self.agrees.sum())


def _most_agreed(
    pairs: Sequence[tuple[Sighting, Sighting]],
    first_cameras: Poses,
    second_cameras: Poses,
    target: AbstractTarget,
    tuning: CalibTuning,
) -> _Agreement | None:
    """Find relative poses of two groups of cameras and of boards on which most shots agree
    (RANSAC).

    The poses are computed from all shots, from random subsets, and finally from all shots that
    agree. Returns None if no majority agrees.

    pairs : for each shot, one detection by each group of cameras.
    first_cameras, second_cameras : cam_from_rig of the cameras of each group.
    """
    count = len(pairs)
    first = [first_cameras[a.camera].inverse @ a.cam_from_set[0] for a, _ in pairs]
    second = [second_cameras[b.camera].inverse @ b.cam_from_set[0] for _, b in pairs]

    def by_rows(rows: np.ndarray) -> _Agreement | None:
        solution = solve_hand_eye([first[k] for k in rows], [second[k] for k in rows], tuning)
        if solution is None:
            return None
        agrees = np.zeros(count, dtype=bool)
        for k, (_, other) in enumerate(pairs):
            pose = second_cameras[other.camera] @ solution.cameras @ first[k] @ solution.boards
            agrees[k] = other.nearest(pose, target)[1] < other.agreement_px(tuning)
        return _Agreement(solution, agrees)

    random, subsets = np.random.default_rng(0), [np.arange(count)]
    if count > _SUBSET:
        subsets += [random.choice(count, _SUBSET, replace=False) for _ in range(_TRIES)]
    best: _Agreement | None = None
    for rows in subsets:
        solution = by_rows(rows)
        if solution is not None and (best is None or solution.agreeing > best.agreeing):
            best = solution
        if best is not None and best.agreeing == count:
            return best
    if best is None or best.agreeing < FEWEST_SHOTS:
        return None
    refined = by_rows(np.flatnonzero(best.agrees))
    best = refined if refined is not None and refined.agreeing >= best.agreeing else best
    return best if 2 * best.agreeing > count else None
